"""The clock of a real arm, CLOCK_MONOTONIC with absolute deadlines, and what clocks of arms have to do with UTC."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

READINGS = 20
# UTC less the clock of a run in lockstep is a multiple of this, for that has no other tie to the world's; by that its
# rows are known, since of any other clock it is so once in 10⁹ times
LOCKSTEP_UTC_NS: Final = 1_000_000_000


def utc_offset_ns(utc_ns: Callable[[], int] = time.time_ns, monotonic_ns: Callable[[], int] = time.monotonic_ns) -> int:
    """UTC minus CLOCK_MONOTONIC, ns, to within the time of a clock reading (below 1 µs).

    The kernel slews both clocks alike, so every process of a host finds the same until the wall clock is set: by
    somebody, or in steps by what corrects it.  Of several readings the one that took least counts: nothing came
    between the clocks.
    """
    shortest_ns, offset_ns = -1, 0
    for _ in range(READINGS):
        before_ns = monotonic_ns()
        now_ns = utc_ns()
        took_ns = monotonic_ns() - before_ns
        if shortest_ns < 0 or took_ns < shortest_ns:
            shortest_ns, offset_ns = took_ns, now_ns - before_ns - took_ns // 2
    return offset_ns


class MonotonicClock:
    """`Clock` of a real arm (a loop of "now + period" would lose 2.5 % of the rate, hence deadlines)."""

    def __init__(self, utc_offset_of_run_ns: int | None = None) -> None:
        """utc_offset_of_run_ns: as another process of the same run has found it."""
        self._utc_offset_ns = utc_offset_ns() if utc_offset_of_run_ns is None else utc_offset_of_run_ns

    @property
    def utc_offset_ns(self) -> int:
        """UTC minus this clock, as found at the start: later steps of the wall clock do not move it."""
        return self._utc_offset_ns

    def now_ns(self) -> int:
        """Nanoseconds of CLOCK_MONOTONIC."""
        return time.monotonic_ns()

    def sleep_until(self, deadline_ns: int) -> None:
        """Sleep to an absolute instant; returns at once when it has passed."""
        remaining_ns = deadline_ns - time.monotonic_ns()
        if remaining_ns > 0:
            time.sleep(remaining_ns * 1e-9)
