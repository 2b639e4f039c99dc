"""Whether somebody touches a real arm that rehearses, and for how long its twin is left out of it.

What an arm does otherwise than its model changes slowly, or by little.  A touch is there at once and goes away again:
as long as it lasts, and is neither strong nor long, the rehearsal goes on without the arm, which is drawn to its twin.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from drivers.rehearsal import LEAST_TOUCH_N

QUIET: Final = 0.5  # of the least touch: nobody touches the arm any more
QUIET_S: Final = 0.1  # for so long
BACK_S: Final = 0.2  # from the twin back to the arm


@dataclass(frozen=True)
class Borne:
    """The largest and the longest touch that a rehearsal lives with; none: most_N below LEAST_TOUCH_N."""

    most_N: float
    most_s: float


class Touch:
    """`share`, 0 to 1: how much the rehearsal goes on without the real arm."""

    def __init__(self, borne: Borne) -> None:
        self.borne = borne
        self.share = 0.0
        self.count = 0  # touches so far
        self._lasted_s = 0.0
        self._quiet_s = 0.0
        self._bears = True  # what acts now is, or would be, lived with

    def advance(self, sudden_N: float, drawn_N: float, dt: float) -> None:
        """A cycle of dt s.

        sudden_N: force on the arm beside its model and beside what lasts; drawn_N: by which the twin draws the arm.
        """
        most_N = self.borne.most_N
        self._quiet_s = self._quiet_s + dt if sudden_N < QUIET * LEAST_TOUCH_N else 0.0
        if self.share == 0.0:
            self._bears = self._bears or self._quiet_s > 0.0
            if self._bears and LEAST_TOUCH_N <= sudden_N <= most_N:
                self.share, self._lasted_s, self.count = 1.0, 0.0, self.count + 1
            return
        self._lasted_s += dt
        self._bears = self._lasted_s <= self.borne.most_s
        if not max(sudden_N, drawn_N) <= most_N:  # also what is no number
            self.share, self._bears = 0.0, False
        elif not self._bears or (self._quiet_s >= QUIET_S and drawn_N < LEAST_TOUCH_N):
            self.share = max(0.0, self.share - dt / BACK_S)
        elif self._quiet_s == 0.0:
            self.share = 1.0

    def over(self) -> None:
        """Arm and twin have parted."""
        self.share = 0.0
