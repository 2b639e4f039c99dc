"""What the loop makes of lost states and lost time, cycle by cycle."""

from __future__ import annotations

from dataclasses import asdict

import pytest

from agent.cycles import WINDOW, Bus, Cycles, Patience

T = 5_000_000
BEGIN = 7_000_000_000
PATIENCE = Patience(hold=3, repeat=3, blind=8, quiet=5, recover=6, retry=4, gap=10, success_min=0.9)


def at(cycle: float) -> int:
    """Deadline of a cycle, the first being 1."""
    return BEGIN + round((cycle - 1) * T)


def cycles(patience: Patience = PATIENCE) -> Cycles:
    return Cycles(patience, T, BEGIN)


# --- the bus ---------------------------------------------------------------------------------------------------------


def plans(patience: Patience, count: int, *, recovers: bool, back: int = 0, lapsed: int = 0) -> str:
    """First letters of what is done in each cycle; none brings a state; back: the cycle in which an attempt works.

    lapsed: the cycle from which on the arm says that it has stopped.
    """
    mine, found = cycles(patience), []
    for cycle in range(1, count + 1):
        plan = mine.plan(at(cycle), lapsed=0 < lapsed <= cycle, recovers=recovers)
        found.append({Bus.READ: "r", Bus.RECOVER: "A", Bus.QUIET: "-", Bus.GIVE_UP: "x"}[plan])
        if plan is Bus.RECOVER:
            mine.tried(at(cycle), back=cycle == back)
    return "".join(found)


def test_an_arm_that_cannot_come_back_is_lost_after_the_blind_time() -> None:
    assert plans(PATIENCE, 10, recovers=False) == "rrrrrrrrxx"


def test_a_blind_loop_is_silent_for_the_watchdogs_then_tries_now_and_then_then_gives_up() -> None:
    assert plans(PATIENCE, 21, recovers=True) == "rrrrrrrr-----A---A-xx"


def test_without_time_to_come_back_the_arm_is_lost_after_the_silence() -> None:
    assert plans(Patience(blind=8, quiet=5, recover=0), 15, recovers=True) == "rrrrrrrr-----xx"


def test_an_arm_that_is_back_has_answered_and_is_asked_again() -> None:
    assert plans(PATIENCE, 24, recovers=True, back=14) == "rrrrrrrr-----Arrrrrrr---"


def test_an_arm_that_stopped_is_tried_at_once_but_not_in_every_cycle_and_not_in_the_silence() -> None:
    assert plans(PATIENCE, 14, recovers=True, lapsed=2) == "rArrrArr-----A"
    assert plans(PATIENCE, 9, recovers=False, lapsed=2) == "rrrrrrrrx"


def test_a_state_begins_the_count_anew() -> None:
    mine = cycles()
    assert [mine.without_state(at(k)) for k in (1, 2, 8)] == [1, 2, 8]
    mine.fresh(at(8))
    assert [mine.without_state(at(k)) for k in (9, 12)] == [1, 4]
    assert mine.plan(at(16), lapsed=False, recovers=False) is Bus.READ
    assert mine.plan(at(17), lapsed=False, recovers=False) is Bus.GIVE_UP


def test_cycles_that_were_left_out_count_as_cycles_without_a_state() -> None:
    mine = cycles()
    mine.fresh(at(1))
    assert mine.without_state(at(8)) == 7


def test_what_a_loop_of_real_arms_bears_unless_its_cell_says_more_or_less() -> None:
    lost = {"hold": 3, "repeat": 3, "blind": 40, "quiet": 50, "recover": 400, "retry": 20}
    assert asdict(Patience()) == lost | {"gap": 10, "success_min": 0.9}


# --- time ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("periods", "lost"), [(1.0, False), (10.0, False), (10.0 + 1e-6, True), (400.0, True)])
@pytest.mark.fault("P12")
def test_more_than_ten_periods_from_one_cycle_to_the_next_are_a_gap(periods: float, lost: bool) -> None:
    mine = cycles()
    assert mine.gap_s(at(300)) == 0.0, "the first cycle follows none"
    passed_ns = round(periods * T)
    assert mine.gap_s(at(300) + passed_ns) == (passed_ns * 1e-9 if lost else 0.0)
    assert mine.gap_s(at(300) + passed_ns + T) == 0.0, "a gap is told of once"


@pytest.mark.fault("P3")
def test_eleven_bad_cycles_of_a_hundred_are_told_of_once() -> None:
    mine = cycles()
    assert [mine.end(0, good=False) for _ in range(10)] == [None] * 10
    assert mine.end(0, good=True) is None
    assert mine.end(0, good=False) == pytest.approx(0.89)
    assert [mine.end(0, good=False) for _ in range(5)] == [None] * 5


def test_bad_cycles_are_forgotten_after_a_hundred() -> None:
    mine = cycles()
    for _ in range(10):
        mine.end(0, good=False)
    for _ in range(WINDOW - 10):
        assert mine.end(0, good=True) is None
    assert [mine.end(0, good=False) for _ in range(10)] == [None] * 10, "each takes the place of an old one"
    assert mine.end(0, good=False) == pytest.approx(0.89)


def test_a_bad_cycle_counts_until_a_hundred_have_followed_it() -> None:
    mine = cycles()
    assert [mine.end(0, good=False) for _ in range(10)] == [None] * 10
    assert [mine.end(0, good=True) for _ in range(WINDOW - 11)] == [None] * (WINDOW - 11)
    assert mine.end(0, good=False) == pytest.approx(0.89)


def test_the_first_cycle_may_lose_all_trust() -> None:
    assert cycles(Patience(gap=50)).end(20, good=True) == pytest.approx(0.8)


def test_an_arm_that_was_trusted_again_may_lose_trust_again() -> None:
    mine = cycles()
    assert sum(mine.end(0, good=False) is not None for _ in range(20)) == 1
    for _ in range(WINDOW):
        assert mine.end(0, good=True) is None
    assert sum(mine.end(0, good=False) is not None for _ in range(20)) == 1


@pytest.mark.parametrize(("before", "skipped", "share"), [(1, 9, None), (2, 9, 0.89), (9, 9, 0.82)])
@pytest.mark.fault("P3")
def test_cycles_that_were_left_out_are_bad_ones(before: int, skipped: int, share: float | None) -> None:
    mine = cycles()
    for _ in range(before):
        mine.end(0, good=False)
    assert mine.end(skipped, good=True) == (None if share is None else pytest.approx(share))


@pytest.mark.parametrize("skipped", [10, 11, 99, 10_000_000])
def test_a_gap_is_left_to_the_cycle_after_it(skipped: int) -> None:
    mine = cycles()
    for _ in range(5):
        mine.end(0, good=False)
    mine.gap_s(at(300))
    assert mine.end(skipped, good=True) is None
    assert mine.gap_s(at(301 + skipped)) > 0.0
    assert mine.end(0, good=False) is None
    for _ in range(WINDOW):
        assert mine.end(0, good=True) is None
    assert sum(mine.end(0, good=False) is not None for _ in range(20)) == 1, "trusted again, it is told again"


def test_lost_cycles_are_told_of_where_the_next_one_finds_no_gap() -> None:
    """One that began late and took long: from its beginning to the next it is less than from its deadline."""
    mine = cycles()
    mine.gap_s(at(306))
    assert mine.end(11, good=False) is None
    assert mine.gap_s(at(312)) == 0.0
    assert mine.end(0, good=True) == pytest.approx(0.88)
    assert mine.end(0, good=True) is None


def test_a_patience_without_a_share_asks_for_none() -> None:
    mine = cycles(Patience(success_min=0.0))
    assert [mine.end(0, good=False) for _ in range(WINDOW)] == [None] * WINDOW


def test_what_the_first_state_was_waited_for_is_no_lost_time() -> None:
    mine = cycles()
    mine.gap_s(0)
    mine.first(200 * T)
    assert mine.end(200, good=False) is None
    assert mine.gap_s(201 * T) == 0.0
    assert mine.without_state(201 * T) == 1
    assert mine.end(9, good=False) is None
    assert mine.end(0, good=False) == pytest.approx(0.89)
    assert mine.gap_s(222 * T) == pytest.approx(21 * T * 1e-9)


@pytest.mark.parametrize(
    ("recovers", "skipped", "without"),
    [(False, 9, 10), (False, 10, 1), (False, 30, 1), (None, 30, 1), (True, 30, 31)],
)
def test_time_in_which_nobody_looked_is_none_without_a_state_where_no_watchdog_stops_the_arm(
    recovers: bool | None, skipped: int, without: int
) -> None:
    """recovers: None for a loop that has not asked the bus yet."""
    mine = cycles()
    if recovers is not None:
        mine.plan(at(1), lapsed=False, recovers=recovers)
    mine.fresh(at(1))
    mine.end(skipped, good=True)
    assert mine.without_state(at(2 + skipped)) == without
