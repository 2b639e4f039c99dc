"""When a rehearsal goes on without an arm that somebody touches, and when it does not."""

from __future__ import annotations

import math

import pytest

from drivers.rehearsal import LEAST_TOUCH_N as LEAST_N
from sim_backend.hil.touch import BACK_S, QUIET_S, Borne, Touch

T = 0.005
BORNE = Borne(most_N=7.5, most_s=0.6)


def touched() -> Touch:
    touch = Touch(BORNE)
    touch.advance(LEAST_N, 0.0, T)
    assert touch.share == 1.0
    return touch


def after(touch: Touch, seconds: float, sudden_N: float, drawn_N: float = 0.0) -> Touch:
    for _ in range(round(seconds / T)):
        touch.advance(sudden_N, drawn_N, T)
    return touch


@pytest.mark.parametrize(("sudden_N", "share"), [(0.0, 0.0), (LEAST_N - 0.01, 0.0), (7.5, 1.0), (7.51, 0.0)])
def test_a_force_between_two_bounds_is_a_touch(sudden_N: float, share: float) -> None:
    touch = Touch(BORNE)
    touch.advance(sudden_N, 0.0, T)
    assert (touch.share, touch.count) == (share, int(share))


def test_nothing_is_borne_where_the_cell_says_so() -> None:
    assert after(Touch(Borne(0.0, 0.6)), 0.5, 5.0).count == 0


def test_the_arm_is_led_by_again_once_nobody_touches_it_and_it_is_near_its_twin() -> None:
    touch = after(touched(), QUIET_S - 2 * T, 0.0)
    assert touch.share == 1.0
    after(touch, 3 * T, 0.0)
    assert 0.9 < touch.share < 1.0
    assert after(touch, BACK_S, 0.0).share == 0.0
    assert after(touched(), 0.4, 0.0, drawn_N=LEAST_N).share == 1.0, "not while it is drawn to it"


def test_what_is_half_of_the_least_touch_or_more_is_somebodys_hand_still() -> None:
    assert after(touched(), 0.4, 0.5 * LEAST_N).share == 1.0
    assert after(touched(), 0.4, 0.49 * LEAST_N).share == 0.0


def test_a_tenth_of_a_second_is_quiet_and_a_fifth_leads_back() -> None:
    touch = Touch(BORNE)
    for sudden_N, dt, share in ((5.0, 0.01, 1.0), (0.0, 0.09, 1.0), (5.0, 0.01, 1.0), (0.0, 0.1, 0.5), (0.0, 0.1, 0.0)):
        touch.advance(sudden_N, 0.0, dt)
        assert touch.share == share


def test_a_touch_may_last_as_long_as_the_bound_to_the_last_cycle() -> None:
    touch = Touch(Borne(most_N=7.5, most_s=0.5))
    for share in (1.0, 1.0, 1.0, 1.0, 1.0, 0.375):
        touch.advance(7.5, 7.5, 0.125)
        assert touch.share == share


def test_the_first_force_of_all_may_be_a_touch_and_what_is_felt_by_all_ends_with_one_quiet_cycle() -> None:
    touch = Touch(BORNE)
    touch.advance(5.0, 0.0, T)
    touch.advance(9.0, 0.0, T)
    assert touch.share == 0.0
    touch.advance(0.5 * LEAST_N, 0.0, T)
    touch.advance(5.0, 0.0, T)
    assert (touch.share, touch.count) == (0.0, 1)
    touch.advance(0.49 * LEAST_N, 0.0, T)
    touch.advance(5.0, 0.0, T)
    assert (touch.share, touch.count) == (1.0, 2)


def test_the_way_back_waits_while_the_arm_is_drawn_again() -> None:
    touch = after(touched(), QUIET_S + 0.1, 0.0)
    share = touch.share
    assert 0.0 < share < 1.0
    assert after(touch, 0.3, 0.0, drawn_N=LEAST_N).share == share


def test_arm_and_twin_that_have_parted_end_the_touch() -> None:
    touch = touched()
    touch.over()
    assert touch.share == 0.0


def test_who_touches_it_again_on_the_way_back_is_borne_again_in_the_same_touch() -> None:
    touch = after(touched(), QUIET_S + 0.1, 0.0)
    assert 0.0 < touch.share < 1.0
    touch.advance(LEAST_N, 0.0, T)
    assert (touch.share, touch.count) == (1.0, 1)


@pytest.mark.parametrize("force", [(7.6, 0.0), (3.0, 7.6), (math.nan, 0.0)], ids=["push", "draw", "no number"])
def test_what_is_too_strong_is_felt_by_all_at_once_and_until_it_is_over(force: tuple[float, float]) -> None:
    touch = touched()
    touch.advance(*force, T)
    assert touch.share == 0.0
    assert after(touch, 0.3, 5.0).share == 0.0
    after(touch, T, 0.0)
    assert after(touch, T, 5.0).share == 1.0


def test_what_lasts_too_long_is_felt_by_all_within_a_fifth_of_a_second() -> None:
    touch = after(touched(), BORNE.most_s - T, 5.0)
    assert touch.share == 1.0
    after(touch, BACK_S + 3 * T, 5.0)
    assert touch.share == 0.0
    assert after(touch, 1.0, 5.0).share == 0.0
    assert touch.count == 1


def test_the_next_touch_may_last_as_long_as_the_one_before() -> None:
    touch = after(touched(), 0.5, 5.0)
    after(touch, QUIET_S + BACK_S + 2 * T, 0.0)
    assert touch.share == 0.0
    assert after(touch, 0.5, 5.0).share == 1.0
    assert touch.count == 2
