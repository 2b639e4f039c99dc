"""Places along a cell's trajectory at which gains are sought."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from agent.config.cell import Cell, placement
from agent.control.models import ArmModel
from agent.verify.check import reach, start_configurations
from drivers.interface import Vector

PLACES: Final = 12


def walk(cell: Cell, models: Sequence[ArmModel]) -> list[list[Vector]]:
    """Joint angles of all arms at some places of the trajectory."""
    motion = cell.trajectory()
    q = list(start_configurations(cell, models))
    along = []
    for t in instants(cell):
        desired = motion.at(t)
        T = placement(desired.p, desired.quat)
        q = [reach(a, m, T, q_i, f"at t = {t:.2f} s") for a, m, q_i in zip(cell.arms, models, q, strict=True)]
        along.append(q)
    return along


def instants(cell: Cell) -> list[float]:
    """Of those places, s."""
    end_s = min(cell.trajectory().period_s, cell.file.duration_s)
    times: list[float] = np.linspace(0.0, end_s, 4 * PLACES)[::4].tolist()
    return times
