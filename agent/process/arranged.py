"""A stop that a simulated run has arranged before its begin: the operator says it in one cycle of the trajectory.

The agent knows nothing of why; to its loop it is the word `stop` of that cycle, and the arm holds as on a real arm.
"""

from __future__ import annotations

from typing import Final

from agent.around import Schedule
from agent.modes import Event
from agent.process.operated import Operator

REASON: Final = "stopped as the run had arranged"


class Arranged:
    """What the operator says, with that stop; asked once a cycle, as `Operator.events` is."""

    def __init__(self, operator: Operator, cycle: int, period_ns: int, ready_ns: int | None) -> None:
        """cycle: of the trajectory; ready_ns: in lockstep, from the first cycle to it; None: at the wall clock's pace.

        In lockstep cycles are counted, for the clock then stands at the state of the cycle before.
        """
        self._operator, self._cycle, self._period_ns = operator, cycle, period_ns
        self._to_come = None if ready_ns is None else ready_ns // period_ns + cycle
        self._zero_ns: int | None = None  # of the trajectory, at the wall clock's pace
        self._said = False

    def start_ns(self) -> int | None:
        """The common start, as the operator gives it."""
        self._zero_ns = self._operator.start_ns()
        return self._zero_ns

    def events(self) -> Event:
        """What is asked for now."""
        happened = self._operator.events()
        if self._said or not self._is_due():
            return happened
        self._said = True
        self._operator.arranged(REASON)
        return happened | Event.STOP

    def _is_due(self) -> bool:
        if self._to_come is None:
            now_ns, zero_ns = self._operator.now_ns(), self._zero_ns
            return zero_ns is not None and now_ns - zero_ns >= self._cycle * self._period_ns
        self._to_come -= 1
        return self._to_come < 0


def arranged(operator: Operator, cycle: int | None, schedule: Schedule) -> Operator | Arranged:
    """Whom the loop asks: the operator, with a stop in this cycle of the trajectory where there is one."""
    if cycle is None:
        return operator
    return Arranged(operator, cycle, schedule.period_ns, schedule.ready_ns if schedule.lockstep else None)
