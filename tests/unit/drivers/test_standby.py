"""A driver that goes on with an arm which another one has commanded: torque stays on, the first write is a torque."""

from __future__ import annotations

import contextlib
from dataclasses import replace

import numpy as np
import pytest

from drivers.dynamixel.errors import DxlServoFault, NotEnabledError
from drivers.dynamixel.servo.codes import WATCHDOG_TRIPPED, Instruction
from drivers.dynamixel.servo.table import BUS_WATCHDOG, GOAL_CURRENT, GOAL_PWM, LED, TORQUE_ENABLE
from drivers.dynamixel.standby import AdoptError, Handover, StandbyDriver
from drivers.interface import DriverError, StaleStateError
from sim_backend.wire.faults import FaultKind
from tests.support.servos.copied_rig import brought_up
from tests.support.servos.dxl_rig import WX200, Rig, build, loses

TAU = np.array([0.4, 0.3, 0.2, 0.05])
MS = 1_000_000
CONTROLLED = (2, 4, 5, 6)


def commanded(rig: Rig, cycles: int = 30) -> None:
    for _ in range(cycles):
        rig.clock.sleep_until(rig.clock.now_ns() + rig.arm.period_ns)
        rig.driver.read()
        rig.driver.write(TAU)


def standby(rig: Rig) -> StandbyDriver:
    """One on the rig's port, prepared as a guard's; the driver before it says nothing more."""
    made = StandbyDriver(rig.arm, rig.clock, on_event=rig.events.append, port=rig.port)
    made.prepare(Handover.of(rig.driver))
    return made


def goals(rig: Rig) -> list[int]:
    return [rig.get(i, GOAL_PWM if i == 6 else GOAL_CURRENT) for i in CONTROLLED]


def test_it_looks_at_the_supply_first_which_may_have_fallen_since_bring_up() -> None:
    rig = brought_up()
    commanded(rig)
    rig.fault(FaultKind.VOLTAGE, voltage_V=11.0)
    commanded(rig, 4)
    driver = standby(rig)
    driver.adopt(rig.driver.read())
    cycles = 0
    while not np.allclose(driver.health().voltage_V, 11.0):
        rig.clock.sleep_until(rig.clock.now_ns() + rig.arm.period_ns)
        driver.read()
        driver.write(TAU)
        cycles += 1
    assert cycles <= 4  # the round comes to it in the ninth


def test_it_takes_the_arm_as_it_is_and_commands_it() -> None:
    rig = brought_up()
    commanded(rig)
    before, state = goals(rig), rig.driver.read()
    rig.port.writes.clear()
    driver = standby(rig)
    assert rig.port.writes == [], "prepared without a byte on the bus"
    begin_ns = rig.clock.now_ns()
    held = driver.adopt(state)
    assert not driver.resumed
    assert rig.clock.now_ns() - begin_ns < 8 * MS
    np.testing.assert_allclose(held, TAU, atol=0.01)
    assert {packet[7] for packet in rig.port.writes} == {Instruction.SYNC_READ}, "nothing was written"
    assert goals(rig) == before
    assert all(rig.get(i, TORQUE_ENABLE) == 1 for i in CONTROLLED)
    for _ in range(60):
        rig.clock.sleep_until(rig.clock.now_ns() + rig.arm.period_ns)
        driver.read()
        driver.write(TAU)
    assert driver.faults == []


def test_what_is_prepared_commands_nothing_until_it_has_the_arm() -> None:
    rig = brought_up()
    driver = standby(rig)
    rig.port.writes.clear()
    with pytest.raises(NotEnabledError, match="found a connection, expected torque on"):
        driver.write(TAU)
    assert rig.port.writes == []


def test_one_servo_that_cannot_answer_fast_keeps_all_of_them_from_being_asked_so() -> None:
    rig = build()
    rig.servo(5).firmware.version = 44
    rig.driver.connect()
    rig.driver.enable()
    driver = standby(rig)
    driver.adopt(None)
    rig.port.writes.clear()
    driver.read()
    assert [packet[7] for packet in rig.port.writes] == [Instruction.SYNC_READ]


def test_a_handover_survives_the_way_between_two_processes() -> None:
    import json

    rig = brought_up()
    found = Handover.of(rig.driver)
    again = Handover(tuple(json.loads(json.dumps(found.servos))))
    assert again == found
    assert again.servos_of(rig.arm) == list(rig.driver.found)


def test_a_handover_of_another_arm_is_refused() -> None:
    rig = brought_up()
    shorter = replace(WX200, joints=WX200.joints[:-1])
    with pytest.raises(AdoptError, match=r"found IDs \[1, 2, 3, 4, 5, 6, 7\], expected IDs \[1, 2, 3, 4, 5, 6\]"):
        Handover.of(rig.driver).servos_of(shorter)


@pytest.mark.parametrize("register", [TORQUE_ENABLE, LED], ids=["torque off", "without the mark of bring-up"])
def test_an_arm_that_is_not_as_it_was_left_is_refused_and_nothing_is_written(register) -> None:
    rig = brought_up()
    driver = standby(rig)
    for i in (2, 3, 4, 5, 6):
        rig.put(i, register, 0)
    rig.port.writes.clear()
    with pytest.raises(AdoptError, match="support the object: nothing holds it"):
        driver.adopt(None)
    assert {packet[7] for packet in rig.port.writes} == {Instruction.SYNC_READ}


def test_one_servo_without_torque_does_not_keep_the_others_from_holding() -> None:
    rig = brought_up()
    commanded(rig)
    state = rig.driver.read()
    driver = standby(rig)
    rig.put(4, TORQUE_ENABLE, 0)
    np.testing.assert_allclose(driver.adopt(state), TAU, atol=0.01)


def test_a_servo_that_does_not_answer_is_not_known_and_the_others_are() -> None:
    rig = brought_up()
    commanded(rig)
    driver = standby(rig)
    rig.fault(FaultKind.POWER_LOSS, 5)
    held = driver.adopt(None)
    assert np.isnan(held).tolist() == [False, False, True, False]


def test_a_port_that_is_gone_is_the_loops_affair() -> None:
    rig = brought_up()
    driver = standby(rig)
    rig.port.lost = True
    assert np.isnan(driver.adopt(None)).all()


def test_servos_whose_watchdog_has_fired_are_armed_again_without_effort() -> None:
    rig = brought_up()
    commanded(rig)
    driver = standby(rig)
    rig.clock.sleep_until(rig.clock.now_ns() + 300 * MS)
    assert rig.get(2, BUS_WATCHDOG) == -1
    assert driver.adopt(None).tolist() == [0.0] * 4
    assert driver.resumed
    assert rig.get(2, BUS_WATCHDOG) == 10
    driver.write(TAU)
    assert goals(rig)[0] > 0


def test_servos_without_watchdogs_are_those_of_a_process_that_died_while_it_armed_them() -> None:
    rig = brought_up()
    commanded(rig)
    driver = standby(rig)
    for servo in CONTROLLED:
        rig.put(servo, BUS_WATCHDOG, 0)
    assert driver.adopt(None).tolist() == [0.0] * 4
    assert driver.resumed
    assert [rig.get(i, BUS_WATCHDOG) for i in CONTROLLED] == [10] * len(CONTROLLED)
    assert goals(rig)[0] == 0


def test_a_servo_that_has_restarted_has_no_watchdog_either_and_is_the_loops_affair() -> None:
    rig = brought_up()
    commanded(rig)
    driver = standby(rig)
    rig.put(4, BUS_WATCHDOG, 0)
    rig.put(4, TORQUE_ENABLE, 0)
    driver.adopt(None, brings_back=False)
    assert not driver.limp


@pytest.mark.fault("B1")
@pytest.mark.parametrize("zero", [False, True], ids=["all that arms", "the zeroes"])
def test_a_packet_lost_while_watchdogs_are_armed_again_is_the_loops_affair_which_tries_again(zero: bool) -> None:
    rig = brought_up()
    commanded(rig)
    driver = standby(rig)
    rig.clock.sleep_until(rig.clock.now_ns() + 300 * MS)
    if zero:
        loses(rig, GOAL_CURRENT)
    else:
        loses(rig, BUS_WATCHDOG, value=10, count=3)
    assert np.isnan(driver.adopt(None)).all()
    assert (driver.resumed, driver.lapsed) == (False, True)
    with pytest.raises(DxlServoFault, match=r"servo 1 .*its bus watchdog has fired"):
        driver.read()
    assert driver.recover() is True, "torque begins at zero, though all may be armed: some goals may be old ones"
    assert [rig.get(i, BUS_WATCHDOG) for i in CONTROLLED] == [10] * len(CONTROLLED)
    driver.read()
    driver.write(TAU)
    assert goals(rig)[0] > 0


def test_servos_whose_watchdog_has_fired_are_left_limp_where_it_is_too_late_to_bring_them_back() -> None:
    rig = brought_up()
    commanded(rig)
    driver = standby(rig)
    rig.clock.sleep_until(rig.clock.now_ns() + 300 * MS)
    rig.port.writes.clear()
    assert not driver.limp
    driver.adopt(None, brings_back=False)
    assert (driver.limp, driver.resumed) == (True, False)
    assert {packet[7] for packet in rig.port.writes} == {Instruction.SYNC_READ}, "nothing was written"
    driver.disable()
    assert rig.get(2, TORQUE_ENABLE) == 0, "whose torque can be switched off"


def test_too_late_is_limp_for_an_arm_that_does_not_answer_and_not_for_one_that_obeys() -> None:
    rig = brought_up()
    commanded(rig)
    obeys, gone = standby(rig), standby(rig)
    obeys.adopt(None, brings_back=False)
    rig.port.lost = True
    gone.adopt(None, brings_back=False)
    assert (obeys.limp, gone.limp) == (False, True)


def test_watchdogs_that_fired_beside_a_servo_without_torque_are_left_and_the_arm_is_lost() -> None:
    rig = brought_up()
    commanded(rig)
    driver = standby(rig)
    rig.clock.sleep_until(rig.clock.now_ns() + 300 * MS)
    rig.put(4, TORQUE_ENABLE, 0)
    rig.port.writes.clear()
    driver.adopt(None)
    assert not driver.resumed
    assert {packet[7] for packet in rig.port.writes} == {Instruction.SYNC_READ}, "nothing was written"
    for _ in range(20):
        rig.clock.sleep_until(rig.clock.now_ns() + rig.arm.period_ns)
        with contextlib.suppress(DxlServoFault):
            driver.read()
        driver.write(TAU)
    with pytest.raises(DxlServoFault, match="no other servo of the arm has torque") as lost:
        driver.read()
    assert lost.value.state is None


def test_the_servo_that_is_blamed_for_a_watchdog_is_the_one_whose_has_fired(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = brought_up()
    commanded(rig)
    driver = standby(rig)
    rig.put(CONTROLLED[-1], BUS_WATCHDOG, WATCHDOG_TRIPPED)

    def lost() -> None:
        raise DriverError("bus", found="a lost packet", expected="an answer", remedy="again")

    monkeypatch.setattr(driver, "rearm", lost)
    assert np.isnan(driver.adopt(None)).all()
    with pytest.raises(DxlServoFault, match=rf"servo {CONTROLLED[-1]} .*its bus watchdog has fired"):
        driver.read()


@pytest.mark.parametrize(("ticks", "away_ns", "tripped"), [(114, 9 * MS, 0), (-114, 9 * MS, 0), (2048, 300 * MS, 1)])
def test_an_encoder_that_jumped_while_nobody_commanded_is_not_believed(ticks: int, away_ns: int, tripped: int) -> None:
    rig = brought_up()
    commanded(rig)
    last = rig.driver.read()
    driver = standby(rig)
    rig.fault(FaultKind.ENCODER_OFFSET, 4, offset_ticks=ticks)
    rig.clock.sleep_until(rig.clock.now_ns() + away_ns)
    driver.adopt(last)
    assert driver.resumed == tripped
    with pytest.raises(StaleStateError, match="a position it cannot have reached"):
        driver.read()
    rig.clock.sleep_until(rig.clock.now_ns() + rig.arm.period_ns)
    with pytest.raises(DxlServoFault, match="a step to"):
        driver.read()


def test_an_arm_that_fell_while_nobody_commanded_is_believed_where_it_is() -> None:
    rig = brought_up()
    commanded(rig)
    last = rig.driver.read()
    driver = standby(rig)
    rig.clock.sleep_until(rig.clock.now_ns() + 600 * MS)
    driver.adopt(last)
    assert driver.resumed
    assert np.abs(driver.read().q - last.q).max() > 0.2


def test_without_a_state_of_before_the_first_angles_are_believed() -> None:
    rig = brought_up()
    commanded(rig)
    driver = standby(rig)
    rig.fault(FaultKind.ENCODER_OFFSET, 4, offset_ticks=57)
    driver.adopt(None)
    driver.read()
