"""Rows that no `step` tells to be wrong: with a number of another time, and the plant's of another configuration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agent.config.cell import Cell
from agent.log.misfits import number_of
from agent.log.read import ColumnLog
from agent.replay.comparison import ArmComparison, Difference
from agent.replay.rows import Window
from agent.telemetry.row.topics import PLANT


def with_misnumbered(compared: ArmComparison, log: ColumnLog, window: Window) -> ArmComparison:
    """The comparison of an arm with the rows that the reader left out for their numbers: each of them differs."""
    if compared.arm not in log.misnumbered:
        return compared
    rows = window.of(log.misnumbered[compared.arm])
    if not len(rows):
        return compared
    sequence, t = int(rows["sequence"][0]), float(rows["t"][0])
    fitting = number_of(log.agents[compared.arm], int(rows["stamp_ns"][0]))
    own = Difference(compared.arm, sequence, t, "sequence", None, sequence, fitting, ("sequence",))
    return replace(
        compared,
        rows=compared.rows + len(rows),
        different=compared.different + len(rows),
        first=own if compared.first is None or t < compared.first.t_s else compared.first,
    )


def of_the_plant(log: ColumnLog, cell: Cell, window: Window) -> tuple[ArmComparison, ...]:
    """What is wrong with rows of the plant, if anything: nobody computes them again, but they are of a cell too."""
    found, count = [], 0
    if log.plant is not None and any(f.name == "config_id" for f in log.layouts[PLANT].fields):
        rows = window.of(log.plant)
        ids = rows["config_id"]
        others = np.flatnonzero(ids != cell.config_id)
        count = len(rows)
        if len(others):
            k = int(others[0])
            sequence, t, own = int(rows["sequence"][k]), float(rows["t"][k]), int(ids[k])
            fields = ("config_id",)
            first = Difference(PLANT, sequence, t, "config_id", None, own, cell.config_id, fields)
            found.append(ArmComparison(PLANT, count, len(others), 0, first, 0.0))
    plain = found[0] if found else ArmComparison(PLANT, count, 0, 0, None, 0.0)
    whole = with_misnumbered(plain, log, window)
    return (whole,) if whole.different else ()
