"""When an agent counts as hung: by time in which somebody looked."""

from __future__ import annotations

import os

import pytest

from agent.guard.pulse import Pulse, pulse_vigil
from agent.guard.takeover import stale_ns
from agent.guard.vigil import Vigil

MS = 1_000_000


def looks(vigil: Vigil, *looks_ms: tuple[float, int]) -> list[bool]:
    return [vigil.is_stale(round(ms * MS), count) for ms, count in looks_ms]


def vigil() -> Vigil:
    return Vigil(stale_ns=20 * MS, look_ns=2 * MS)


def test_an_agent_whose_count_stands_still_is_stale_after_the_time_and_not_before() -> None:
    found = looks(vigil(), *[(1000 + 2 * k, 7) for k in range(12)])
    assert found == [False] * 10 + [True] * 2


def test_the_first_look_finds_nobody_hanging_whatever_the_count() -> None:
    for count in range(3):
        assert looks(vigil(), *[(1000 + 2 * k, count) for k in range(11)]) == [False] * 10 + [True]


def test_every_row_counts_from_the_beginning_again() -> None:
    found = looks(vigil(), *[(1000 + 2 * k, 7 + (k >= 9)) for k in range(19)])
    assert found == [False] * 19


def test_a_host_that_stalls_is_not_held_against_the_agent() -> None:
    watch = vigil()
    assert looks(watch, (1000, 7), (1002, 7), (1502, 7), (1504, 7)) == [False] * 4
    assert watch.still_ns == 8 * MS, "half a second in which nobody looked counts as two looks"


def test_an_agent_that_said_it_is_busy_is_given_that_time() -> None:
    watch = vigil()
    looks(watch, (1000, 7))
    watch.excuse(1100 * MS)
    assert not any(looks(watch, *[(1002 + 2 * k, 7) for k in range(49)]))
    assert looks(watch, *[(1100 + 2 * k, 7) for k in range(10)]) == [False] * 9 + [True]


def test_an_agent_is_given_more_time_for_its_first_row_and_none_of_it_afterwards() -> None:
    watch = Vigil(stale_ns=20 * MS, look_ns=2 * MS, first_ns=50 * MS)
    assert looks(watch, *[(1000 + 2 * k, 0) for k in range(27)]) == [False] * 25 + [True] * 2
    assert not any(looks(watch, *[(1054 + 2 * k, 1) for k in range(10)]))
    assert looks(watch, (1074, 1)) == [True]


def test_a_slow_loop_is_given_three_cycles_and_a_simulated_one_more() -> None:
    assert stale_ns(5 * MS, emulated=False, simulated=False) == 18 * MS
    assert stale_ns(20 * MS, emulated=False, simulated=False) == 60 * MS
    assert stale_ns(5 * MS, emulated=False, simulated=False, floating=True) == 100 * MS
    assert stale_ns(5 * MS, emulated=True, simulated=False) == 150 * MS
    assert stale_ns(5 * MS, emulated=True, simulated=False, floating=True) == 500 * MS
    assert stale_ns(5 * MS, emulated=False, simulated=True) == 500 * MS


def test_a_guard_is_given_more_time_where_it_shares_its_processor_with_what_is_emulated() -> None:
    assert pulse_vigil(5 * MS, shared=False) == Vigil(200 * MS, 5 * MS)
    assert pulse_vigil(5 * MS, shared=True) == Vigil(500 * MS, 5 * MS)
    assert pulse_vigil(100 * MS, shared=False) == Vigil(300 * MS, 100 * MS), "three cycles of a slow loop"


def test_a_pulse_is_one_count_whoever_has_it_and_nobody_changes_its_size() -> None:
    ours = Pulse.made()
    theirs = Pulse(os.dup(ours.fileno()))
    for _ in range(2):
        theirs.beat()
    assert (ours.count, theirs.count) == (2, 2)
    for size in (0, 4096):
        with pytest.raises(PermissionError):
            os.ftruncate(ours.fileno(), size)
    theirs.close()
    theirs.close()
    assert ours.count == 2
    ours.close()
