"""What the loop makes of its own cycles: gaps, cycles without a state, and what there is left to do on the bus.

Instants and counts in, words out; nothing here knows a clock, a bus or a torque.  Only whoever gets replies feeds the
servos' watchdogs: any packet does, a read as well as a write, so a blind loop falls silent altogether and stays so for
as long as the watchdogs need.  Then it may ask again, for nothing that is asked clears a watchdog that has fired.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

WINDOW = 100  # cycles of which a share must have brought a state in time
_MASK = (1 << WINDOW) - 1


class Bus(enum.Enum):
    """What to do on the bus in a cycle."""

    READ = "ask for a state"
    RECOVER = "bring the arm back, then ask for a state"
    QUIET = "say nothing"
    GIVE_UP = "the arm is lost"


@dataclass(frozen=True)
class Patience:
    """After how many cycles without a fresh state something is done about it; some are no such cycles, and say so."""

    hold: int = 3  # the object is held
    repeat: int = 3  # the last torque is kept no longer: the arm's weight and load share instead
    blind: int = 40  # nothing is sent or asked any more
    quiet: int = 50  # for so long after that, until every watchdog has fired for certain
    recover: int = 400  # and then the arm may come back; 0: a blind arm is lost at once
    retry: int = 20  # cycles from one attempt to the next
    gap: int = 10  # cycles from one to the next, above which time was lost
    success_min: float = 0.9  # share of the last WINDOW cycles, as above; 0: any

    @property
    def lost(self) -> int:
        """After so many the arm is given up: it has been limp for long, and somebody may have a hand on it."""
        return self.blind + self.quiet + self.recover


class Cycles:
    """Counts of one loop; instants are deadlines on the driver's clock."""

    def __init__(self, patience: Patience, period_ns: int, begin_ns: int) -> None:
        self._patience = patience
        self._period_ns = period_ns
        self._fresh_ns = begin_ns - period_ns  # deadline of the last cycle with a state
        self._begun_ns: int | None = None  # when the last cycle really began
        self._tried_ns = begin_ns - patience.retry * period_ns
        self._failed = 0  # one bit for each of the last WINDOW cycles
        self._waited = False  # in this cycle, for the first state
        self._trusted = True  # the last cycles were as they should be, or it has not been told yet that they were not
        self._recovers = False

    def gap_s(self, now_ns: int) -> float:
        """A cycle begins; seconds since the last one did, 0 where no time was lost."""
        passed_ns = 0 if self._begun_ns is None else now_ns - self._begun_ns
        self._begun_ns = now_ns
        if passed_ns <= self._patience.gap * self._period_ns:
            return 0.0
        self._trusted = self._good_enough  # what that gap has left of it is told with it
        return passed_ns * 1e-9

    def without_state(self, deadline_ns: int) -> int:
        """Cycles since the last state, this one with them."""
        return (deadline_ns - self._fresh_ns) // self._period_ns

    def plan(self, deadline_ns: int, *, lapsed: bool, recovers: bool) -> Bus:
        """What to do in this cycle; lapsed: the arm does nothing until it is brought back, recovers: which can be."""
        patience, lost, self._recovers = self._patience, self.without_state(deadline_ns), recovers
        due = recovers and deadline_ns - self._tried_ns >= patience.retry * self._period_ns
        if lost <= patience.blind:
            return Bus.RECOVER if lapsed and due else Bus.READ
        if not recovers or lost > patience.lost:
            return Bus.GIVE_UP
        return Bus.RECOVER if due and lost > patience.blind + patience.quiet else Bus.QUIET

    def tried(self, deadline_ns: int, *, back: bool) -> None:
        """It was tried to bring the arm back; an arm that is back has answered."""
        self._tried_ns = deadline_ns
        if back:
            self._fresh_ns = deadline_ns - self._period_ns

    def fresh(self, deadline_ns: int) -> None:
        """This cycle brought a state."""
        self._fresh_ns = deadline_ns

    def first(self, now_ns: int) -> None:
        """It was the first one, for which a simulated arm waits until all others are there: that is no time lost."""
        self._fresh_ns, self._begun_ns, self._waited = now_ns, None, True

    def end(self, skipped: int, *, good: bool) -> float | None:
        """This cycle and `skipped` ones after it are over; the share of good ones once that falls below the least.

        Not after a gap, of which the next cycle tells before it acts; where it finds none, because this one began late
        as well, it tells of the share.
        """
        if self._waited:
            self._waited = False
            return None
        if skipped >= self._patience.gap and not self._recovers:  # nobody looked, and no watchdog has stopped this arm
            self._fresh_ns += skipped * self._period_ns
        missed = min(skipped, WINDOW)
        self._failed = ((self._failed << 1 | (not good)) << missed | (1 << missed) - 1) & _MASK
        told = self._trusted and not self._good_enough and skipped < self._patience.gap
        self._trusted = self._good_enough or (self._trusted and not told)
        return self._share if told else None

    @property
    def _share(self) -> float:
        """Of good cycles among the last."""
        return 1.0 - self._failed.bit_count() / WINDOW

    @property
    def _good_enough(self) -> bool:
        return self._share >= self._patience.success_min
