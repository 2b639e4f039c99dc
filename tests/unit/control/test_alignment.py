"""The shift by which an arm finds together with the others: signs, dead zone, limits, who moves and when."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.control import errors
from agent.control.alignment import NO_SHIFT, Alignment, Shift, between, shifted
from agent.control.errors import Errors, Gains
from agent.control.quaternion import Quat, Vec3, angle_between, from_axis_angle, multiply
from agent.control.trajectory import Desired

STILL = (0.0,) * 6
ONE = (1.0, 0.0, 0.0, 0.0)
GAINS = Gains((1.0,) * 3, (1.0,) * 3, (1.0,) * 3, (1.0,) * 3, (1.0,) * 6)
FOLLOWER = Alignment(follows=True)
NEARLY_NONE = (1e-15, 0.0, 0.0, 0.0, 0.0, 0.0)  # what a start leaves, that arms go back to
FORGETS_NOTHING = replace(FOLLOWER, return_per_s=0.0)
AXES = st.sampled_from([(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.6, -0.8)])


def errors_at(p: Vec3, quat: Quat, desired: Desired) -> Errors:
    return errors.evaluate(p, quat, STILL, desired, GAINS)


def settled(p: Vec3, quat: Quat, alignment: Alignment, *, ready: bool, start: Shift = NO_SHIFT) -> tuple[float, ...]:
    """The shift after a time in which the object stays at (p, quat) and the common pose is the origin."""
    common, shift = Desired((0.0, 0.0, 0.0), ONE, STILL, STILL), NO_SHIFT
    for _ in range(3000):
        shift = alignment.advance(shift, start, errors_at(p, quat, shifted(common, shift)), 0.02, ready=ready)
    return shift


def test_before_the_start_a_disagreement_becomes_an_offset_but_for_the_dead_zone() -> None:
    p, quat = (0.003, -0.004, 0.0), from_axis_angle((0.0, 0.0, 1.0), 0.03)
    shift = settled(p, quat, FOLLOWER, ready=True)
    left = np.linalg.norm(np.array(p) - shift[:3])
    assert left == pytest.approx(FOLLOWER.dead_zone_m, rel=1e-3)
    assert shift[0] > 0.0 > shift[1], "towards where it sees the object"
    assert shift[5] == pytest.approx(0.03 - FOLLOWER.dead_zone_rad, rel=1e-2)


def test_one_that_comes_during_the_motion_becomes_one_to_the_part_that_does_not_go_back() -> None:
    """Where α (|δ − d| − dz) = β |d|."""
    p, quat = (0.003, -0.004, 0.0), from_axis_angle((0.0, 0.0, 1.0), 0.03)
    for law, part in ((FOLLOWER, 0.5), (replace(FOLLOWER, return_per_s=0.1), 0.75), (FORGETS_NOTHING, 1.0)):
        shift = settled(p, quat, law, ready=False, start=NEARLY_NONE)
        assert np.linalg.norm(shift[:3]) == pytest.approx(part * (5e-3 - law.dead_zone_m), rel=1e-3)
        assert shift[0] > 0.0 > shift[1]
        assert shift[5] == pytest.approx(part * (0.03 - law.dead_zone_rad), rel=1e-2)


def test_a_shift_goes_back_to_what_the_start_left_during_the_motion_alone() -> None:
    none = errors_at((0.0,) * 3, ONE, Desired((0.0,) * 3, ONE, STILL, STILL))
    start, shift = (1e-3, -2e-3, 3e-3, 0.01, 0.02, -0.03), (5e-3, 6e-3, -7e-3, -0.05, 0.06, 0.07)
    assert FOLLOWER.advance(shift, start, none, 0.1, ready=True) == shift
    assert FORGETS_NOTHING.advance(shift, start, none, 0.1, ready=False) == shift
    found = np.array(FOLLOWER.advance(shift, start, none, 0.1, ready=False))
    assert found - start == pytest.approx((1.0 - 0.3 * 0.1) * (np.array(shift) - start), rel=1e-9)
    for _ in range(400):
        shift = FOLLOWER.advance(shift, start, none, 0.1, ready=False)
    assert shift == pytest.approx(start, abs=1e-6)


def test_an_arm_whose_object_goes_along_with_it_is_not_led_on_and_on_by_its_own_lag() -> None:
    """The others have let go: its error stays what it is wherever its shift goes."""
    lag = errors_at((0.003, 0.0, 0.0), from_axis_angle((0.0, 1.0, 0.0), 0.02), Desired((0.0,) * 3, ONE, STILL, STILL))
    shift, led = NO_SHIFT, NO_SHIFT
    for _ in range(1200):
        shift = FOLLOWER.advance(shift, NEARLY_NONE, lag, 0.05, ready=False)
        led = FORGETS_NOTHING.advance(led, NEARLY_NONE, lag, 0.05, ready=False)
    assert shift[0] == pytest.approx(0.003 - FOLLOWER.dead_zone_m)
    assert shift[4] == pytest.approx(0.02 - FOLLOWER.dead_zone_rad, rel=1e-3)
    assert led[0] == pytest.approx(FOLLOWER.max_m)


def test_who_found_no_time_before_the_start_goes_back_to_what_was_found_during_the_motion() -> None:
    start, shift = (1e-3, -2e-3, 3e-3, 0.01, 0.02, -0.03), (5e-3, 6e-3, -7e-3, -0.05, 0.06, 0.07)
    late_s = 4.0 / 0.3
    assert FOLLOWER.settle(NO_SHIFT, shift, late_s - 0.01) == NO_SHIFT
    assert FOLLOWER.settle(NO_SHIFT, shift, late_s + 0.01) == shift
    assert replace(FOLLOWER, track_per_s=0.5).settle(NO_SHIFT, shift, 8.0) == shift
    assert FOLLOWER.settle(start, shift, late_s + 0.01) == start, "it had, and once is enough"
    assert replace(FOLLOWER, track_per_s=0.0).settle(NO_SHIFT, shift, 1e9) == NO_SHIFT, "nothing is ever found"
    none = errors_at((0.0,) * 3, ONE, Desired((0.0,) * 3, ONE, STILL, STILL))
    assert FOLLOWER.advance(shift, NO_SHIFT, none, 0.1, ready=False) == shift


def test_within_the_dead_zone_nothing_shifts() -> None:
    assert settled((0.0006, 0.0, 0.0), from_axis_angle((1.0, 0.0, 0.0), 0.0039), FOLLOWER, ready=True) == NO_SHIFT


def test_the_anchor_keeps_its_shift() -> None:
    before = (0.01, 0.0, 0.0, 0.0, 0.02, 0.0)
    far = errors_at((1.0, 1.0, 1.0), ONE, Desired((0.0,) * 3, ONE, STILL, STILL))
    assert Alignment(follows=False).advance(before, NO_SHIFT, far, 0.1, ready=True) == before


def test_before_the_start_it_shifts_faster() -> None:
    e = errors_at((0.01, 0.0, 0.0), ONE, Desired((0.0,) * 3, ONE, STILL, STILL))
    waiting, tracking = (FOLLOWER.advance(NO_SHIFT, NO_SHIFT, e, 0.005, ready=ready)[0] for ready in (True, False))
    assert waiting == pytest.approx(2.0 * 0.005 * (0.01 - FOLLOWER.dead_zone_m))
    assert tracking == pytest.approx(0.3 * 0.005 * (0.01 - FOLLOWER.dead_zone_m))


@pytest.mark.parametrize("ready", [True, False])
def test_a_tick_moves_a_shift_by_what_is_beyond_the_dead_zone(ready: bool) -> None:
    p, axis = np.array([0.004, -0.006, 0.003]), np.array([0.48, -0.6, 0.64])
    e = errors_at(tuple(p), from_axis_angle(tuple(axis), 0.03), Desired((0.0,) * 3, ONE, STILL, STILL))
    before, gain = np.array([1e-3, 2e-3, -3e-3, 0.01, -0.02, 0.03]), 0.1 * (2.0 if ready else 0.3)
    turned, size = 2.0 * math.sin(0.015) * math.cos(0.015) * axis, math.sin(0.03)
    d = before[:3] + gain * (1.0 - 1.5e-3 / np.linalg.norm(p)) * p
    rho = before[3:] + gain * (1.0 - 8e-3 / size) * turned
    start = tuple(before.tolist())
    found = FOLLOWER.advance(start, start, e, 0.1, ready=ready)
    assert found == pytest.approx((*d, *rho), rel=1e-9)


def test_at_the_edge_of_the_dead_zone_nothing_shifts_and_beyond_the_limit_the_direction_stays() -> None:
    common = Desired((0.0,) * 3, ONE, STILL, STILL)
    edge = errors_at((1.5e-3, 0.0, 0.0), ONE, common)
    assert FOLLOWER.advance(NO_SHIFT, NO_SHIFT, edge, 0.1, ready=True) == NO_SHIFT
    far = errors_at((3.0, -4.0, 12.0), ONE, common)
    found = FOLLOWER.advance((0.003, -0.004, 0.012, 0.0, 0.0, 0.0), NO_SHIFT, far, 1.0, ready=True)
    assert found == pytest.approx((0.06 / 13.0, -0.08 / 13.0, 0.24 / 13.0, 0.0, 0.0, 0.0))


def test_a_shift_moves_and_turns_about_every_axis_and_none_leaves_the_motion_itself() -> None:
    desired = Desired((1.0, 2.0, 3.0), from_axis_angle((0.0, 1.0, 0.0), 0.5), STILL, STILL)
    assert shifted(desired, NO_SHIFT) is desired
    assert shifted(desired, tuple([0.0] * 6)) is desired
    for size in (0.3, 1e-10):
        rho = (0.48 * size, -0.6 * size, 0.64 * size)
        moved = shifted(desired, (0.1, 0.2, 0.3, *rho))
        assert moved.p == pytest.approx((1.1, 2.2, 3.3))
        half = 0.5 * np.array(rho)
        turn = (math.cos(0.5 * size), *(math.sin(0.5 * size) / (0.5 * size) * half))
        assert moved.quat == pytest.approx(multiply(turn, desired.quat), abs=1e-13)
        w, x, y, z = moved.quat
        for same in ((w, x, y, z), (-w, -x, -y, -z)):
            back = between(moved.p, same, desired.p, desired.quat)
            assert back == pytest.approx((0.1, 0.2, 0.3, *rho), abs=1e-13)


def test_the_shift_has_limits() -> None:
    shift = settled((0.5, 0.0, 0.0), from_axis_angle((0.0, 1.0, 0.0), 0.6), FOLLOWER, ready=True)
    assert math.hypot(*shift[:3]) == pytest.approx(FOLLOWER.max_m)
    assert math.hypot(*shift[3:]) == pytest.approx(FOLLOWER.max_rad)


def test_a_shift_that_began_beyond_its_limit_goes_no_further_and_is_not_torn_back() -> None:
    common, beyond = Desired((0.0,) * 3, ONE, STILL, STILL), (0.0, 0.03, 0.0, 0.15, 0.0, 0.0)
    out = errors_at((0.0, 0.01, 0.0), from_axis_angle((1.0, 0.0, 0.0), 0.05), common)
    assert FOLLOWER.advance(beyond, beyond, out, 0.005, ready=False) == pytest.approx(beyond, rel=1e-12)
    back = errors_at((0.0, -0.01, 0.0), from_axis_angle((1.0, 0.0, 0.0), -0.05), common)
    found = FOLLOWER.advance(beyond, beyond, back, 0.005, ready=False)
    assert found[1] == pytest.approx(0.03 - 0.3 * 0.005 * 0.0085)
    assert 0.1499 < found[3] < 0.15


def test_an_error_that_is_no_number_shifts_nothing() -> None:
    e = errors_at((math.nan, 0.0, 0.0), (math.nan,) * 4, Desired((0.0,) * 3, ONE, STILL, STILL))
    assert FOLLOWER.advance((0.001,) * 6, NO_SHIFT, e, 0.005, ready=True) == (0.001,) * 6


@given(AXES, st.floats(-3.0, 3.0), AXES, st.floats(-3.0, 3.0))
def test_the_shift_between_two_poses_takes_one_to_the_other(a: Vec3, x: float, b: Vec3, y: float) -> None:
    seen, stated = from_axis_angle(a, x), from_axis_angle(b, y)
    shift = between((0.3, 0.2, 0.1), seen, (0.1, 0.1, 0.1), stated)
    moved = shifted(Desired((0.1, 0.1, 0.1), stated, STILL, STILL), shift)
    assert moved.p == pytest.approx((0.3, 0.2, 0.1))
    assert angle_between(moved.quat, seen) < 1e-7
    assert math.hypot(*shift[3:]) <= math.pi + 1e-9


def test_a_shift_leaves_twist_and_acceleration_of_all() -> None:
    desired = Desired((1.0, 2.0, 3.0), multiply(ONE, ONE), (1.0,) * 6, (2.0,) * 6)
    moved = shifted(desired, (0.1, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert (moved.v, moved.a) == (desired.v, desired.a)
    assert moved.p == (1.1, 2.0, 3.0)
