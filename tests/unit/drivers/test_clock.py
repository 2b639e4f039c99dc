"""How CLOCK_MONOTONIC is mapped to UTC: one number for all processes of a host, whatever interrupts one of them."""

from __future__ import annotations

import time

import pytest

from drivers.clock import READINGS, MonotonicClock, utc_offset_ns

OFFSET_NS = 1_700_000_000_000_000_000


class Interrupted:
    """Both clocks of a host; each reading takes 40 ns, and pauses come where the test says."""

    def __init__(self, pauses_ns: dict[int, int]) -> None:
        self._pauses = pauses_ns
        self._now_ns = 5_000
        self._reading = 0

    def monotonic_ns(self) -> int:
        return self._read()

    def utc_ns(self) -> int:
        return self._read() + OFFSET_NS

    def _read(self) -> int:
        self._reading += 1
        self._now_ns += 40 + self._pauses.get(self._reading, 0)
        return self._now_ns


PAUSE_NS = 30_000_000
ONE_GOOD = {3 * k + 2: PAUSE_NS for k in range(READINGS) if k != 7}


@pytest.mark.parametrize("pauses_ns", [{1: PAUSE_NS}, {2: PAUSE_NS}, {3: PAUSE_NS}, ONE_GOOD])
def test_a_pause_between_the_clocks_does_not_count(pauses_ns: dict[int, int]) -> None:
    host = Interrupted(pauses_ns)
    assert abs(utc_offset_ns(host.utc_ns, host.monotonic_ns) - OFFSET_NS) <= 40


def test_the_offset_maps_this_instant_to_utc() -> None:
    before_ns = time.time_ns()
    clock = MonotonicClock()
    mapped_ns = clock.now_ns() + clock.utc_offset_ns
    assert before_ns - 1_000 <= mapped_ns <= time.time_ns() + 1_000


def test_a_clock_keeps_the_offset_of_its_start(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = MonotonicClock()
    first = clock.utc_offset_ns
    monkeypatch.setattr(time, "time_ns", lambda: 0)
    assert clock.utc_offset_ns == first
