"""Torque to counts and back, angles, budget and thermal estimate: properties over all values."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.dynamixel.arm_map import JointMap, JointRole
from drivers.dynamixel.budget import LinkTiming, cycle_budget, health_servos_per_gap
from drivers.dynamixel.checks import SILENT_LIMIT_CYCLES
from drivers.dynamixel.cycle import MARKS
from drivers.dynamixel.pace import PaceError, check_rate
from drivers.dynamixel.servo.counts import TICK_RAD
from drivers.dynamixel.servo.models import SERVOS
from drivers.dynamixel.servo.thermal import ThermalWatch
from drivers.dynamixel.servo.torque import LEAST_SUPPLY_V, CurrentDrive, PwmDrive, needed_pwm_count, torque_drive
from drivers.dynamixel.servo.units import AngleScale, current_unit_A
from tests.support.servos.dxl_rig import WX200, XL, XM, at

ONE = JointMap("elbow", XM, (4,), (True,), tau_max_Nm=2.0)
TWO = JointMap("shoulder", XM, (2, 3), (False, True), tau_max_Nm=4.0)
WRIST = JointMap("wrist_rotate", XL, (6,), (False,), tau_max_Nm=0.8)

TORQUE = st.floats(-10.0, 10.0)
SPEED = st.floats(-4.0, 4.0)


def test_a_supply_below_what_any_servo_works_with_counts_as_that() -> None:
    drive = PwmDrive(WRIST)
    assert LEAST_SUPPLY_V == 6.0
    assert drive.command(0.2, 0.0, 0.0) == drive.command(0.2, 0.0, 5.9) == drive.command(0.2, 0.0, 6.0)
    assert drive.command(0.2, 0.0, 6.0)[0] > drive.command(0.2, 0.0, 6.5)[0]
    assert drive.goal_Nm(100, 0.0, 0.0) == drive.goal_Nm(100, 0.0, 6.0) < drive.goal_Nm(100, 0.0, 6.5)


@pytest.mark.parametrize(
    ("joint", "stall_Nm", "count"),
    [(ONE, 4.1, 432), (TWO, 8.2, 432), (WRIST, 1.5, 472)],
    ids=lambda value: str(value)[:20],
)
def test_the_part_of_the_supply_that_a_torque_takes_at_rest_is_its_part_of_stall(
    joint: JointMap, stall_Nm: float, count: int
) -> None:
    assert needed_pwm_count(joint) == count == math.ceil(joint.tau_max_Nm / stall_Nm * 100.0 / 0.113)


@given(TORQUE)
def test_current_counts_are_within_limits_and_say_what_they_ask_for(tau):
    for joint in (ONE, TWO):
        drive = CurrentDrive(joint)
        count, sent = drive.command(tau, 0.0, 12.0)
        unit = len(joint.ids) * 1.783 * 2.69e-3
        assert sent == pytest.approx(count * unit, rel=1e-3)
        assert abs(sent - max(-joint.tau_max_Nm, min(joint.tau_max_Nm, tau))) <= unit / 2 + 1e-12
        assert drive.measured_Nm([count] * len(joint.ids), 0.0) == pytest.approx(sent)


def test_two_servos_share_a_joint_s_torque():
    count_one, _ = CurrentDrive(ONE).command(1.5, 0.0, 12.0)
    count_two, _ = CurrentDrive(TWO).command(3.0, 0.0, 12.0)
    assert count_one == count_two


def test_a_servo_s_lower_limit_bounds_the_torque():
    count, sent = CurrentDrive(ONE, 100).command(2.0, 0.0, 12.0)
    assert count == 100
    assert sent == pytest.approx(100 * 1.783 * 2.69e-3, rel=1e-3)


@given(SPEED, st.floats(-1.0, 1.0))
def test_no_load_current_helps_the_motion_and_is_not_counted_as_torque(dq, tau):
    plain, helped = CurrentDrive(ONE), CurrentDrive(replace(ONE, no_load_current_A=0.13))
    count, sent = helped.command(tau, dq, 12.0)
    assert abs(sent - tau) <= 1.783 * 2.69e-3
    extra = (count - plain.command(tau, dq, 12.0)[0]) * 2.69e-3
    assert extra == pytest.approx(0.13 * math.tanh(dq / 0.1), abs=2.7e-3)


@pytest.mark.parametrize("joint", [ONE, TWO, WRIST, replace(WRIST, ids=(6, 7), reverse=(False, True))])
def test_a_goal_stands_for_the_torque_that_it_was_made_of(joint):
    helped = joint if joint.servo == XL else replace(joint, no_load_current_A=0.13)
    drive = torque_drive(helped)
    for tau, dq in ((0.5, 0.05), (-0.3, 1.5), (0.2, -0.7)):
        count, sent = drive.command(tau, dq, 11.5)
        assert drive.goal_Nm(count, dq, 11.5) == pytest.approx(sent)
        assert sent == pytest.approx(tau, abs=0.02)
        if joint.servo != XL:
            assert drive.measured_Nm([count] * len(joint.ids), dq) == pytest.approx(sent)


def test_a_joint_s_own_torque_constant_goes_before_that_of_its_model():
    count, sent = CurrentDrive(replace(ONE, torque_constant_Nm_per_A=2.0)).command(1.0, 0.0, 12.0)
    assert count == round(1.0 / (2.0 * current_unit_A(ONE.model)))
    assert sent == pytest.approx(count * 2.0 * current_unit_A(ONE.model))


def test_the_current_that_a_joint_needs_is_that_of_its_largest_torque_and_of_its_gears():
    unit = current_unit_A(ONE.model)
    for joint in (ONE, TWO):
        assert CurrentDrive(joint).needed_count == math.ceil(2.0 / (ONE.model.torque_constant_Nm_per_A * unit))
        with_gears = CurrentDrive(replace(joint, no_load_current_A=0.13)).needed_count
        assert with_gears == math.ceil(2.0 / (ONE.model.torque_constant_Nm_per_A * unit) + 0.13 / unit)


@pytest.mark.parametrize(("limit", "count"), [(None, 885), (300, 300), (2000, 885)])
def test_a_servo_s_lower_limit_bounds_its_voltage(limit, count):
    strong = replace(WRIST, tau_max_Nm=50.0)
    assert PwmDrive(strong, limit).command(40.0, 0.0, 12.0)[0] == count
    assert PwmDrive(strong, limit).command(-40.0, 0.0, 12.0)[0] == -count


@given(TORQUE, SPEED, st.floats(10.0, 13.0))
def test_pwm_torque_is_right_where_the_supply_allows_it(tau, dq, supply_V):
    model = SERVOS[XL]
    count, sent = PwmDrive(WRIST).command(tau, dq, supply_V)
    assert abs(count) <= 885
    duty_V = count / 885 * supply_V
    torque = model.stall_torque_Nm_per_V * duty_V - model.back_emf_damping_Nm_s_per_rad * dq  # the data sheet's motor
    assert sent == pytest.approx(torque, abs=1e-9)
    wanted = max(-0.8, min(0.8, tau))
    if abs(count) < 885:
        assert abs(sent - wanted) <= model.stall_torque_Nm_per_V * supply_V / 885
    else:
        assert abs(sent) <= abs(wanted) or sent * wanted <= 0 or abs(dq) > 1.0


def test_pwm_without_back_emf_compensation_would_be_wrong():
    _, standing = PwmDrive(WRIST).command(0.3, 0.0, 12.0)
    count_moving, moving = PwmDrive(WRIST).command(0.3, 2.0, 12.0)
    count_standing, _ = PwmDrive(WRIST).command(0.3, 0.0, 12.0)
    assert moving == pytest.approx(standing, abs=2e-3)
    assert count_moving - count_standing == pytest.approx(1.879 * 2.0 / 12.0 * 885, abs=2)


def test_supply_voltage_counts():
    low, _ = PwmDrive(WRIST).command(0.4, 0.0, 10.0)
    high, _ = PwmDrive(WRIST).command(0.4, 0.0, 12.5)
    assert low / high == pytest.approx(1.25, abs=0.01)


def test_load_is_not_a_torque():
    assert math.isnan(PwmDrive(WRIST).measured_Nm([300], 0.0))


def test_drive_follows_the_servo():
    assert isinstance(torque_drive(ONE), CurrentDrive)
    assert isinstance(torque_drive(WRIST), PwmDrive)
    with pytest.raises(ValueError, match="senses no current"):
        current_unit_A(SERVOS[XL])


@given(st.integers(0, 4095), st.integers(1, 4095), st.integers(0, 4095), st.integers(-20, 20))
def test_angle_is_the_same_for_any_number_of_turns_and_lies_in_the_joint_s_turn(low, width, zero, turns):
    joint = JointMap("j", XM, (1,), (False,), zero, (low, low + width), role=JointRole.HELD)
    scale = AngleScale(joint)
    for tick in (low, low + width // 2, low + width):
        angle = scale.angle_rad(tick)
        assert angle == pytest.approx((tick - zero) * TICK_RAD)
        assert scale.angle_rad(tick + 4096 * turns) == angle
        assert scale.limits_rad[0] - 1e-9 <= angle <= scale.limits_rad[1] + 1e-9


# --- budget ---------------------------------------------------------------------------------------------------------


def test_wire_times_are_the_bytes_times_their_duration():
    link = LinkTiming(turnaround_s=0.0, fast_gap_s=0.0, usb_latency_s=0.0)
    budget = cycle_budget(WX200, fast=True, link=link)
    assert budget.request_s == pytest.approx(21 * 10e-6)
    assert budget.reply_s == pytest.approx((8 + 14 * 7) * 10e-6)
    assert budget.write_s == pytest.approx((14 + 3 * 3 + 14 + 3) * 10e-6)


def test_a_faster_bus_carries_a_higher_rate_and_plain_reads_a_lower_one():
    rates = [cycle_budget(at(WX200, baud=b), fast=True).rate_max_hz for b in (57_600, 1_000_000, 3_000_000)]
    assert rates == sorted(rates)
    assert rates[0] < 40
    assert rates[1] >= 290
    assert rates[2] >= 450
    assert cycle_budget(WX200, fast=False).rate_max_hz < rates[1]


def test_rate_above_the_budget_is_refused_with_the_highest_that_fits():
    highest = cycle_budget(WX200, fast=True).rate_max_hz
    check_rate(at(WX200, rate_hz=highest), fast=True)
    with pytest.raises(PaceError, match=f"expected at most {highest:g} Hz"):
        check_rate(at(WX200, rate_hz=highest + 1), fast=True)


def test_checks_shrink_with_the_gap():
    counts = []
    for rate_hz in (200.0, 250.0, 280.0, 400.0):
        arm = at(WX200, rate_hz=rate_hz)
        counts.append(health_servos_per_gap(arm, cycle_budget(arm, fast=True), fast=True))
    assert counts == sorted(counts, reverse=True)
    assert (counts[0], counts[-1]) == (7, 0)


def test_there_are_more_marks_than_cycles_a_servo_may_stay_silent():
    assert MARKS > SILENT_LIMIT_CYCLES


# --- thermal --------------------------------------------------------------------------------------------------------


def heated(start_C: float, final_C: float, seconds: float) -> ThermalWatch:
    watch = ThermalWatch(80.0)
    for k in range(int(seconds * 4)):
        t = k / 4
        watch.add(t, float(round(final_C + (start_C - final_C) * math.exp(-t / 180.0))))
    return watch


def test_a_servo_that_will_overheat_is_known_before_it_does():
    watch = heated(60.0, 95.0, 40.0)
    assert watch.heating
    assert not watch.hot
    assert watch.final_C == pytest.approx(95.0, abs=12.0)


def test_a_servo_that_settles_below_its_limit_is_left_alone():
    assert not heated(60.0, 68.0, 60.0).heating
    assert not heated(30.0, 45.0, 60.0).hot


def test_a_servo_near_its_limit_is_hot_at_once():
    watch = ThermalWatch(80.0)
    assert not watch.hot
    watch.add(0.0, 75.0)
    assert watch.hot
    assert watch.final_C is None
