"""The driver between its caller and the arm: what it may be asked when, what it refuses, what it passes on."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.clock import MonotonicClock
from drivers.dynamixel.budget import LinkTiming
from drivers.dynamixel.driver import DynamixelDriver
from drivers.dynamixel.errors import (
    DxlServoFault,
    FaultCause,
    NotEnabledError,
    PortError,
    PortLostError,
)
from drivers.dynamixel.identify import IdentityError
from drivers.dynamixel.line import codec
from drivers.dynamixel.line.bus import Exchange
from drivers.dynamixel.monitor import Page
from drivers.dynamixel.pace import PaceError
from drivers.dynamixel.servo import table
from sim_backend.wire.faults import FaultKind
from sim_backend.wire.timing import BusTiming
from tests.support.servos.copied_rig import brought_up
from tests.support.servos.dxl_rig import WX200, Rig, VirtualPort, at, build, enabled

NO_CONNECTION = "found no connection, expected a connection"
NO_TORQUE = "found a connection, expected torque on"
WIRE = BusTiming()


class StrictPort(VirtualPort):
    """Refuses to be opened twice, and counts how often it was."""

    opened = 0

    def open(self) -> None:
        assert not self.is_open, "open already"
        self.opened += 1
        super().open()


def on(rig: Rig, **more: Any) -> tuple[DynamixelDriver, StrictPort]:
    """Another driver for that arm, with a strict port."""
    port = StrictPort(rig.line, rig.arm.baud)
    more.setdefault("scan_s", 0.05)
    return DynamixelDriver(rig.arm, rig.clock, on_event=rig.events.append, port=port, **more), port


# --- coming ----------------------------------------------------------------------------------------------------------


def test_before_connect_nothing_may_be_asked_and_closing_is_safe() -> None:
    driver, _ = on(build())
    for call in (driver.read, driver.enable, driver.reopen, driver.health):
        with pytest.raises(NotEnabledError, match=NO_CONNECTION) as caught:
            call()
        assert "connect() and, for torque, enable() first" in caught.value.remedy
    for call in (driver.rearm, lambda: driver.write(np.zeros(4))):
        with pytest.raises(NotEnabledError, match="found no connection, expected torque on"):
            call()
    driver.disable()
    driver.close()


def test_without_torque_it_may_be_read_and_not_commanded() -> None:
    driver, _ = on(build())
    driver.connect()
    assert np.isfinite(driver.read().q).all()
    for call in (driver.rearm, lambda: driver.write(np.zeros(4))):
        with pytest.raises(NotEnabledError, match=NO_TORQUE):
            call()


def test_without_a_port_of_its_own_it_uses_the_serial_port_of_the_map() -> None:
    driver = DynamixelDriver(at(WX200, port="/nowhere/left"), MonotonicClock())
    with pytest.raises(PortError, match="/nowhere/left"):
        driver.connect()


def test_connect_tells_what_is_there() -> None:
    rig = build(timing=WIRE)
    driver, _ = on(rig)
    first = driver.connect().description
    assert first == "virtual at 1000000 bit/s, 7 servos, firmware 46, fast sync read", "not set up yet: not measured"
    assert rig.events == []
    driver.enable()
    driver.disable()
    info = driver.connect()
    assert (info.arm, info.joints) == ("left", ("shoulder", "elbow", "wrist_angle", "wrist_rotate"))
    assert info.tau_max_Nm.tolist() == [4.0, 2.0, 2.0, 0.5]
    assert not info.tau_max_Nm.flags.writeable
    head, _, read = info.description.partition(", read ")
    assert head == first
    measured_ms, of, period = read.split(" ms")
    assert 0.3 < float(measured_ms) < 3.0
    assert (of, period) == (" of 5.00", "")


@pytest.mark.parametrize("old", [(4,), (1, 2, 3, 4, 5, 6, 7)])
def test_one_servo_without_fast_reads_is_enough_for_plain_ones(old: tuple[int, ...]) -> None:
    rig = build()
    for i in old:
        rig.servo(i).firmware.version = 44
    driver, _ = on(rig)
    description = driver.connect().description
    assert description.endswith("plain sync read")
    assert ("firmware 44/46" in description) == (len(old) == 1)
    assert driver._running is not None
    assert driver._running.fast is False
    (event,) = rig.events
    assert event.kind.name == "SLOW_SYNC_READ"
    names = [f"{i} ({'XL430-W250' if i > 5 else 'XM430-W350'}, 44)" for i in old]
    assert event.text == f"servo {', '.join(names)}: one status packet per servo instead"


@pytest.mark.parametrize(("timer_ms", "refused"), [(None, False), (1, False), (2, False), (3, True), (16, True)])
def test_a_latency_timer_above_two_milliseconds_is_refused(timer_ms: int | None, refused: bool) -> None:
    driver, port = on(build())
    port.latency_timer_ms = timer_ms
    if not refused:
        driver.connect()
        return
    with pytest.raises(PortError, match="virtual: USB latency timer") as caught:
        driver.connect()
    assert (caught.value.found, caught.value.expected) == (f"{timer_ms} ms", "1 ms")
    assert "udev rule" in caught.value.remedy
    assert not port.is_open


def test_what_is_refused_leaves_the_port_closed_and_nothing_to_read() -> None:
    rig = brought_up()
    rig.port.close()
    driver, port = on(rig)
    driver.connect()
    rig.fault(FaultKind.SILENT, 5)
    with pytest.raises(IdentityError):
        driver.connect()
    assert port.opened == 2, "closed in between"
    assert not port.is_open
    with pytest.raises(NotEnabledError, match=NO_CONNECTION):
        driver.read()
    assert [problem.servo_id for problem in driver.problems] == [5]


def test_the_first_problem_is_raised_and_all_are_kept() -> None:
    rig = build()
    driver, _ = on(rig)
    for servo_id in (3, 6):
        rig.fault(FaultKind.SILENT, servo_id)
    with pytest.raises(IdentityError) as caught:
        driver.connect()
    assert [problem.servo_id for problem in driver.problems] == [3, 6]
    assert caught.value is driver.problems[0]


def connect_ns(**more: Any) -> int:
    """Virtual time that a connect takes."""
    rig = build()
    begin_ns = rig.clock.now_ns()
    DynamixelDriver(rig.arm, rig.clock, port=rig.port, **more).connect()
    return rig.clock.now_ns() - begin_ns


def test_strangers_are_waited_for_as_long_as_asked_or_for_most_of_a_second() -> None:
    assert connect_ns(scan_s=0.3) - connect_ns(scan_s=0.1) == pytest.approx(0.2e9, abs=0.01e9)
    assert connect_ns() - connect_ns(scan_s=0.1) == pytest.approx(0.7e9, abs=0.01e9)


# --- pace ------------------------------------------------------------------------------------------------------------


def test_the_rate_is_judged_with_the_timing_of_the_link() -> None:
    rig = build(at(WX200, rate_hz=250.0))
    on(rig)[0].connect()
    for name, value in (("usb_latency_s", 3e-3), ("turnaround_s", 2e-3)):
        driver, _ = on(build(at(WX200, rate_hz=250.0)), link=LinkTiming(**{name: value}))
        with pytest.raises(PaceError, match="found 250 Hz"):
            driver.connect()


def test_the_rate_is_judged_with_what_the_servos_can_do() -> None:
    """Four hundred cycles a second fit when replies are merged, and only then."""
    for firmware, fits in ((46, True), (44, False)):
        driver, _ = on(build(at(WX200, rate_hz=270.0), firmware=firmware))
        if fits:
            driver.connect()
        else:
            with pytest.raises(PaceError, match="found 270 Hz"):
                driver.connect()


def test_a_read_that_takes_too_much_of_the_period_is_refused_when_connected_and_when_enabled() -> None:
    rig = enabled(timing=WIRE)
    rig.driver.disable()
    rig.driver.close()
    for share, fits in ((0.1, False), (0.6, True)):
        driver, port = on(rig, read_share=share)
        if fits:
            driver.connect()
            driver.close()
            continue
        with pytest.raises(PaceError, match="read of all servos on virtual"):
            driver.connect()
        assert not port.is_open
    fresh = build(timing=WIRE)  # servos that must be set up are measured after it
    driver, _ = on(fresh, read_share=0.1)
    driver.connect()
    with pytest.raises(PaceError, match="read of all servos on virtual"):
        driver.enable()
    assert fresh.get(4, table.TORQUE_ENABLE) == 0
    with pytest.raises(NotEnabledError, match=NO_TORQUE):
        driver.write(np.zeros(4))


# --- going -----------------------------------------------------------------------------------------------------------


def torque(rig: Rig) -> list[int]:
    return [rig.get(i, table.TORQUE_ENABLE) for i in range(1, 8)]


def test_enable_begins_anew_once_and_commands_may_follow_at_once() -> None:
    rig = build()
    rig.driver.connect()
    rig.driver.faults.append(DxlServoFault(FaultCause.SILENT, servo_id=1, joint="waist", found="", expected=""))
    before = rig.driver._running
    rig.driver.enable()
    assert torque(rig) == [1] * 7
    assert rig.driver.faults == []
    running = rig.driver._running
    assert running is not before
    rig.driver.write(np.array([0.0, 1.0, 0.0, 0.0]))
    assert rig.get(4, table.GOAL_CURRENT) == pytest.approx(1.0 / (1.783 * 2.69e-3), abs=1.0)
    written = len(rig.port.writes)
    rig.driver.enable()
    assert len(rig.port.writes) == written
    assert rig.driver._running is running


def test_goals_of_an_earlier_run_are_gone_before_torque_comes_on() -> None:
    rig = brought_up()
    rig.driver.write(np.array([1.0, 1.0, 0.0, 0.1]))
    rig.driver.disable()
    assert rig.get(4, table.GOAL_CURRENT) > 0
    rig.driver.enable()
    assert [rig.get(i, table.GOAL_CURRENT) for i in (2, 3, 4)] == [0, 0, 0]
    assert rig.get(6, table.GOAL_PWM) == 0


def test_enable_checks_the_pose_after_it_has_set_up_and_before_torque() -> None:
    far = tuple(j if j.name != "elbow" else type(j)(**{**_fields(j), "start_rad": -1.0}) for j in WX200.joints)
    rig = build(at(WX200, joints=far))
    rig.driver.connect()
    with pytest.raises(IdentityError, match="elbow"):
        rig.driver.enable()
    assert torque(rig) == [0] * 7
    assert "EEPROM_WRITTEN" in rig.kinds()


def _fields(joint: Any) -> dict[str, Any]:
    return {name: getattr(joint, name) for name in joint.__dataclass_fields__}


def test_after_disable_it_is_connected_and_after_close_it_is_not() -> None:
    rig = brought_up()
    rig.driver.disable()
    assert torque(rig) == [0] * 7
    rig.driver.read()
    with pytest.raises(NotEnabledError, match=NO_TORQUE):
        rig.driver.write(np.zeros(4))
    rig.driver.close()
    assert not rig.port.is_open
    for _ in range(2):
        rig.driver.disable()
        rig.driver.close()
        with pytest.raises(NotEnabledError, match=NO_CONNECTION):
            rig.driver.health()


@pytest.mark.fault("P9")
def test_torque_that_another_program_has_on_stays_on_when_a_start_is_refused_for_it() -> None:
    """What it holds would fall."""
    rig = build()
    rig.driver.connect()
    rig.put(4, table.TORQUE_ENABLE, 1)
    with pytest.raises(IdentityError, match="on already"):
        rig.driver.enable()
    rig.driver.disable()
    assert rig.get(4, table.TORQUE_ENABLE) == 1
    rig.driver.read()


def test_disable_switches_off_whatever_this_driver_may_have_on_and_keeps_the_arm_connected() -> None:
    """Also where `enable` failed halfway, or the phase says that there is no torque."""
    rig = brought_up()
    rig.driver.disable()
    rig.put(4, table.TORQUE_ENABLE, 1)
    rig.driver.disable()
    assert rig.get(4, table.TORQUE_ENABLE) == 0
    rig.driver.read()


def test_what_a_servo_says_beside_an_error_is_not_believed() -> None:
    """Torque off, for one: its watchdog would be taken from it."""
    rig = brought_up()
    bus = rig.driver._bus
    address, fields = Page.STATUS.value
    rows = bus.read_all(address, fields, [1, 2])
    assert {i: row[0] for i, row in rows.items()} == {1: 1, 2: 1}
    answer = codec.status(1, 0x07, bytes(6)) + codec.status(2, 0x80, bytes(6))
    bus.exchange = lambda group, _: Exchange(group.parse(answer, final=True), answer)  # type: ignore[method-assign]
    assert bus.read_all(address, fields, [1, 2]) == {2: (0, 0, 0, 0, 0)}, "an alert is no error"


def test_disable_on_a_dead_port_is_safe_and_on_a_closed_one_says_nothing() -> None:
    rig = brought_up()
    rig.port.lost = True
    rig.driver.disable()
    with pytest.raises(NotEnabledError, match=NO_TORQUE):
        rig.driver.write(np.zeros(4))
    rig.driver.close()
    rig.port.lost = False
    written = len(rig.port.writes)
    rig.driver.disable()
    assert len(rig.port.writes) == written
    with pytest.raises(NotEnabledError, match=NO_CONNECTION):
        rig.driver.read()


def test_reopen_is_the_same_arm_or_a_closed_port() -> None:
    rig = build()
    driver, port = on(rig)
    driver.connect()
    driver.enable()
    rig.events.clear()
    driver.reopen()
    assert (port.opened, port.is_open) == (2, True)
    assert [(event.kind.name, event.text) for event in rig.events] == [("PORT_REOPENED", "virtual")]
    driver.write(np.zeros(4))
    rig.fault(FaultKind.SILENT, 5)
    with pytest.raises(Exception, match="servo 5"):
        driver.reopen()
    assert (port.opened, port.is_open) == (3, False)
    assert len(rig.events) == 1


def test_what_connect_found_is_every_servo_of_the_map() -> None:
    assert [servo.slot.servo_id for servo in brought_up().driver.found] == [1, 2, 3, 4, 5, 6, 7]


def test_an_arm_has_lapsed_from_a_lost_port_until_it_is_open_again_or_given_back() -> None:
    assert build().driver.lapsed is False, "before anything"
    rig = brought_up()
    driver = rig.driver
    for use in (driver.read, lambda: driver.write(np.zeros(4))):
        rig.port.lost = True
        with pytest.raises(PortLostError):
            use()
        assert driver.lapsed is True
        rig.port.lost = False
        driver.reopen()
        assert driver.lapsed is False, "before the next read"
    rig.port.lost = True
    with pytest.raises(PortLostError):
        driver.read()
    driver.close()
    assert driver.lapsed is False


def test_rearm_forgets_the_watchdog_and_nothing_else() -> None:
    rig = brought_up()
    kept = DxlServoFault(FaultCause.NO_EFFECT, servo_id=4, joint="elbow", found="", expected="")
    rig.driver.faults = [
        DxlServoFault(FaultCause.WATCHDOG_TRIPPED, servo_id=1, joint="waist", found="", expected=""), kept,
    ]  # fmt: skip
    rig.driver.write(np.array([0.0, 1.0, 0.0, 0.0]))
    before = rig.driver._running
    begin_ns = rig.clock.now_ns()
    rig.driver.rearm()
    assert rig.driver.faults == [kept]
    assert rig.get(4, table.GOAL_CURRENT) == 0
    assert rig.driver._running is not before
    assert rig.clock.now_ns() - begin_ns >= 25_000_000, "the line was quiet before it was spoken to"
