"""Bring-up and refusals, on emulated servos in virtual time: nothing jerks, nothing wrong gets torque."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.dynamixel.arm_map import JointMap, JointRole, MapError
from drivers.dynamixel.bringup import PoseError
from drivers.dynamixel.errors import NotEnabledError, PortError
from drivers.dynamixel.identify import IdentityError
from drivers.dynamixel.line import codec
from drivers.dynamixel.pace import PaceError
from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import Instruction, OperatingMode, StatusError
from drivers.dynamixel.servo.counts import TICK_RAD
from drivers.interface import ConnectError, DriverError
from sim_backend.wire.faults import FaultKind
from sim_backend.wire.options import GoalAtTorqueOn, ServoOptions
from sim_backend.wire.timing import BusTiming, UsbTiming
from tests.support.servos.dxl_rig import START, WX200, XL, XM, at, build, enabled

IDS = [1, 2, 3, 4, 5, 6, 7]


def writes(rig) -> list[tuple[int, int, bytes]]:
    """(first servo, address, data) of every write the driver has sent, in order."""
    found = []
    for data in rig.port.writes:
        for packet in data.split(codec.HEADER)[1:]:
            servo_id, code, body = packet[0], packet[3], packet[4:-2]
            if code == Instruction.WRITE:
                found.append((servo_id, body[0] | body[1] << 8, body[2:]))
            elif code == Instruction.SYNC_WRITE:
                found.append((body[4], body[0] | body[1] << 8, body[5 : 5 + (body[2] | body[3] << 8)]))
    return found


def torque_never_on(rig) -> bool:
    asked = any(address == 64 and data != b"\0" for _, address, data in writes(rig))
    return not asked and all(rig.get(s.id, table.TORQUE_ENABLE) == 0 for s in rig.bus.servos)


@pytest.mark.fault("P9")
def test_connect_leaves_the_arm_as_it_is():
    rig = build()
    rig.put(2, table.GOAL_CURRENT, 7)
    info = rig.driver.connect()
    assert writes(rig) == []
    assert rig.get(2, table.GOAL_CURRENT) == 7
    assert info.joints == ("shoulder", "elbow", "wrist_angle", "wrist_rotate")
    assert info.tau_max_Nm.tolist() == [4.0, 2.0, 2.0, 0.5]


@pytest.mark.fault("S7")
def test_every_servo_gets_mode_then_goal_then_watchdog_then_torque():
    rig = enabled()
    order = writes(rig)
    torque = next(i for i, (_, address, _) in enumerate(order) if address == 64)
    for servo_id in (2, 4, 5):
        mode = next(i for i, w in enumerate(order) if w[:2] == (servo_id, 11))
        goal = next(i for i, w in enumerate(order) if w[:2] == (servo_id, 102))
        armed = next(i for i, w in enumerate(order) if w == (servo_id, 98, b"\x0a"))
        assert mode < goal < armed < torque
        assert order[goal][2] == b"\0\0"
    assert [rig.get(i, table.TORQUE_ENABLE) for i in IDS] == [1] * 7
    assert [rig.get(i, table.BUS_WATCHDOG) for i in IDS] == [10] * 7


def test_shadow_is_never_sent_a_goal_and_follows():
    rig = enabled()
    rig.driver.write(np.array([1.0, 0.0, 0.0, 0.0]))
    assert all(address not in (64, 100, 102, 116) for servo_id, address, _ in writes(rig) if servo_id == 3)
    assert rig.get(3, table.GOAL_CURRENT) == rig.get(2, table.GOAL_CURRENT) != 0


def test_modes_are_those_the_servos_can_do():
    rig = enabled()
    modes = {i: OperatingMode(rig.get(i, table.OPERATING_MODE)) for i in IDS}
    current = OperatingMode.CURRENT
    held = OperatingMode.CURRENT_BASED_POSITION
    assert modes == {
        1: held, 2: current, 3: current, 4: current, 5: current, 6: OperatingMode.PWM, 7: OperatingMode.POSITION
    }  # fmt: skip


@pytest.mark.parametrize("at_torque_on", list(GoalAtTorqueOn))
def test_nothing_moves_when_torque_comes_on(at_torque_on):
    rig = build(servo_options=ServoOptions(goal_at_torque_on=at_torque_on))
    for servo_id in IDS:
        rig.put(servo_id, table.GOAL_POSITION, 1000)
    rig.put(1, table.OPERATING_MODE, 5)  # its goals are what an earlier program left
    before = [joint.free.q_rad for joint in rig.cell.arms[0].joints]
    rig.driver.connect()
    rig.driver.enable()
    for _ in range(40):
        rig.clock.sleep_until(rig.clock.now_ns() + 5_000_000)
        rig.driver.read()
    after = [joint.free.q_rad for joint in rig.cell.arms[0].joints]
    assert np.abs(np.subtract(after, before)).max() < 2e-3  # a tick is 1.5e-3


def test_held_joints_are_limited():
    rig = enabled()
    assert rig.get(1, table.GOAL_CURRENT) == round(0.4 * 2300 / 2.69), "the waist holds with 0.4 of its stall torque"
    assert rig.get(7, table.GOAL_PWM) == round(0.4 * 885)


def test_eeprom_is_written_once_and_reported():
    rig = build(eeprom={"Return_Delay_Time": 250})
    rig.driver.connect()
    rig.driver.enable()
    told = [(event.servo_id, event.text) for event in rig.events]
    assert (4, "Operating Mode 3 → 0") in told
    assert (4, "Return Delay Time 250 → 0") in told
    assert (7, "Operating Mode 3 → 3") not in told
    rig.driver.disable()
    rig.driver.close()
    rig.events.clear()
    rig.port.writes.clear()
    rig.driver.connect()
    rig.driver.enable()
    assert rig.events == []
    assert all(address >= 64 for _, address, _ in writes(rig))


def test_torque_on_by_goal_update_is_switched_off_first():
    rig = build()
    rig.put(2, table.DRIVE_MODE, 8)
    rig.driver.connect()
    rig.driver.enable()
    assert rig.get(2, table.DRIVE_MODE) == 0
    order = writes(rig)
    assert order.index((2, 10, b"\0")) < order.index((2, 102, b"\0\0"))


# --- refusals -------------------------------------------------------------------------------------------------------


def start(rig) -> None:
    rig.driver.connect()
    rig.driver.enable()


def refused(rig, error, match) -> ConnectError:
    with pytest.raises(error, match=match) as caught:
        start(rig)
    assert torque_never_on(rig)
    return caught.value


@pytest.mark.fault("G3")
def test_missing_servo():
    rig = build()
    rig.servo(5).deaf = True
    error = refused(rig, IdentityError, r"servo 5 \(wrist_angle\): found nothing in 2 attempts")
    assert error.servo_id == 5
    assert not rig.port.is_open


def test_all_problems_are_kept():
    rig = build()
    rig.servo(5).deaf = True
    rig.put(4, table.HOMING_OFFSET, 12)
    refused(rig, IdentityError, "servo 5")
    assert [problem.servo_id for problem in rig.driver.problems] == [5, 4]


def test_extra_servo():
    more = (*WX200.joints, JointMap("camera", XL, (9,), (False,), role=JointRole.HELD))
    error = refused(build(emulated=at(WX200, joints=more)), IdentityError, "servo 9 .* does not know")
    assert error.servo_id == 9


@pytest.mark.fault("B8")
def test_two_servos_with_one_id():
    rig = build()
    rig.put(7, table.ID, 6)
    error = refused(rig, IdentityError, r"servo 6 \(wrist_rotate\): found damaged .* two servos may have this ID")
    assert error.servo_id == 6


@pytest.mark.fault("G3")
def test_wrong_model():
    other = tuple(replace(j, servo=XM) if j.name == "wrist_rotate" else j for j in WX200.joints)
    rig = build(emulated=at(WX200, joints=other))
    refused(rig, IdentityError, r"servo 6 \(wrist_rotate\): model: found XM430-W350, expected XL430-W250")


@pytest.mark.fault("G5")
def test_old_firmware():
    """One that really is so old has no Drive Mode register to be set up with, so a newer one says that it is."""
    rig = build()
    rig.servo(4).firmware.version = 37
    refused(rig, IdentityError, r"servo 4 \(elbow\): firmware: found 37, expected 38 or newer")


def test_no_power():
    rig = build()
    for servo_id in IDS:
        rig.servo(servo_id).deaf = True
    refused(rig, IdentityError, "none that answers, at any speed.*12 V supply")
    assert rig.port.baud == WX200.baud


@pytest.mark.parametrize("stays_set", [True, False])
def test_a_port_that_is_lost_while_servos_are_looked_for_at_other_speeds_is_refused_and_may_come_back(
    monkeypatch: pytest.MonkeyPatch, stays_set: bool
) -> None:
    """stays_set: it takes a speed while it is gone; a real one does not."""
    rig, speeds = build(), []

    def set_baud(baud: int) -> None:
        speeds.append(baud)
        if rig.port.gone and not stays_set:
            raise PortError("port virtual: speed", found="no such device", expected="a speed", remedy="none")
        rig.port.baud = baud
        rig.port.gone = rig.port.gone or len(speeds) == 2

    rig.fault(FaultKind.SILENT)
    monkeypatch.setattr(rig.port, "set_baud", set_baud)
    refused(rig, PortError, "^port virtual: found closed, expected open")
    assert (rig.port.baud == WX200.baud) == stays_set
    assert speeds[-1] == WX200.baud, "asked for in any case"
    rig.port.gone = False
    rig.injector.clear(rig.clock.now_ns())
    rig.driver.connect()
    assert rig.port.baud == WX200.baud


def test_counts_of_the_bus_go_on_over_a_second_connect():
    rig = build()
    rig.driver.connect()
    rig.driver.counters.timeouts, rig.driver.counters.per_servo[3] = 7, 4
    rig.driver.connect()
    assert (rig.driver.counters.timeouts, rig.driver.counters.per_servo) == (7, {3: 4})


@pytest.mark.fault("B10")
def test_wrong_speed_is_named():
    rig = build(at(WX200, baud=3_000_000), emulated=WX200)
    refused(rig, IdentityError, "answers at 1000000 bit/s, expected 3000000 bit/s")


@pytest.mark.parametrize(
    ("register", "servo_id", "value", "match"),
    [
        (table.DRIVE_MODE, 4, 0, r"Drive Mode, direction: found normal \(bit 0 clear\), expected reverse"),
        (table.SECONDARY_ID, 3, 255, "Secondary ID: found 255, expected 2"),
        (table.SECONDARY_ID, 5, 4, "Secondary ID: found 4, expected 255"),
        (table.HOMING_OFFSET, 2, 100, "Homing Offset: found 100, expected 0"),
        (table.CURRENT_LIMIT, 2, 100, "Current Limit: found 100, expected at least 418"),
    ],
)
@pytest.mark.fault("G4", "G5")
def test_what_says_how_the_arm_is_built_is_not_overwritten(register, servo_id, value, match):
    rig = build()
    rig.put(servo_id, register, value)
    refused(rig, IdentityError, match)
    assert rig.get(servo_id, register) == value


def test_shadow_may_have_a_homing_offset():
    rig = build()
    rig.put(3, table.HOMING_OFFSET, 5)
    rig.driver.connect()


def test_hardware_error_at_start():
    rig = build()
    rig.fault(FaultKind.OVERLOAD, 4)
    rig.clock.sleep_until(rig.clock.now_ns() + 5_000_000)
    refused(rig, IdentityError, r"servo 4 \(elbow\): hardware error: found OVERLOAD")


@pytest.mark.fault("G3")
def test_arm_far_from_its_start_pose():
    rig = build(at(WX200, joints=tuple(replace(j, start_rad=1.0) if j.name == "elbow" else j for j in WX200.joints)))
    refused(
        rig,
        PoseError,
        r"servo 4 \(elbow\): start pose: found 0.699 rad, expected 0.850.*; one that lies at its rest .* --whole$",
    )
    lying = (replace(j, start_rad=1.0, at_rest=True) if j.name == "elbow" else j for j in WX200.joints)
    refused(build(at(WX200, joints=tuple(lying))), PoseError, r"\(elbow\): rest pose: found 0.699 rad, expected 0.850")


@pytest.mark.parametrize(("beyond_ticks", "fits"), [(15, True), (25, False)])  # END_STOP_RAD is 19.6 of them
def test_an_arm_that_lies_on_an_end_stop_starts(beyond_ticks: int, fits: bool):
    elbow = next(joint for joint in WX200.joints if joint.name == "elbow")
    limit = elbow.zero_tick + round(START["elbow"] / TICK_RAD) - beyond_ticks
    narrow = replace(elbow, position_limit_ticks=(elbow.position_limit_ticks[0], limit))
    rig = build(at(WX200, joints=tuple(narrow if joint is elbow else joint for joint in WX200.joints)))
    if fits:
        rig.driver.connect()
        rig.driver.enable()
        assert rig.get(4, table.TORQUE_ENABLE) == 1
    else:
        refused(rig, PoseError, r"servo 4 \(elbow\): start pose: found 0.6")


@pytest.mark.fault("P9")
def test_torque_found_on():
    rig = build()
    rig.put(4, table.TORQUE_ENABLE, 1)
    rig.driver.connect()
    with pytest.raises(IdentityError, match="torque: found on already, expected off"):
        rig.driver.enable()
    assert rig.get(2, table.TORQUE_ENABLE) == 0


@pytest.mark.fault("B10")
def test_slow_latency_timer_measured():
    slow = BusTiming(usb=UsbTiming(latency_ns=16_000_000))
    refused(build(timing=slow), PaceError, "latency timer to 1 ms")


@pytest.mark.fault("B10")
def test_slow_latency_timer_as_the_kernel_says():
    rig = build()
    rig.port.latency_timer_ms = 16
    refused(rig, PortError, "USB latency timer: found 16 ms, expected 1 ms")


@pytest.mark.fault("B10")
def test_rate_that_the_wire_cannot_carry():
    refused(build(at(WX200, rate_hz=800.0)), PaceError, r"found 800 Hz, expected at most \d+ Hz for 7 servos")


def test_servo_that_answers_pings_only_is_still_found():
    rig = build()
    rig.put(4, table.STATUS_RETURN_LEVEL, 0)
    rig.driver.connect()
    assert rig.get(4, table.STATUS_RETURN_LEVEL) == 2
    rig.driver.close()
    rig.put(4, table.STATUS_RETURN_LEVEL, 0)
    rig.servo(4).write = lambda *_, **__: StatusError.NONE
    refused(rig, IdentityError, r"servo 4 \(elbow\): .* though it answers pings, .*; check its cable: the bus is not")


def test_failure_half_way_ends_with_torque_off():
    rig = build()
    rig.driver.connect()
    really = rig.driver._bus.write_blind

    def cut(register, values):
        if register is table.TORQUE_ENABLE and 1 in values.values():
            values = {i: v for i, v in values.items() if i != 5}  # the packet reaches all but one
        really(register, values)

    rig.driver._bus.write_blind = cut
    told = r"servo 5 \(wrist_angle\): torque could not be switched on: .*; the arm has no torque; then read the servo"
    with pytest.raises(DriverError, match=told):
        rig.driver.enable()
    assert [rig.get(i, table.TORQUE_ENABLE) for i in IDS] == [0] * 7


def test_a_register_that_does_not_keep_what_is_written_is_named():
    rig = build()
    rig.driver.connect()
    memory = rig.servo(4).firmware.memory
    really = memory.put
    memory.put = lambda register, value: None if register.name == "Return Delay Time" else really(register, value)
    really(table.RETURN_DELAY_TIME, 9)
    rig.driver.connect()
    with pytest.raises(DriverError, match="a register does not hold what was written: found Return Delay Time 9"):
        rig.driver.enable()
    assert torque_never_on(rig)


# --- order of calls -------------------------------------------------------------------------------------------------


def test_calls_out_of_order_are_refused():
    rig = build()
    with pytest.raises(NotEnabledError, match="found no connection, expected a connection"):
        rig.driver.read()
    rig.driver.connect()
    rig.driver.read()
    with pytest.raises(NotEnabledError, match="found a connection, expected torque on"):
        rig.driver.write(np.zeros(4))


def test_disable_and_close_are_safe_always():
    rig = build()
    rig.driver.disable()
    rig.driver.close()
    rig.driver.connect()
    rig.driver.disable()
    rig.driver.enable()
    rig.driver.disable()
    rig.driver.disable()
    assert [rig.get(i, table.TORQUE_ENABLE) for i in IDS] == [0] * 7
    assert [rig.get(i, table.BUS_WATCHDOG) for i in IDS] == [0] * 7
    rig.driver.enable()
    rig.port.lost = True
    rig.driver.disable()
    rig.driver.close()
    rig.driver.close()


# --- maps that cannot be --------------------------------------------------------------------------------------------


def changed(which: str, **more):
    return tuple(replace(j, **more) if j.name == which else j for j in WX200.joints)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"joints": changed("elbow", ids=(5,))}, "servo IDs: .* different IDs"),
        ({"joints": changed("elbow", name="shoulder")}, "joints: .* different names"),
        ({"joints": changed("elbow", servo="AX-12A")}, "elbow: servo: found AX-12A.*Protocol 2.0 only"),
        ({"joints": changed("elbow", reverse=(True, False))}, "one entry per servo"),
        ({"joints": changed("elbow", position_limit_ticks=(0, 4096))}, "less than a turn apart"),
        ({"joints": changed("elbow", tau_max_Nm=9.0)}, "at most the stall torque 4.1"),
        ({"joints": changed("elbow", tau_max_Nm=float("nan"))}, "tau_max_Nm: found nan"),
        ({"joints": changed("waist", hold_effort=0.0)}, "hold_effort"),
        ({"watchdog_s": 0.25}, "multiple of 0.02"),
        ({"rate_hz": 5.0}, "rate_hz: found 5.0, expected above 10"),
    ],
)
def test_contradictory_maps_are_refused(change, match):
    with pytest.raises(MapError, match=match):
        at(WX200, **change)
