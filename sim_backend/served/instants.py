"""When the ticks of a served plant are: of simulated time in lockstep, else at instants of the wall clock."""

from __future__ import annotations

import time

from sim_backend.served.options import ServerOptions


class Instants:
    """The ticks of one run.  late: ticks of real time that began more than a period after their instant."""

    def __init__(self, options: ServerOptions) -> None:
        self.late = 0
        self._options = options
        self._zero_ns = 0  # real time: CLOCK_MONOTONIC at tick 0

    def begin(self) -> None:
        """Tick 0 is due; in real time this waits for it."""
        if not self._options.lockstep:
            self._zero_ns = self._first_ns()
            time.sleep(max(0, self._zero_ns - time.monotonic_ns()) * 1e-9)

    def stamp_ns(self, tick: int) -> int:
        """Of a tick, on the plant's clock."""
        since_zero = round(tick * 1e9 / self._options.rate_hz)
        return since_zero if self._options.lockstep else self._zero_ns + since_zero

    def sleep_until(self, tick: int) -> None:
        """Real time: wait for this tick, and count it when it is late."""
        period_s = 1.0 / self._options.rate_hz
        remaining_s = (self._zero_ns - time.monotonic_ns()) * 1e-9 + tick * period_s
        if remaining_s > 0:
            time.sleep(remaining_s)
        self.late += remaining_s < -period_s

    def _first_ns(self) -> int:
        """The next instant at which UTC is a whole number of observations, as it is at tick 0 in lockstep.

        Rows of arms and plant that are thinned out by UTC are then of the same instants.
        """
        now_ns = time.monotonic_ns()
        every_ns = round(self._options.observe_every * 1e9 / self._options.rate_hz)
        return now_ns + -(now_ns + self._options.utc_offset_ns) % every_ns
