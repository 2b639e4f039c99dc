"""An arm that lapsed and comes back: recognised before a byte is written, armed again only where a watchdog fired."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from agent.guard.guarded import BUSY_S
from drivers.dynamixel.bringup import BringUp
from drivers.dynamixel.errors import DxlServoFault, FaultCause, NotEnabledError, PortError, PortLostError, RearmError
from drivers.dynamixel.identify import IdentityError
from drivers.dynamixel.recovery import limp
from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import WATCHDOG_TRIPPED
from drivers.interface import DriverError, Recovering, ServoFault, StaleStateError
from sim_backend.wire.drive import Stop
from sim_backend.wire.faults import FaultKind
from tests.support.servos.copied_rig import copied
from tests.support.servos.dxl_rig import WX200, Rig, build, enabled, loses

PING, READ, SYNC_READ, FAST_SYNC_READ, SYNC_WRITE = 0x01, 0x02, 0x82, 0x8A, 0x83
ASKING = {PING, READ, SYNC_READ, FAST_SYNC_READ}
ARMED = 10  # of the register, for 0.2 s
NOISE_S = 0.15  # that a babbling line takes of it beside
HELD = 4  # questions: where the waist is; where the gripper is, and its limits
IDS = [slot.servo_id for slot in WX200.slots]
TAU = np.array([0.3, -0.2, 0.1, 0.05])


def rest(rig: Any, seconds: float) -> None:
    rig.clock.sleep_until(rig.clock.now_ns() + round(1e9 * seconds))


BEGUN: dict[str, Rig] = {}  # of which each test has a copy


@pytest.fixture(scope="module", autouse=True)
def begun() -> Iterator[None]:
    BEGUN.update(working=_working(), tripped=_tripped())
    yield
    BEGUN.clear()


def working() -> Any:
    """An arm that has been commanded for a while."""
    return copied(BEGUN["working"])


def tripped() -> Any:
    """The same after its watchdogs have fired, and as the driver has noticed."""
    return copied(BEGUN["tripped"])


def _working() -> Rig:
    rig = enabled()
    for _ in range(20):
        rig.driver.read()
        rig.driver.write(TAU)
        rest(rig, 0.004)
    rig.events.clear()
    rig.port.writes.clear()
    return rig


def goes_on(
    rig: Any, cycles: int, tau: np.ndarray = 0.0 * TAU, *, passed_over: type[DriverError] = DxlServoFault
) -> None:
    for _ in range(cycles):
        with contextlib.suppress(passed_over):
            rig.driver.read()
        rig.driver.write(tau)
        rest(rig, 0.004)


def _tripped() -> Rig:
    rig = _working()
    rest(rig, 0.25)
    goes_on(rig, 20)
    assert rig.driver.faults[0].cause is FaultCause.WATCHDOG_TRIPPED
    rig.port.writes.clear()
    return rig


def asked(rig: Any) -> set[int]:
    """Instructions that have gone out."""
    return {packet[7] for packet in rig.port.writes}


def test_the_driver_says_that_it_can() -> None:
    assert isinstance(build().driver, Recovering)


def test_an_arm_that_works_has_not_lapsed_and_is_left_alone() -> None:
    rig = working()
    assert rig.driver.lapsed is False
    assert rig.driver.recover() is False
    assert asked(rig) <= ASKING
    assert rig.events == []


def test_what_a_servo_said_of_its_health_before_is_heard_and_not_missed() -> None:
    rig = working()
    rig.driver.recover()
    rig.driver.read()
    assert rig.driver.counters.health_misses == 0


def test_watchdogs_that_fired_are_armed_again_with_zero_torque() -> None:
    rig = tripped()
    assert rig.driver.lapsed is True
    assert rig.driver.recover() is True
    assert rig.kinds() == ["REARMED"]
    assert rig.driver.lapsed is False
    assert [rig.get(i, table.BUS_WATCHDOG) for i in IDS] == [ARMED] * len(IDS)
    assert [rig.get(i, table.TORQUE_ENABLE) for i in IDS] == [1] * len(IDS)
    assert rig.get(4, table.GOAL_CURRENT) == 0
    rig.driver.read()
    rig.driver.write(TAU)


@pytest.mark.fault("S5")
@pytest.mark.parametrize("offset_ticks", [57, 2048])
def test_an_arm_whose_encoder_has_jumped_is_not_armed_again_before_it_is_back(offset_ticks: int) -> None:
    """Armed again it believed what it had rejected, and held with torque of the wrong sign."""
    rig = working()
    rig.fault(FaultKind.ENCODER_OFFSET, 4, offset_ticks=offset_ticks)
    goes_on(rig, 10, TAU, passed_over=DriverError)
    rest(rig, 0.25)
    goes_on(rig, 20, passed_over=DriverError)
    assert rig.driver.lapsed is True
    rig.port.writes.clear()
    for _ in range(3):
        with pytest.raises(RearmError, match=r"servo 4 \(elbow\).*: found a step to .* in a row"):
            rig.driver.recover()
        rest(rig, 0.1)
    assert asked(rig) <= ASKING
    assert rig.get(4, table.BUS_WATCHDOG) == WATCHDOG_TRIPPED
    rig.injector.clear(rig.clock.now_ns())
    if offset_ticks == 2048:  # a small offset is not told from how far the arm has sunk
        assert rig.driver.recover() is True
        assert rig.get(4, table.GOAL_CURRENT) == 0


def test_watchdogs_that_fire_again_after_they_were_not_armed_again_are_noticed_again() -> None:
    rig = tripped()
    for servo in IDS:  # as where the packets of a recovery reached it, and its answers did not come
        rig.put(servo, table.BUS_WATCHDOG, ARMED)
    assert rig.driver.recover() is False
    assert rig.driver.lapsed is False
    for servo in IDS:
        rig.put(servo, table.BUS_WATCHDOG, WATCHDOG_TRIPPED)
    goes_on(rig, 20)
    assert rig.driver.lapsed is True


@pytest.mark.parametrize("servo", [2, 4])
def test_a_servo_that_missed_its_zero_does_not_pull_with_its_old_goal_after_the_next_attempt(servo: int) -> None:
    """All watchdogs are armed by then; but nobody was told that torque begins afresh."""
    rig = tripped()
    loses(rig, table.GOAL_CURRENT, *({1, 2, 4, 5} - {servo}))
    with pytest.raises(RearmError, match="Goal Current"):
        rig.driver.recover()
    assert [rig.get(i, table.BUS_WATCHDOG) for i in IDS] == [ARMED] * len(IDS)
    assert rig.get(servo, table.GOAL_CURRENT) != 0
    assert rig.driver.recover() is True
    assert rig.get(servo, table.GOAL_CURRENT) == 0
    assert rig.kinds() == ["REARMED"]


def test_a_held_servo_that_missed_its_place_is_found() -> None:
    """It would pull its joint to where it was before."""
    rig = tripped()
    loses(rig, table.GOAL_POSITION)
    rig.put(1, table.GOAL_POSITION, 1900)
    with pytest.raises(RearmError, match=r"servo 1 .*Goal Position 1900"):
        rig.driver.recover()


@pytest.mark.parametrize("every", [2, 3, 5, 11])
def test_an_arm_is_brought_back_or_not_within_what_its_guard_waits_for(every: int) -> None:
    """However many answers get lost."""
    rig = tripped()
    really, count = rig.port.write, 0

    def write(data: bytes, deadline_ns: int) -> None:
        nonlocal count
        count += data[7] in ASKING
        if data[7] not in ASKING or count % every:
            really(data, deadline_ns)

    rig.port.write = write
    for _ in range(6):
        begin_ns = rig.clock.now_ns()
        with contextlib.suppress(DriverError):
            rig.driver.recover()
        assert rig.clock.now_ns() - begin_ns < (BUSY_S - NOISE_S) * 1e9


def test_a_watchdog_that_is_said_to_have_fired_and_has_not_is_forgotten() -> None:
    rig = working()
    fired, other = (
        DxlServoFault(cause, servo_id=4, joint="elbow", found="", expected="")
        for cause in (FaultCause.WATCHDOG_TRIPPED, FaultCause.NO_EFFECT)
    )
    rig.driver.faults = [fired, other]
    assert rig.driver.recover() is False
    assert rig.driver.faults == [other]


def test_servos_are_asked_who_they_are_before_anything_is_written() -> None:
    rig = tripped()
    rig.driver.recover()
    instructions = [packet[7] for packet in rig.port.writes]
    first_write = next(k for k, instruction in enumerate(instructions) if instruction not in ASKING)
    assert instructions[:first_write].count(PING) == len(IDS)
    assert instructions[:first_write].count(READ) == 2 * len(IDS) + HELD, "torque and watchdog of each"


@pytest.mark.fault("S6")
@pytest.mark.parametrize("seen_after", [0, 15])
def test_a_servo_whose_watchdog_has_fired_is_not_told_of_as_one_without_effect_too(seen_after: int) -> None:
    """A fault that would stay behind the recovery: its current does not follow goals that it ignores."""
    rig = working()
    rig.put(4, table.BUS_WATCHDOG, WATCHDOG_TRIPPED)
    rig.servo(4).firmware.body.drive.stop = Stop.LIMP
    checked, rig.driver._running.monitor.question = rig.driver._running.monitor.question, lambda _, **__: (b"", 0)
    for number in range(40):
        if number == seen_after:
            rig.driver._running.monitor.question = checked
        with contextlib.suppress(DxlServoFault):
            rig.driver.read()
        rig.driver.write(4.0 * TAU)
        rest(rig, 0.004)
    assert [(fault.cause, fault.servo_id) for fault in rig.driver.faults] == [(FaultCause.WATCHDOG_TRIPPED, 4)]
    assert rig.driver.recover() is True
    assert rig.driver.faults == []


@pytest.mark.parametrize("servo", [3, 4])
def test_an_arm_without_torque_is_never_armed_again(servo: int) -> None:
    rig = tripped()
    rig.put(servo, table.TORQUE_ENABLE, 0)
    with pytest.raises(DxlServoFault, match=rf"servo {servo} .*torque is off"):
        rig.driver.recover()
    assert asked(rig) <= ASKING
    assert rig.get(servo, table.TORQUE_ENABLE) == 0


@pytest.mark.parametrize("servo", [3, 4])
def test_an_arm_of_which_some_servos_still_obey_goes_on_with_those_though_one_has_no_torque(servo: int) -> None:
    rig = working()
    rig.put(servo, table.TORQUE_ENABLE, 0)
    rig.put(7, table.BUS_WATCHDOG, 255)
    assert rig.driver.recover() is False
    assert asked(rig) <= ASKING


def arming_lost(rig: Any, *heard: int) -> None:
    """The next packets that arm watchdogs, three of one write, get lost on their way, but to these servos."""
    loses(rig, table.BUS_WATCHDOG, *heard, value=ARMED, count=3)


@pytest.mark.parametrize("heard", [(), (1, 2, 4, 5)])
def test_an_arm_that_is_armed_in_part_has_stopped_until_a_later_attempt_arms_the_rest(heard: tuple[int, ...]) -> None:
    rig = tripped()
    arming_lost(rig, *heard)
    with pytest.raises(RearmError, match="Watchdog 0, expected 10; it is tried again until the arm is given") as caught:
        rig.driver.recover()
    assert not isinstance(caught.value, ServoFault), "which would be a lost arm"
    assert rig.kinds() == []
    rest(rig, 0.1)
    assert rig.driver.recover() is True
    assert [rig.get(i, table.BUS_WATCHDOG) for i in IDS] == [ARMED] * len(IDS)
    rest(rig, 0.1)
    rig.put(5, table.BUS_WATCHDOG, 0)
    assert rig.driver.recover() is False, "a servo that restarted and has torque is for the checks to find"


def armed_in_part(*heard: int) -> Any:
    """An arm of which an attempt to bring it back has armed these alone."""
    rig = tripped()
    arming_lost(rig, *heard)
    with pytest.raises(RearmError):
        rig.driver.recover()
    return rig


@pytest.mark.fault("B1", "S6")
def test_an_arm_that_is_armed_in_part_gets_no_torque() -> None:
    """A servo that is not armed would go on with it for ever, and the loop has not been told that it begins at zero."""
    rig = armed_in_part(1, 2, 4)
    assert rig.driver.write(TAU) == pytest.approx(np.zeros(4), abs=0.01)
    assert [rig.get(i, table.GOAL_CURRENT) for i in (2, 3, 4, 5)] == [0] * 4
    assert rig.driver.recover() is True
    assert rig.driver.write(TAU) == pytest.approx(TAU, abs=0.01)
    assert rig.get(5, table.GOAL_CURRENT) != 0


@pytest.mark.fault("B1", "S6")
@pytest.mark.parametrize("heard", [(), (1, 2, 4, 5)])
def test_an_arm_that_is_armed_in_part_is_not_taken_for_one_that_restarted_while_a_loop_goes_on(
    heard: tuple[int, ...],
) -> None:
    """It may be tried again: a servo that was cleared and not armed has a watchdog of 0, as after a restart."""
    rig = armed_in_part(*heard)
    for _ in range(20):
        with pytest.raises(DxlServoFault, match="its bus watchdog has fired"):
            rig.driver.read()
        rig.driver.write(TAU)
        rest(rig, 0.004)
    assert rig.driver.lapsed is True
    assert rig.kinds() == []
    assert rig.driver.recover() is True
    assert rig.driver.faults == []


def test_an_arm_that_is_armed_in_part_when_a_servo_loses_its_torque_is_lost() -> None:
    rig = tripped()
    arming_lost(rig)
    with pytest.raises(RearmError):
        rig.driver.recover()
    rig.put(4, table.TORQUE_ENABLE, 0)
    with pytest.raises(DxlServoFault, match=r"servo 4 .*torque is off.*no other servo of the arm has torque"):
        rig.driver.recover()


@pytest.mark.parametrize("cause", [FaultCause.TORQUE_LOST, FaultCause.HARDWARE_ERROR, FaultCause.REBOOTED])
def test_an_arm_whose_torque_is_gone_for_another_reason_has_not_lapsed(cause: FaultCause) -> None:
    rig = tripped()
    rig.driver.faults.append(DxlServoFault(cause, servo_id=4, joint="elbow", found="", expected=""))
    assert rig.driver.lapsed is False


def faults_of(**causes: FaultCause) -> list[DxlServoFault]:
    """Of servos by ID (as `_1`), in that order."""
    return [
        DxlServoFault(cause, servo_id=int(key[1:]), joint="j", found="", expected="") for key, cause in causes.items()
    ]


TRIPPED, OFF, LED_OFF = FaultCause.WATCHDOG_TRIPPED, FaultCause.TORQUE_LOST, FaultCause.REBOOTED
OTHERS = {f"_{i}": TRIPPED for i in IDS if i not in (2, 5)}


@pytest.mark.parametrize(
    ("causes", "lost"),
    [
        ({f"_{i}": OFF for i in IDS}, 1),
        ({**OTHERS, "_5": LED_OFF, "_2": OFF}, 5),
        ({"_2": OFF, **OTHERS, "_5": TRIPPED}, 2),
        ({**OTHERS, "_2": TRIPPED, "_5": TRIPPED}, None),
        ({**OTHERS, "_2": OFF}, None),
        ({"_2": OFF}, None),
        ({**OTHERS, "_2": OFF, "_5": FaultCause.GOAL_IGNORED}, None),
        ({}, None),
    ],
    ids=str,
)
def test_an_arm_is_lost_where_no_servo_has_torque_and_one_has_lost_it_for_good(
    causes: dict[str, FaultCause], lost: int | None
) -> None:
    found = limp(WX200, faults_of(**causes))
    assert (found and found.servo_id) == lost
    assert found is None or "no other servo of the arm has torque" in str(found)


def test_a_watchdog_of_a_servo_without_torque_says_nothing_of_those_that_have_some() -> None:
    rig = working()
    for servo in IDS:
        rig.put(servo, table.BUS_WATCHDOG, ARMED if servo == 4 else WATCHDOG_TRIPPED)
    rig.put(4, table.TORQUE_ENABLE, 0)
    with pytest.raises(DxlServoFault, match=r"servo 4 .*no other servo of the arm has torque"):
        steps(rig).has_stopped()


def test_an_arm_whose_arming_failed_is_armed_again_whatever_its_watchdogs_say_and_no_other_is() -> None:
    rig = working()
    assert steps(rig).has_stopped(half_armed=True) is True, "some goals may be old ones"
    rig.put(5, table.BUS_WATCHDOG, 0)
    assert steps(rig).has_stopped() is False
    rig.put(4, table.BUS_WATCHDOG, WATCHDOG_TRIPPED)
    assert steps(rig).has_stopped() is True, "one is enough"
    assert steps(rig).has_stopped(half_armed=True) is True


def steps(rig: Any) -> BringUp:
    return BringUp(rig.driver._bus, rig.arm, rig.driver._found, rig.events.append)


def test_a_silent_servo_costs_one_period_and_nothing_is_written() -> None:
    rig = tripped()
    rig.fault(FaultKind.MUTE, 4)
    begin_ns = rig.clock.now_ns()
    with pytest.raises(StaleStateError, match="servo 4"):
        rig.driver.recover()
    assert rig.clock.now_ns() - begin_ns < 5_500_000
    assert asked(rig) <= ASKING


@pytest.mark.parametrize("error", ["read", "write"])
def test_a_port_that_is_gone_lapses_until_it_is_open_again(error: str) -> None:
    rig = working()
    rig.port.gone = True
    with pytest.raises(PortLostError, match="virtual"):
        rig.driver.read() if error == "read" else rig.driver.write(TAU)
    assert rig.driver.lapsed is True
    with pytest.raises(PortError, match="no such device"):
        rig.driver.recover()
    assert rig.driver.lapsed is True
    rig.port.gone = False
    assert rig.driver.recover() is False, "nothing has fired in this time"
    assert rig.driver.lapsed is False
    assert rig.kinds() == ["PORT_REOPENED"]
    rig.driver.read()


def test_a_port_that_was_away_for_too_long_is_opened_and_its_arm_armed_again() -> None:
    rig = working()
    rig.port.gone = True
    with pytest.raises(PortLostError, match="virtual"):
        rig.driver.read()
    rest(rig, 0.25)
    rig.port.gone = False
    assert rig.driver.recover() is True
    assert rig.kinds() == ["PORT_REOPENED", "REARMED"]


def test_another_arm_is_not_written_to() -> None:
    rig = tripped()
    rig.put(5, table.MODEL_NUMBER, 1060)
    with pytest.raises(IdentityError, match="model"):
        rig.driver.recover()
    assert asked(rig) <= ASKING


def test_an_arm_whose_torque_is_off_cannot_come_back() -> None:
    rig = build()
    rig.driver.connect()
    with pytest.raises(NotEnabledError, match="torque on"):
        rig.driver.recover()
    with pytest.raises(DriverError, match="connection"):
        build().driver.recover()


def test_a_port_that_answers_again_by_itself_has_not_lapsed() -> None:
    rig = working()
    rig.port.lost = True
    with pytest.raises(PortLostError):
        rig.driver.read()
    rig.port.lost = False
    rig.driver.read()
    assert rig.driver.lapsed is False
