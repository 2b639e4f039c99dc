"""The gripper of an arm through the real driver on emulated servos: told a width, it goes there and says so."""

from __future__ import annotations

import contextlib
from dataclasses import replace

import numpy as np
import pytest

from drivers.dynamixel.arm_map import MapError
from drivers.dynamixel.driver import DynamixelDriver
from drivers.dynamixel.errors import DxlServoFault, FaultCause, NoGripperError, NotEnabledError
from drivers.dynamixel.grip import GripControl
from drivers.dynamixel.servo.models import SERVOS
from drivers.dynamixel.servo.table import BUS_WATCHDOG, GOAL_POSITION, GOAL_PWM, TORQUE_ENABLE, Register
from drivers.interface import Gripper
from tests.support.servos.copied_rig import brought_up
from tests.support.servos.dxl_rig import FINGERS, Rig, build, enabled, loses, with_gripper

GRIPPER, EFFORT = 7, round(0.25 * 885)


def cycles(rig: Rig, count: int) -> None:
    for _ in range(count):
        begin_ns = rig.clock.now_ns()
        rig.driver.read()
        rig.driver.write(np.zeros(4))
        rig.clock.sleep_until(begin_ns + rig.arm.period_ns)


def test_a_width_goes_out_with_the_next_torque_and_the_fingers_follow() -> None:
    rig = brought_up(with_gripper())
    cycles(rig, 3)
    before = rig.get(GRIPPER, GOAL_POSITION)
    rig.driver.grip(0.074)
    assert rig.get(GRIPPER, GOAL_POSITION) == before, "grip itself touches no bus"
    cycles(rig, 2)
    assert rig.get(GRIPPER, GOAL_POSITION) == 2875
    assert rig.get(GRIPPER, GOAL_PWM) == EFFORT
    cycles(rig, 300)
    state = rig.driver.grip_state()
    assert state is not None
    assert state.width_m == pytest.approx(0.074, abs=1e-3)
    assert abs(state.speed_m_per_s) < 1e-3
    assert state.width_cmd_m == pytest.approx(0.074, abs=1e-4)
    assert rig.driver.faults == [], "the goal that is checked in the gaps is the new one"


@pytest.mark.parametrize("register", [GOAL_POSITION, GOAL_PWM], ids=lambda register: register.name)
@pytest.mark.parametrize("after_watchdogs", [False, True])
@pytest.mark.fault("B1", "F9")
def test_a_width_of_which_a_packet_gets_lost_is_gone_to_all_the_same(register: Register, after_watchdogs: bool) -> None:
    rig = brought_up(with_gripper())
    if after_watchdogs:
        rig.driver.grip(0.03)
        cycles(rig, 3)
        rig.driver.rearm()
    else:
        rig.driver.grip(0.03)
    loses(rig, register, value={GOAL_POSITION: 1802, GOAL_PWM: EFFORT}[register])
    cycles(rig, 3)
    assert (rig.get(GRIPPER, GOAL_POSITION), rig.get(GRIPPER, GOAL_PWM)) == (1802, EFFORT)


def test_fingers_that_close_say_a_positive_effort_and_a_force() -> None:
    rig = brought_up(with_gripper())
    rig.driver.grip(0.03)
    cycles(rig, 15)
    state = rig.driver.grip_state()
    assert state is not None
    assert state.speed_m_per_s < 0.0
    assert 0.05 < state.effort <= 0.26
    stall_Nm, lever = SERVOS["XL430-W250"].stall_torque_Nm, FINGERS.lever(FINGERS.angle(state.width_m))
    assert state.force_N == pytest.approx(state.effort * stall_Nm / lever)
    assert state.force_max_N == pytest.approx(EFFORT / 885 * stall_Nm / lever)
    assert state.width_cmd_m == pytest.approx(0.03, abs=1e-4)


@pytest.mark.parametrize("limit", [500, 885])
def test_a_lower_limit_of_its_servo_takes_nothing_from_a_grip(limit: int) -> None:
    """`coop check` counts on the share of stall torque that the arm file names."""
    rig = enabled(with_gripper(), eeprom={"PWM_Limit": limit})
    rig.driver.grip(0.03)
    cycles(rig, 3)
    assert rig.get(GRIPPER, GOAL_PWM) == EFFORT
    state = rig.driver.grip_state()
    assert state is not None
    lever = FINGERS.lever(FINGERS.angle(state.width_m))
    assert state.force_max_N == pytest.approx(EFFORT / 885 * SERVOS["XL430-W250"].stall_torque_Nm / lever)


@pytest.mark.parametrize("limit", [400, 1193])
@pytest.mark.parametrize(("servo", "count", "stall_Nm"), [("XM430-W350", 214, 4.1), ("MX-64", 305, 6.0)])
def test_a_grip_by_current_is_a_share_of_the_stall_torque(servo: str, count: int, stall_Nm: float, limit: int) -> None:
    joint = replace(with_gripper().joints[-1], servo=servo)
    grip = GripControl(joint, FINGERS, limit)
    assert grip.effort == count
    state = grip.state((0, count, 0, 2048), 0)
    assert abs(state.effort) == pytest.approx(0.25, abs=1e-3)
    lever = abs(FINGERS.lever(FINGERS.angle(state.width_m)))
    assert abs(state.force_N) == pytest.approx(0.25 * stall_Nm / lever, rel=3e-3), "as `coop check` counts it"
    assert state.force_max_N == pytest.approx(abs(state.force_N))
    assert GripControl(joint, FINGERS, 100).effort == 100, "more than its limit a servo refuses"


def test_the_grip_is_taken_up_again_after_the_watchdogs_have_fired() -> None:
    rig = brought_up(with_gripper())
    rig.driver.grip(0.03)
    cycles(rig, 10)
    rig.clock.sleep_until(rig.clock.now_ns() + 300_000_000)
    assert rig.servo(GRIPPER).firmware.tripped
    rig.driver.rearm()
    cycles(rig, 2)
    assert rig.get(GRIPPER, GOAL_POSITION) == 1802
    assert rig.get(GRIPPER, GOAL_PWM) == EFFORT
    assert rig.get(GRIPPER, TORQUE_ENABLE) == 1
    assert rig.get(GRIPPER, BUS_WATCHDOG) > 0


@pytest.mark.fault("B1", "S6")
def test_a_grip_is_no_ignored_goal_after_an_attempt_that_failed_and_is_taken_up_again_after_the_next() -> None:
    rig = brought_up(with_gripper())
    rig.driver.grip(0.03)
    cycles(rig, 10)
    loses(rig, BUS_WATCHDOG, 1, 2, 4, 5, GRIPPER, value=10, count=3)
    with pytest.raises(DxlServoFault, match="Bus Watchdog 0"):
        rig.driver.rearm()
    for _ in range(20):
        with contextlib.suppress(DxlServoFault):
            rig.driver.read()
        rig.driver.write(np.zeros(4))
        rig.clock.sleep_until(rig.clock.now_ns() + 3_000_000)
    assert {fault.cause for fault in rig.driver.faults} == {FaultCause.WATCHDOG_TRIPPED}
    assert rig.driver.recover() is True
    cycles(rig, 2)
    assert (rig.get(GRIPPER, GOAL_POSITION), rig.get(GRIPPER, GOAL_PWM)) == (1802, EFFORT)


def test_the_driver_is_a_gripper_too_and_says_when_it_has_none() -> None:
    rig = brought_up()
    assert isinstance(rig.driver, Gripper)
    assert rig.driver.grip_state() is None
    with pytest.raises(NoGripperError, match=r"found none that its file describes well enough, expected closed_tick"):
        rig.driver.grip(0.05)
    without_torque = connected()
    assert without_torque.grip_state() is None, "nothing has been read yet"
    with pytest.raises(NotEnabledError, match="torque on"):
        without_torque.grip(0.05)


def connected() -> DynamixelDriver:
    rig = build(with_gripper())
    rig.driver.connect()
    return rig.driver


@pytest.mark.parametrize("effort", [0.0, 1.1])
def test_an_effort_that_is_no_share_is_refused(effort: float) -> None:
    with pytest.raises(MapError, match="grip_effort"):
        with_gripper(grip_effort=effort)
