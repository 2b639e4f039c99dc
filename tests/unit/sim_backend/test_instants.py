"""When the ticks of a served plant are, on a wall clock that the test moves."""

from __future__ import annotations

from pathlib import Path

import pytest

from sim_backend.served import instants
from sim_backend.served.instants import Instants
from sim_backend.served.options import ServerOptions

PERIOD_NS = 5_000_000


class Wall:
    """Stands in for the module `time`."""

    def __init__(self, ns: int) -> None:
        self.ns = ns

    def monotonic_ns(self) -> int:
        return self.ns

    def sleep(self, seconds: float) -> None:
        self.ns += round(1e9 * seconds)


@pytest.fixture
def wall(monkeypatch: pytest.MonkeyPatch) -> Wall:
    made = Wall(ns=1_234_567)
    monkeypatch.setattr(instants, "time", made)
    return made


def served(*, lockstep: bool) -> Instants:
    return Instants(ServerOptions(Path("unused"), 200.0, 0, lockstep=lockstep, utc_offset_ns=777, observe_every=4))


def test_real_time_begins_where_utc_is_a_whole_number_of_observations(wall: Wall) -> None:
    ticks = served(lockstep=False)
    ticks.begin()
    assert (wall.ns + 777) % (4 * PERIOD_NS) == 0
    assert 0 <= wall.ns - 1_234_567 < 4 * PERIOD_NS
    assert ticks.stamp_ns(0) == wall.ns
    assert ticks.stamp_ns(3) == wall.ns + 3 * PERIOD_NS


def test_a_tick_is_waited_for_and_one_a_period_behind_is_late(wall: Wall) -> None:
    ticks = served(lockstep=False)
    ticks.begin()
    ticks.sleep_until(1)
    assert wall.ns == pytest.approx(ticks.stamp_ns(1), abs=1_000)
    wall.ns = ticks.stamp_ns(2) + PERIOD_NS - 100_000
    ticks.sleep_until(2)
    assert (wall.ns, ticks.late) == (ticks.stamp_ns(2) + PERIOD_NS - 100_000, 0)
    wall.ns = ticks.stamp_ns(3) + PERIOD_NS + 100_000
    ticks.sleep_until(3)
    assert ticks.late == 1


def test_in_lockstep_time_is_counted_and_not_waited_for(wall: Wall) -> None:
    ticks = served(lockstep=True)
    ticks.begin()
    assert wall.ns == 1_234_567
    assert ticks.stamp_ns(3) == 3 * PERIOD_NS
