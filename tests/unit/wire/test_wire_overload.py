"""Overload of an emulated servo: by current and time, in the modes that an option names."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import HardwareError, Instruction, OperatingMode
from drivers.dynamixel.servo.models import SERVOS
from sim_backend.wire.options import ServoOptions
from sim_backend.wire.overload import REPORTED, OverloadModes, OverloadWatch
from tests.support.servos.dxl_rig import build
from tests.support.servos.wire_bench import Bench, xl430, xm430

XM = SERVOS["XM430-W350"]
REPORTED_A, REPORTED_S = 350 * 2.69e-3, 5.0  # what an owner saw: "around 5 s"
FINE_A = 0.2 * XM.stall_current_A  # what the maker advises for long
MODES = {
    OperatingMode.POSITION, OperatingMode.EXTENDED_POSITION, OperatingMode.CURRENT_BASED_POSITION,
    OperatingMode.VELOCITY,
}  # fmt: skip


def trips_after_s(current_A: float, mode: OperatingMode, modes: OverloadModes, until_s: float = 20.0) -> float | None:
    """When a constant current trips a watch; None: not by `until_s`."""
    watch = OverloadWatch(replace(REPORTED, modes=modes), XM.stall_current_A)
    for step in range(round(until_s / 0.005)):
        if watch.step(0.005, current_A, mode):
            return (step + 1) * 0.005
    return None


@pytest.mark.parametrize("mode", list(OperatingMode))
@pytest.mark.parametrize("modes", list(OverloadModes))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_reported_load_trips_at_the_reported_time_in_the_modes_that_are_watched(
    mode: OperatingMode, modes: OverloadModes, sign: float
) -> None:
    watched = modes is OverloadModes.ALL or (modes is OverloadModes.CLOSED_LOOP and mode in MODES)
    expected = pytest.approx(REPORTED_S, abs=0.02) if watched else None
    assert trips_after_s(sign * REPORTED_A, mode, modes) == expected


def test_the_load_that_the_maker_advises_for_long_never_trips() -> None:
    assert trips_after_s(FINE_A, OperatingMode.POSITION, OverloadModes.ALL, until_s=60.0) is None


def test_a_load_that_comes_and_goes_is_none() -> None:
    watch = OverloadWatch(REPORTED, XM.stall_current_A)
    for second in range(60):
        current_A = 2.0 if second % 8 < 4 else 0.1
        assert not any(watch.step(0.005, current_A, OperatingMode.POSITION) for _ in range(200))


def test_a_change_of_mode_and_a_reset_begin_anew() -> None:
    watch = OverloadWatch(REPORTED, XM.stall_current_A)
    for begin_anew in (lambda: watch.step(0.005, 2.0, OperatingMode.CURRENT), watch.reset):
        assert not any(watch.step(0.01, 2.0, OperatingMode.POSITION) for _ in range(499))
        begin_anew()
    assert not any(watch.step(0.01, 2.0, OperatingMode.POSITION) for _ in range(499))


def blocked(mode: OperatingMode, modes: OverloadModes, **eeprom: int) -> Bench:
    """A servo whose horn cannot move, and which is told to."""
    options = ServoOptions(overload=replace(REPORTED, modes=modes))
    bench = Bench(xm430(options=options, operating_mode=mode, **eeprom))
    assert bench.write(1, table.TORQUE_ENABLE, 1) == 0
    goals = {OperatingMode.CURRENT: (table.GOAL_CURRENT, 500), OperatingMode.VELOCITY: (table.GOAL_VELOCITY, 100)}
    register, value = goals.get(mode, (table.GOAL_POSITION, 3500))
    assert bench.write(1, register, value) == 0
    return bench


@pytest.mark.parametrize("mode", [OperatingMode.POSITION, OperatingMode.CURRENT_BASED_POSITION, OperatingMode.VELOCITY])
def test_a_blocked_servo_trips_and_loses_its_torque_until_it_restarts(mode: OperatingMode) -> None:
    bench = blocked(mode, OverloadModes.CLOSED_LOOP)
    bench.pass_time(4_500, 5.0)
    assert bench.read(1, table.TORQUE_ENABLE) == 1
    bench.pass_time(2_000, 5.0)
    assert bench.read(1, table.HARDWARE_ERROR_STATUS) == HardwareError.OVERLOAD
    assert bench.read(1, table.TORQUE_ENABLE) == 0


def test_a_blocked_servo_with_a_lower_current_limit_trips_as_well() -> None:
    bench = blocked(OperatingMode.CURRENT_BASED_POSITION, OverloadModes.CLOSED_LOOP, current_limit=400)
    bench.pass_time(6_000, 5.0)
    assert bench.read(1, table.HARDWARE_ERROR_STATUS) == HardwareError.OVERLOAD


@pytest.mark.parametrize("modes", list(OverloadModes))
def test_current_mode_trips_where_the_option_says_so(modes: OverloadModes) -> None:
    bench = blocked(OperatingMode.CURRENT, modes)
    bench.pass_time(6_000, 5.0)
    expected = HardwareError.OVERLOAD if modes is OverloadModes.ALL else 0
    assert bench.read(1, table.HARDWARE_ERROR_STATUS) == expected
    assert bench.read(1, table.TORQUE_ENABLE) == (modes is not OverloadModes.ALL)


def test_a_restart_begins_anew() -> None:
    bench = blocked(OperatingMode.POSITION, OverloadModes.CLOSED_LOOP)
    bench.pass_time(4_500, 5.0)
    bench.one(1, Instruction.REBOOT)
    bench.pass_time(305, 5.0)
    bench.write(1, table.TORQUE_ENABLE, 1)
    bench.write(1, table.GOAL_POSITION, 3500)
    bench.pass_time(4_500, 5.0)
    assert bench.read(1, table.HARDWARE_ERROR_STATUS) == 0


def test_an_arm_tells_its_servos_how_much_time_has_passed() -> None:
    rig = build()
    rig.put(1, table.HARDWARE_ERROR_STATUS, 0)
    servo = rig.servo(1)
    next(joint for joint in rig.cell.arms[0].joints if joint.name == "waist").free.inertia_kg_m2 = 1e9  # blocked
    servo.firmware.accept(table.TORQUE_ENABLE, 1)
    servo.firmware.accept(table.GOAL_POSITION, 3500)
    for second, error in ((4.5, 0), (5.5, HardwareError.OVERLOAD)):
        rig.clock.sleep_until(10_000_000_000 + round(second * 1e9))
        assert rig.get(1, table.HARDWARE_ERROR_STATUS) == error


def test_without_overload_in_its_shutdown_mask_a_servo_goes_on() -> None:
    bench = blocked(OperatingMode.POSITION, OverloadModes.CLOSED_LOOP, shutdown=0x14)
    bench.pass_time(6_000, 5.0)
    assert bench.read(1, table.HARDWARE_ERROR_STATUS) == HardwareError.OVERLOAD
    assert bench.read(1, table.TORQUE_ENABLE) == 1


def test_the_threshold_is_a_share_of_the_servo_s_own_stall_current() -> None:
    """A load of 0.7 A is light for an XM430 and half of what an XL430 can."""
    for servo, trips in ((xl430(), True), (xm430(), False)):
        bench = Bench(servo)
        bench.write(1, table.TORQUE_ENABLE, 1)
        motor = servo.firmware.body.motor
        bench.write(1, table.GOAL_PWM, round(885 * 0.7 * motor.data.resistance_ohm / 12.0))
        bench.write(1, table.GOAL_POSITION, 4000)
        bench.pass_time(6_000, 5.0)
        assert abs(motor.current_A) == pytest.approx(0.0 if trips else 0.7, abs=0.02)
        assert (bench.read(1, table.HARDWARE_ERROR_STATUS) == HardwareError.OVERLOAD) == trips
