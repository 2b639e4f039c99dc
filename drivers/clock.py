"""The real clock: CLOCK_MONOTONIC with absolute deadlines, which a step of the wall clock does not move."""

import time


class MonotonicClock:
    """`Clock` of a real arm (a loop of "now + period" would lose 2.5 % of the rate, hence deadlines)."""

    def now_ns(self) -> int:
        """Nanoseconds of CLOCK_MONOTONIC."""
        return time.monotonic_ns()

    def sleep_until(self, deadline_ns: int) -> None:
        """Sleep to an absolute instant; returns at once when it has passed."""
        remaining_ns = deadline_ns - time.monotonic_ns()
        if remaining_ns > 0:
            time.sleep(remaining_ns * 1e-9)
