"""Faults on the bus and in servos, in virtual time at 200 Hz: seen in time, named, and never a stale state as fresh."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest

from drivers.dynamixel.errors import (
    DxlServoFault,
    FaultCause,
    PortLostError,
    StaleJointsError,
    WriteTimeoutError,
)
from drivers.dynamixel.servo import table
from drivers.interface import JointState
from sim_backend.wire.drive import Stop
from sim_backend.wire.faults import FaultKind
from sim_backend.wire.options import BusOptions, ServoOptions, SilentPredecessor, WatchdogFeed
from sim_backend.wire.timing import BusTiming
from tests.support.few import few
from tests.support.servos.copied_rig import copied
from tests.support.servos.dxl_rig import WX200, XL, Rig, at, build, enabled

PERIOD_NS = 5_000_000
TAU = np.array([0.5, 0.4, 0.3, 0.1])
CONTROLLED = {2: "shoulder", 4: "elbow", 5: "wrist_angle", 6: "wrist_rotate"}
WIRE = BusTiming()


@dataclass
class Cycle:
    """What one cycle brought, and how long its read took."""

    state: JointState | None
    error: Exception | None
    read_ns: int
    truth: list[float]  # joint angles when the read was over


def truth(rig: Rig) -> list[float]:
    joints = {joint.name: joint.free.q_rad for joint in rig.cell.arms[0].joints}
    return [joints[joint.name] for joint in rig.arm.controlled]


def cycles(rig: Rig, count: int, tau=TAU, *, until=None, step_ns: int = 0) -> list[Cycle]:
    """Run the loop as an agent does; until: stop after an error of this type; step_ns: between read and write."""
    done: list[Cycle] = []
    period_ns = rig.arm.period_ns
    start_ns = rig.clock.now_ns() + period_ns
    for k in range(count):
        rig.clock.sleep_until(start_ns + k * period_ns)
        begin_ns = rig.clock.now_ns()
        state = error = None
        try:
            state = rig.driver.read()
        except (StaleJointsError, DxlServoFault) as caught:
            error = caught
        done.append(Cycle(state, error, rig.clock.now_ns() - begin_ns, truth(rig)))
        if step_ns:
            rig.clock.sleep_until(rig.clock.now_ns() + step_ns)
        rig.driver.write(np.asarray(tau))
        if until is not None and isinstance(error, until):
            break
    return done


BEGUN: dict[str, Rig] = {}  # of which each test has a copy


@pytest.fixture(scope="module", autouse=True)
def begun() -> Iterator[None]:
    warm()
    yield
    BEGUN.clear()


def ready(**more) -> Rig:
    """An arm ready for the cycle; more: what is other about it."""
    if (key := f"ready {more}") not in BEGUN:
        BEGUN[key] = enabled(timing=WIRE, **more)
    return copied(BEGUN[key])


def warm(**more) -> Rig:
    """The same some cycles on."""
    if (key := f"warm {more}") not in BEGUN:
        BEGUN[key] = rig = ready(**more)
        assert all(c.error is None for c in cycles(rig, 20))
    return copied(BEGUN[key])


def fresh_is_fresh(done: list[Cycle]) -> None:
    """No state may be older than its cycle: angles within what a joint turns in the few ms of a read."""
    for cycle in done:
        if cycle.state is not None:
            speed = np.abs(cycle.state.dq) + 0.5
            assert np.all(np.abs(cycle.state.q - cycle.truth) < 0.004 * speed + 0.01)


def test_a_healthy_arm_never_complains():
    rig = ready()
    done = cycles(rig, 400, 0.3 * TAU)
    assert [c for c in done if c.error is not None] == []
    fresh_is_fresh(done)
    assert rig.driver.counters.timeouts == rig.driver.counters.corrupt == rig.driver.counters.late == 0
    assert rig.driver.counters.health_misses == 0
    assert rig.bus.counters.collisions == 0
    assert set(rig.kinds()) == {"EEPROM_WRITTEN"}


@pytest.mark.parametrize("servo_id", [4, 3])
def test_a_servo_that_gives_a_few_per_cent_of_its_torque_is_named_and_no_fault(servo_id):
    """60 of 885 counts of PWM; the joints are so heavy that they hardly move, so that no back-EMF explains it."""
    rig = ready()
    for joint in rig.cell.arms[0].joints:
        joint.free.dq_rad_per_s = 0.0
        joint.free.inertia_kg_m2 = 1e3
    assert all(c.error is None for c in cycles(rig, 20, 2.0 * np.ones(4)))
    rig.servo(servo_id).firmware.accept(table.GOAL_PWM, 60)
    assert all(c.error is None for c in cycles(rig, 110, 2.0 * np.ones(4)))
    told = [(e.servo_id, e.text) for e in rig.events if e.kind.name == "PART_OF_CURRENT"]
    assert [i for i, _ in told] == [servo_id]
    assert told[0][1].startswith("0.156 A of ")


@pytest.mark.parametrize(("kind", "rate_hz"), [(FaultKind.CORRUPT, 200.0), (FaultKind.DROP, 100.0)])
@pytest.mark.fault("B1")
def test_one_lost_reply_is_asked_for_again_where_the_period_has_room(kind, rate_hz):
    rig = ready(arm=at(WX200, rate_hz=rate_hz))
    cycles(rig, 20, 0.2 * TAU)
    rig.fault(kind, 6, duration_s=1.0 / rate_hz + 0.0005)  # over when the servo is asked again
    done = cycles(rig, 5, 0.2 * TAU)
    assert all(c.error is None for c in done)
    assert rig.driver.counters.retries == 1
    fresh_is_fresh(done)


@pytest.mark.parametrize("kind", [FaultKind.DROP, FaultKind.CORRUPT])
@pytest.mark.parametrize("servo_id", [2, 4, 6])
@pytest.mark.fault("B1")
def test_a_servo_whose_replies_are_lost_does_not_void_the_others(kind, servo_id):
    rig = warm()
    rig.fault(kind, servo_id)
    done = cycles(rig, 6)
    for cycle in done[1:]:  # the first may lose the tail of its merged reply
        assert isinstance(cycle.error, StaleJointsError)
        assert cycle.error.joints == (CONTROLLED[servo_id],)
        assert cycle.error.servo_ids == (servo_id,)
        place = list(CONTROLLED).index(servo_id)
        partial = cycle.error.partial
        assert np.isnan(partial.q).tolist() == [i == place for i in range(4)]
        fresh = [i for i in range(4) if i != place]
        assert np.allclose(partial.q[fresh], np.array(cycle.truth)[fresh], atol=0.05)
    assert max(c.read_ns for c in done) < PERIOD_NS


@pytest.mark.fault("B1")
def test_replies_lost_at_random_leave_only_fresh_values():
    rig = warm()
    for kind in (FaultKind.DROP, FaultKind.CORRUPT, FaultKind.DUPLICATE):
        rig.fault(kind, probability=0.05)
    rig.fault(FaultKind.DELAY, probability=0.05, delay_ms=5.0)
    done = cycles(rig, 600, 0.2 * TAU)
    fresh_is_fresh(done)
    assert max(c.read_ns for c in done) < PERIOD_NS
    assert sum(c.state is not None for c in done) > 200
    assert not any(isinstance(c.error, DxlServoFault) for c in done)


@pytest.mark.parametrize("delay_ms", [5.0, 10.0, 15.0, 35.0])
@pytest.mark.parametrize("firmware", [46, 44])
@pytest.mark.fault("B7")
def test_answers_to_earlier_cycles_are_never_a_state(delay_ms, firmware):
    rig = ready(firmware=firmware)
    cycles(rig, 20)
    rig.fault(FaultKind.DELAY, delay_ms=delay_ms)
    done = cycles(rig, 40, until=DxlServoFault)
    assert [c for c in done if c.state is not None] == []
    assert rig.driver.counters.late > 0 or isinstance(done[-1].error, DxlServoFault)


@pytest.mark.parametrize("servo_id", [2, 4])
@pytest.mark.parametrize("firmware", [46, 44])
@pytest.mark.fault("B7")
def test_one_servo_a_cycle_late_is_never_a_state(servo_id, firmware):
    rig = ready(firmware=firmware)
    cycles(rig, 20)
    rig.fault(FaultKind.DELAY, servo_id, delay_ms=5.0)
    done = cycles(rig, 20, until=DxlServoFault)
    fresh_is_fresh(done)
    assert not any(c.state is not None for c in done[1:])


def test_duplicated_replies_do_no_harm():
    rig = warm()
    rig.fault(FaultKind.DUPLICATE)
    done = cycles(rig, 50)
    fresh_is_fresh(done)
    assert max(c.read_ns for c in done) < PERIOD_NS


SILENT = list(product(SilentPredecessor, (2, 3, 6, 7), (FaultKind.SILENT, FaultKind.MUTE, FaultKind.POWER_LOSS)))


@pytest.mark.parametrize(("silent", "servo_id", "kind"), few(SILENT, SILENT[::5].__contains__))
@pytest.mark.fault("B2", "S2")
def test_a_silent_servo_is_named_within_fifty_milliseconds(kind, servo_id, silent):
    rig = warm(bus_options=BusOptions(silent_predecessor=silent))
    rig.fault(kind, servo_id)
    done = cycles(rig, 11, until=DxlServoFault)
    fault = done[-1].error
    assert isinstance(fault, DxlServoFault)
    assert (fault.cause, fault.servo_id) == (FaultCause.SILENT, servo_id)
    assert max(c.read_ns for c in done) < PERIOD_NS


@pytest.mark.fault("B3")
def test_all_silent():
    rig = warm()
    rig.fault(FaultKind.SILENT)
    done = cycles(rig, 11, until=DxlServoFault)
    assert done[0].error.partial is None
    assert isinstance(done[-1].error, DxlServoFault)


@pytest.mark.parametrize("servo_id", [1, 2, 3, 6])
@pytest.mark.fault("S4")
def test_a_rebooted_servo_is_a_fault_within_fifty_milliseconds(servo_id):
    options = ServoOptions(boot_ns=1_000_000)  # back at once: the hard case, for it answers as if nothing had happened
    rig = warm(servo_options=options)
    rig.fault(FaultKind.REBOOT, servo_id)
    done = cycles(rig, 10, 0.0 * TAU, until=DxlServoFault)
    fault = done[-1].error
    assert isinstance(fault, DxlServoFault)
    assert (fault.cause, fault.servo_id) == (FaultCause.REBOOTED, servo_id)
    assert fault.state is not None


@pytest.mark.fault("S4")
@pytest.mark.parametrize("dark", [set(range(1, 8)), set(range(1, 7)), {1, 2, 4, 5, 6, 7}])
def test_a_dip_of_the_whole_supply_leaves_no_state_to_hold_with_and_of_fewer_servos_one(dark):
    rig = warm(servo_options=ServoOptions(boot_ns=1_000_000))
    for servo_id in dark:
        rig.fault(FaultKind.REBOOT, servo_id)
    *_, last = cycles(rig, 10, 0.0 * TAU)
    assert (last.error.state is None) == (dark == set(range(1, 8)))
    assert ("no other servo of the arm has torque" in str(last.error)) == (last.error.state is None)
    assert ("; support the object, " in str(last.error)) == (last.error.state is None)
    assert ("; hold or lower the arm; " in str(last.error)) == (last.error.state is not None)
    assert last.error.cause is FaultCause.REBOOTED


def test_watchdogs_that_all_fired_leave_a_state_for_the_arm_comes_back():
    rig = warm()
    rig.clock.sleep_until(rig.clock.now_ns() + 250_000_000)
    *_, last = cycles(rig, 12, 0.0 * TAU)
    assert {fault.servo_id for fault in rig.driver.faults} == set(range(1, 8))
    assert last.error.state is not None


@pytest.mark.fault("S4")
@pytest.mark.parametrize("others_stopped", [True, False])
def test_an_arm_whose_watchdogs_fire_behind_a_servo_that_restarted_has_nothing_left_to_hold_with(
    others_stopped: bool,
) -> None:
    rig = warm(servo_options=ServoOptions(boot_ns=1_000_000))
    rig.fault(FaultKind.REBOOT, 3)
    *_, held = cycles(rig, 20, 0.0 * TAU)
    assert held.error.state is not None
    if others_stopped:
        rig.clock.sleep_until(rig.clock.now_ns() + 250_000_000)
    *_, last = cycles(rig, 20, 0.0 * TAU)
    assert (last.error.state is None) == others_stopped
    assert (last.error.cause, last.error.servo_id) == (FaultCause.REBOOTED, 3)


@pytest.mark.parametrize("servo_id", [1, 2, 3, 6])
def test_lost_torque_is_a_fault_within_fifty_milliseconds(servo_id):
    rig = warm()
    rig.put(servo_id, table.TORQUE_ENABLE, 0)
    done = cycles(rig, 10, 0.0 * TAU, until=DxlServoFault)
    assert (done[-1].error.cause, done[-1].error.servo_id) == (FaultCause.TORQUE_LOST, servo_id)


@pytest.mark.parametrize("step_ms", [2.1, 2.5])
def test_lost_torque_is_found_too_where_the_host_leaves_no_gap_a_question_fits_in(step_ms: float) -> None:
    """No state is missed."""
    rig = ready()
    healthy = cycles(rig, 100, 0.0 * TAU, step_ns=round(step_ms * 1e6))
    assert all(cycle.error is None for cycle in healthy)
    assert rig.driver.counters.timeouts == rig.driver.counters.late == 0
    assert rig.kinds().count("SLOW_CHECKS") == 1
    rig.put(6, table.TORQUE_ENABLE, 0)
    done = cycles(rig, 160, 0.0 * TAU, until=DxlServoFault, step_ns=round(step_ms * 1e6))
    assert (done[-1].error.cause, done[-1].error.servo_id) == (FaultCause.TORQUE_LOST, 6)


@pytest.mark.parametrize("kind", [FaultKind.OVERLOAD, FaultKind.ELECTRICAL_SHOCK])
@pytest.mark.parametrize("servo_id", [2, 3, 7])
@pytest.mark.fault("S1")
def test_hardware_errors_are_read_within_two_cycles_of_the_alert(kind, servo_id):
    rig = warm()
    rig.fault(kind, servo_id)
    done = cycles(rig, 4, until=DxlServoFault)
    fault = done[-1].error
    assert (fault.cause, fault.servo_id) == (FaultCause.HARDWARE_ERROR, servo_id)
    assert kind.name in fault.hardware.name
    assert rig.driver.counters.alerts > 0


def test_a_fault_is_raised_every_cycle_with_the_fresh_state():
    rig = warm()
    rig.fault(FaultKind.OVERLOAD, 7)
    cycles(rig, 5)
    done = cycles(rig, 3)
    for cycle in done:
        assert isinstance(cycle.error, DxlServoFault)
        assert np.allclose(cycle.error.state.q, cycle.truth, atol=0.05)
    assert len({cycle.error.state.stamp_ns for cycle in done}) == 3


@pytest.mark.parametrize("stop", list(Stop))
@pytest.mark.parametrize("feed", list(WatchdogFeed))
@pytest.mark.fault("S6")
def test_a_tripped_watchdog_is_named(stop, feed):
    rig = warm(servo_options=ServoOptions(watchdog_stop=stop, watchdog_feed=feed))
    rig.clock.sleep_until(rig.clock.now_ns() + 250_000_000)
    done = cycles(rig, 6, until=DxlServoFault)
    assert done[-1].error.cause is FaultCause.WATCHDOG_TRIPPED


@pytest.mark.parametrize("stop", list(Stop))
@pytest.mark.fault("S6")
def test_a_tripped_watchdog_can_be_armed_again_without_losing_torque_or_jumping(stop):
    rig = warm(servo_options=ServoOptions(watchdog_stop=stop))
    rig.clock.sleep_until(rig.clock.now_ns() + 250_000_000)
    cycles(rig, 6, 0.0 * TAU, until=DxlServoFault)
    speed = np.abs(rig.driver._running._interpreter.dq)
    rig.driver.rearm()
    done = cycles(rig, 20, 0.0 * TAU)
    assert [c for c in done if c.error is not None] == []
    assert all(rig.get(i, table.TORQUE_ENABLE) == 1 for i in range(1, 8))
    assert all(np.all(np.abs(c.state.dq) <= speed + 0.05) for c in done)  # a jump would be a kick


def test_the_watchdog_is_fed_by_the_loop_alone():
    rig = enabled(at(WX200, rate_hz=50.0, watchdog_s=0.06), timing=WIRE)
    assert not [c for c in cycles(rig, 60, 0.0 * TAU) if c.error is not None]
    assert rig.bus.counters.watchdog_trips == 0


def test_a_goal_that_is_ignored_is_a_fault():
    rig = warm()
    rig.put(4, table.CURRENT_LIMIT, 20)  # the servo now refuses larger goals, and a sync write brings no error back
    done = cycles(rig, 10, 2.0 * TAU, until=DxlServoFault)
    assert (done[-1].error.cause, done[-1].error.servo_id) == (FaultCause.GOAL_IGNORED, 4)


def test_torque_without_current_is_a_fault():
    rig = warm()
    motor = rig.servo(4).firmware.body.motor
    motor.drive_current = lambda *_: motor.open()  # a broken winding: all registers look healthy
    done = cycles(rig, 11, until=DxlServoFault)
    assert (done[-1].error.cause, done[-1].error.servo_id) == (FaultCause.NO_EFFECT, 4)


@pytest.mark.fault("S5")
def test_an_impossible_step_is_not_believed_once_and_is_a_fault_twice():
    rig = warm()
    rig.fault(FaultKind.ENCODER_OFFSET, 5, offset_ticks=57)
    done = cycles(rig, 3, 0.0 * TAU, until=DxlServoFault)
    assert done[0].error.joints == ("wrist_angle",)
    assert (done[1].error.cause, done[1].error.servo_id) == (FaultCause.POSITION_JUMP, 5)


def test_whole_turns_in_the_count_change_nothing():
    rig = warm()
    before = cycles(rig, 1, 0.0 * TAU)[0].state.q
    rig.fault(FaultKind.ENCODER_OFFSET, 5, offset_ticks=8192)
    after = cycles(rig, 3, 0.0 * TAU)
    assert all(c.error is None for c in after)
    assert np.allclose(after[0].state.q, before, atol=0.05)


@pytest.mark.fault("B5")
def test_babble_ends_by_its_deadline():
    rig = warm()
    rig.fault(FaultKind.BABBLE)
    done = cycles(rig, 12)
    fresh_is_fresh(done)
    assert max(c.read_ns for c in done) < PERIOD_NS


@pytest.mark.fault("B5")
@pytest.mark.parametrize("joints", [len(WX200.joints), 3])
def test_babble_is_a_fault_within_ten_cycles_also_where_answers_are_read_amid_it(joints: int) -> None:
    rig = enabled(at(WX200, joints=WX200.joints[:joints]), timing=WIRE)
    rest = np.zeros(len(rig.arm.controlled))
    cycles(rig, 20, rest)
    rig.fault(FaultKind.BABBLE)
    done = cycles(rig, 10, rest)
    fresh_is_fresh(done)
    told = [error for c in done if isinstance(error := c.error, DxlServoFault) and error.cause is FaultCause.NOISE]
    assert told
    assert (told[0].servo_id, told[0].joint) == (1, "waist")
    assert done[-1].error is not None
    assert joints > 3 or all(c.state is not None or isinstance(c.error, DxlServoFault) for c in done)


@pytest.mark.fault("B5")
def test_a_servo_that_talks_over_the_others_is_a_fault_within_ten_cycles_and_their_watchdogs_stop_the_arm() -> None:
    """Nobody hears the host, whatever it does: two who talk at once garble each other."""
    rig = warm()
    rest = np.zeros(len(rig.arm.controlled))
    heard = rig.bus.counters.instructions
    rig.fault(FaultKind.BABBLE, 4)
    done = cycles(rig, 12, rest)
    fresh_is_fresh(done)
    assert all(c.state is None for c in done)
    assert max(c.read_ns for c in done) < PERIOD_NS
    told = [c.error for c in done[:10] if isinstance(c.error, DxlServoFault)]
    assert told
    assert told[0].cause is FaultCause.NOISE
    assert rig.bus.counters.instructions == heard
    rig.clock.sleep_until(rig.clock.now_ns() + 10**9)
    assert rig.bus.counters.watchdog_trips == len(rig.bus.servos)


@pytest.mark.fault("B5")
def test_all_that_is_asked_for_is_no_noise_however_often_it_comes() -> None:
    rig = warm()
    for kind in (FaultKind.DELAY, FaultKind.DROP):  # answers that come late, or are asked for again
        rig.fault(kind, 4)
        errors = [c.error for c in cycles(rig, 40) if c.error is not None]
        assert errors
        assert not any(isinstance(error, DxlServoFault) and error.cause is FaultCause.NOISE for error in errors)


@pytest.mark.fault("B6")
def test_a_port_that_is_stuck_ends_within_a_cycle():
    rig = warm()
    rig.fault(FaultKind.STALL)
    rig.clock.sleep_until(rig.clock.now_ns() + 2_000_000)
    begin_ns = rig.clock.now_ns()
    with pytest.raises(StaleJointsError, match="the port took no request") as caught:
        rig.driver.read()
    assert caught.value.partial is None
    assert rig.clock.now_ns() - begin_ns <= PERIOD_NS
    with pytest.raises(WriteTimeoutError, match="0 bytes taken"):
        rig.driver.write(TAU)
    assert rig.clock.now_ns() - begin_ns <= 2 * PERIOD_NS


@pytest.mark.fault("B4")
def test_a_port_that_vanishes_is_an_error_and_comes_back_as_the_same_arm():
    rig = warm()
    rig.port.lost = True
    with pytest.raises(PortLostError, match="virtual"):
        rig.driver.read()
    with pytest.raises(PortLostError, match="virtual"):
        rig.driver.reopen()
    rig.port.lost = False
    with pytest.raises(PortLostError, match="virtual"):
        rig.driver.read()
    sent = len(rig.port.writes)
    rig.driver.reopen()
    assert all(packet[7] == 1 for packet in rig.port.writes[sent:])  # pings only
    assert all(c.error is None for c in cycles(rig, 20))


@pytest.mark.fault("B4")
def test_another_arm_on_the_port_is_not_written_to():
    rig = warm()
    other = build(at(WX200, joints=tuple(replace(j, servo=XL, tau_max_Nm=0.2) for j in WX200.joints)))
    rig.port._line = other.line
    with pytest.raises(Exception, match="model: found XL430-W250, expected XM430-W350"):
        rig.driver.reopen()
    with pytest.raises(PortLostError, match="virtual"):
        rig.driver.write(TAU)


def test_servos_of_one_joint_that_fight_are_an_event():
    rig = warm()
    rig.put(3, table.SECONDARY_ID, 255)
    rig.servo(3).write(table.GOAL_CURRENT.address, (-300).to_bytes(2, "little", signed=True))
    cycles(rig, 40, [3.0, 0.0, 0.0, 0.0])
    assert "PAIR_FIGHTING" in rig.kinds()


def test_a_servo_that_fails_behind_another_is_told_though_the_first_alone_is_raised():
    rig = warm()
    rig.fault(FaultKind.OVERLOAD, 4)
    first = cycles(rig, 60)[-1].error
    rig.servo(5).write(table.TORQUE_ENABLE.address, b"\0")
    last = cycles(rig, 60)[-1].error
    assert str(last) == str(first)
    told = [(event.servo_id, event.text) for event in rig.events if event.kind.name == "FAULT"]
    assert told[0] == (4, "hardware error: found OVERLOAD, expected no error")
    assert told.count((5, "torque is off: found Torque Enable 0, expected 1")) == 1
    assert "HARDWARE_WARNING" not in rig.kinds()


def test_heat_is_told_before_the_servo_stops():
    rig = warm()
    rig.fault(FaultKind.OVERHEAT, 4, temperature_C=77.0, ramp_s=1.0)
    done = cycles(rig, 300, 0.0 * TAU)
    assert all(c.error is None for c in done)
    hot = [event for event in rig.events if event.kind.name == "HOT"]
    assert [(event.servo_id, event.joint) for event in hot] == [(4, "elbow")]
    assert rig.driver.health().temperature_C[3] >= 75.0, "servo 4"


def test_supply_near_its_limit_is_told():
    rig = warm()
    rig.fault(FaultKind.VOLTAGE, voltage_V=9.8)
    cycles(rig, 60, 0.2 * TAU)
    assert "VOLTAGE" in rig.kinds()
    assert np.allclose(rig.driver.health().voltage_V, 9.8)


@pytest.mark.fault("S3")
@pytest.mark.parametrize("servo", [4, 6], ids=["by current", "by voltage"])
def test_a_servo_that_reports_no_supply_at_all_is_told_of_and_nothing_is_divided_by_it(servo: int):
    rig = warm()
    rig.fault(FaultKind.VOLTAGE, servo, voltage_V=0.0)
    cycles(rig, 150, 0.2 * TAU)
    assert rig.driver.health().voltage_V[servo - 1] == 0.0
    assert "VOLTAGE" in rig.kinds()
    assert np.isfinite(rig.driver.write(0.2 * TAU)).all()


@pytest.mark.fault("S3")
def test_an_error_bit_that_a_dip_of_the_supply_has_left_hides_no_heat_no_supply_and_no_lost_torque():
    rig = warm()
    rig.fault(FaultKind.VOLTAGE, voltage_V=8.5, duration_s=0.05)
    cycles(rig, 30, 0.0 * TAU)
    assert "HARDWARE_WARNING" in rig.kinds(), "which stands until each servo restarts"
    rig.fault(FaultKind.OVERHEAT, 4, temperature_C=77.0)
    rig.fault(FaultKind.VOLTAGE, 7, voltage_V=9.8)
    cycles(rig, 150, 0.0 * TAU)
    assert [event.servo_id for event in rig.events if event.kind.name == "HOT"] == [4]
    assert rig.driver.health().voltage_V[6] == pytest.approx(9.8)
    rig.put(3, table.TORQUE_ENABLE, 0)
    done = cycles(rig, 20, 0.0 * TAU, until=DxlServoFault)
    assert (done[-1].error.cause, done[-1].error.servo_id) == (FaultCause.TORQUE_LOST, 3)


def test_old_firmware_falls_back_to_plain_sync_read_and_says_so_once():
    rig = ready(firmware=44)
    assert rig.kinds().count("SLOW_SYNC_READ") == 1
    assert all(c.error is None for c in cycles(rig, 50))
    assert rig.kinds().count("SLOW_SYNC_READ") == 1


def test_checks_never_reach_into_the_next_cycle():
    rig = enabled(at(WX200, rate_hz=290.0), timing=WIRE)
    done = cycles(rig, 300, 0.2 * TAU)
    assert all(c.error is None for c in done)
    assert rig.bus.counters.collisions == 0


def test_torques_above_the_limit_are_never_sent():
    rig = warm()
    rig.driver.read()
    sent = rig.driver.write(np.array([100.0, -100.0, 0.0, 100.0]))
    assert np.all(np.abs(sent) <= [4.005, 2.005, 0.005, 0.505])
    assert (rig.get(2, table.GOAL_CURRENT), rig.get(4, table.GOAL_CURRENT)) == (417, -417)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
@pytest.mark.fault("M1")
def test_a_torque_that_is_no_number_sends_nothing(bad):
    rig = warm()
    before = rig.get(2, table.GOAL_CURRENT)
    with pytest.raises(Exception, match="4 finite numbers"):
        rig.driver.write(np.array([0.0, bad, 0.0, 0.0]))
    assert rig.get(2, table.GOAL_CURRENT) == before
