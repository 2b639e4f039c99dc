"""Whether the loop of an arm kept its rate over the motion: the cycles that were due, and those that it left out.

A loop that is not done in time leaves out the cycles that have passed and keeps the phase; rows are numbered without
them, so that only the time between two rows tells.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Final

import numpy as np

from agent.cycles import Patience
from agent.report.quantity import Better, Unit
from agent.report.series import is_stale

if TYPE_CHECKING:
    from agent.log.columns import Table

LEAST: Final = Patience.success_min  # share of the cycles that a real arm must run in time, or it holds


@dataclass(frozen=True, slots=True)
class Pace:
    """Cycles of one arm, from its first row of the motion to its last; rows that the log lost are no such cycles."""

    due_cycles: Annotated[int, Unit("", Better.NEITHER)]
    left_out_cycles: Annotated[int, Unit("")]

    @staticmethod
    def of(rows: Table, rate_hz: float) -> Pace:
        """Of the rows of the motion."""
        if not len(rows):
            return Pace(0, 0)
        ends = rows[np.array([0, len(rows) - 1])]
        late_s = np.where(is_stale(ends), 0.0, ends["late_s"])  # a row without a state is stamped with its deadline
        passed_s = 1e-9 * float(int(ends["stamp_ns"][1]) - int(ends["stamp_ns"][0])) - float(late_s[1] - late_s[0])
        due, ran = (1 + round(n) for n in (passed_s * rate_hz, int(ends["sequence"][1]) - int(ends["sequence"][0])))
        return Pace(due, max(0, due - ran))

    @property
    def kept(self) -> bool:
        """Whether a real arm would have gone on."""
        return self.due_cycles - self.left_out_cycles >= LEAST * self.due_cycles


def pace_line(paces: Mapping[str, Pace]) -> str:
    """What the table of results says: of each arm that left any out."""
    some = [f"{p.left_out_cycles} of {p.due_cycles} ({arm})" for arm, p in paces.items() if p.left_out_cycles]
    return ", ".join(some) or "none"


def pace_notes(paces: Mapping[str, Pace]) -> list[str]:
    """What a reader must know before any figure: the run was not at the rate that it says."""
    return [
        f"the loop of {arm} ran {p.due_cycles - p.left_out_cycles} of the {p.due_cycles} cycles that were due: the run "
        f"was not at its rate; a real arm holds below {100.0 * LEAST:g} %"
        for arm, p in paces.items()
        if not p.kept
    ]
