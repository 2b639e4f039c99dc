"""What a connected arm does between the bus and the driver: what it hears, counts, sends and remembers; no emulator
answers here but at connect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.budget import LinkTiming, cycle_budget
from drivers.dynamixel.cycle import CycleRows
from drivers.dynamixel.errors import DxlServoFault, FaultCause
from drivers.dynamixel.events import DriverEvent
from drivers.dynamixel.identify import IdentityError
from drivers.dynamixel.interpret import Reading
from drivers.dynamixel.line.bus import BABBLE_BYTES
from drivers.dynamixel.line.group import Row
from drivers.dynamixel.running import Running
from drivers.dynamixel.servo.codes import HardwareError
from drivers.interface import JointState
from tests.support.servos.dxl_rig import WX200, XL, at, build, with_gripper

STILL: tuple[Row, ...] = ((0, 0, 0, 2048),) * 7
NOTHING = JointState(0, np.zeros(4), np.zeros(4), np.zeros(4))
OVERLOAD, HOT = HardwareError.OVERLOAD, HardwareError.OVERHEATING


@dataclass
class Clock:
    """Stands still but when the port is waited for."""

    ns: int = 1_000_000

    def now_ns(self) -> int:
        return self.ns


@dataclass
class Line:
    """A port that gives the bytes it was given, and remembers what was written and until when."""

    clock: Clock
    at_once: list[bytes] = field(default_factory=list)
    awaited: list[bytes] = field(default_factory=list)
    step_ns: int = 0  # that a wait takes
    waits: list[int] = field(default_factory=list)
    reads: int = 0
    discards: int = 0
    writes: list[tuple[bytes, int]] = field(default_factory=list)

    def read_now(self) -> bytes:
        self.reads += 1
        return self.at_once.pop(0) if self.at_once else b""

    def read_until(self, deadline_ns: int) -> bytes:
        self.waits.append(deadline_ns)
        self.clock.ns += self.step_ns
        return self.awaited.pop(0) if self.awaited else b""

    def discard_input(self) -> int:
        self.discards += 1
        return 40

    def write(self, data: bytes, deadline_ns: int) -> None:
        self.writes.append((data, deadline_ns))


@dataclass
class Monitor:
    """Stands in for the gap monitor; awaits an answer until it has been asked about it `patience` times."""

    patience: int = 0
    question_ns: int = 0
    request: bytes = b""
    heard: list[tuple[bytes, int, bool]] = field(default_factory=list)
    alerts: list[int] = field(default_factory=list)
    gaps: list[int] = field(default_factory=list)
    wholes: list[bool] = field(default_factory=list)
    faults: list[DxlServoFault] = field(default_factory=list)
    half_armed: bool = False

    @property
    def awaited(self) -> bool:
        return self.patience > 0

    def answer(self, heard: bytes, now_ns: int, *, final: bool) -> None:
        self.heard.append((heard, now_ns, final))
        self.patience -= 1

    def alert(self, servo_id: int) -> None:
        self.alerts.append(servo_id)

    def question(self, gap_ns: int, *, whole: bool) -> tuple[bytes, int]:
        self.gaps.append(gap_ns)
        self.wholes.append(whole)
        return self.request, self.question_ns


class Bench:
    """`Running` as connect makes it, then with a line, a clock and a monitor of the test's own."""

    def __init__(self, arm: ArmMap = WX200, **more: Any) -> None:
        rig = build(arm, **more)
        rig.driver.connect()
        self.rig = rig
        self.events: list[DriverEvent] = rig.events
        self.found = list(rig.driver._found)
        self.running = self.made()
        self.clock = Clock()
        self.line = Line(self.clock)
        self.monitor = Monitor()

    def made(self) -> Running:
        driver = self.rig.driver
        return Running(
            driver._bus, self.rig.arm, self.found, self.rig.clock, self.events.append, LinkTiming(), fast=True
        )

    def alone(self) -> Running:
        """Without the emulator."""
        running: Any = self.running
        running._bus.port = self.line
        running._clock = self.clock
        running.monitor = self.monitor
        return self.running


@pytest.fixture
def bench() -> Bench:
    return Bench()


def fault(cause: FaultCause, servo_id: int) -> DxlServoFault:
    return DxlServoFault(cause, servo_id=servo_id, joint=f"joint {servo_id}", found="nothing", expected="more")


def reading(*faults: DxlServoFault) -> Reading:
    return Reading(NOTHING, [], False, list(faults))


# --- as connect made it ----------------------------------------------------------------------------------------------


def test_records_begin_with_what_connect_found() -> None:
    found = {"Max_Voltage_Limit": 150, "Min_Voltage_Limit": 105, "Temperature_Limit": 71, "Shutdown": 0x21}
    bench = Bench(eeprom=found)
    for servo, record in zip(bench.found, bench.running._records, strict=True):
        assert record.slot is servo.slot
        assert record.voltage_limits_V == (10.5, 15.0)
        assert record.thermal.limit_C == 71.0
        assert record.shutdown == 0x21
        assert (record.voltage_V, record.temperature_C) == (
            servo.values["Present Input Voltage"] / 10,
            servo.values["Present Temperature"],
        )
        assert record.voltage_V > 10.0
        assert record.temperature_C > 20.0
        assert record.watchdog == round(WX200.watchdog_s / 0.02)
        assert record.goal.name == ("Goal PWM" if servo.slot.joint.servo == XL else "Goal Current")


def test_the_first_goals_are_those_at_rest(bench: Bench) -> None:
    rest = bench.running._goals
    assert rest == [record.sent for record in bench.running._records]
    assert rest == [record.sent_before for record in bench.running._records]
    assert rest[1:6] == [0] * 5
    assert rest[0] > 0, "a held joint rests at its whole effort"


@pytest.mark.parametrize(("rate_hz", "told"), [(79.0, True), (80.0, False), (81.0, False)])
def test_checks_that_take_longer_than_fifty_milliseconds_are_told(rate_hz: float, told: bool) -> None:
    """At these rates all servos are asked in one gap of two; a fault is then seen after four."""
    slow = [e for e in Bench(at(WX200, rate_hz=rate_hz)).events if e.kind.name == "SLOW_CHECKS"]
    assert bool(slow) == told
    assert all(event.text == "all servos once in 51 ms, should be 50 ms; raise rate_hz to 80 or more" for event in slow)


def test_made_again_it_is_the_same_arm_with_nothing_remembered(bench: Bench) -> None:
    for fast in (True, False):
        bench.running.fast = fast
        bench.running._goals[1] = 77
        again = bench.running.again()
        assert again is not bench.running
        assert again.fast is fast
        assert again.reader.fast is fast
        assert again._goals[1] == 0
        assert again._made_of == bench.running._made_of
        again.hear_health()
        assert again.reader.read().rows[0] is not None, "on the same bus"


def test_made_again_it_knows_the_supply_and_the_heat_of_its_servos_as_last_read(bench: Bench) -> None:
    """Effort is made of the supply, and a reading of the connection is not a new one."""
    record = bench.running._records[2]
    record.voltage_V, record.temperature_C, record.slow_ns = 10.4, 61.0, 77
    record.thermal.add(1.0, 61.0)
    again = bench.running.again()
    health = again.health(100)
    assert (health.voltage_V[2], health.temperature_C[2], health.slow_ns[2]) == (10.4, 61.0, 77)
    assert again._records[2].thermal is record.thermal
    assert again._records[2].sent == 0


def test_there_is_one_packet_per_register_that_some_joint_uses(bench: Bench) -> None:
    assert [(writer.ids, joints) for writer, joints in bench.running._writers] == [((2, 4, 5), [0, 1, 2]), ((6,), [3])]
    no_pwm = tuple(replace(j, role=WX200.joints[0].role) if j.name == "wrist_rotate" else j for j in WX200.joints)
    assert [w.ids for w, _ in Bench(at(WX200, joints=no_pwm)).running._writers] == [(2, 4, 5)]


# --- hearing ---------------------------------------------------------------------------------------------------------


def test_what_came_is_taken_in_its_order_and_looked_at_once(bench: Bench) -> None:
    running = bench.alone()
    bench.line.at_once = [b"ab", b"c"]
    running.hear_health()
    assert bench.monitor.heard == [(b"abc", bench.clock.ns, False)]
    assert bench.line.waits == []
    assert (bench.line.discards, running._bus.counters.stray_bytes) == (0, 0)


def test_an_answer_is_waited_for_until_the_wire_is_free(bench: Bench) -> None:
    running = bench.alone()
    bench.monitor.patience = 9
    bench.line.step_ns = 100
    bench.line.at_once, bench.line.awaited = [b"a"], [b"b", b"", b"c"]
    free_ns = running._wire_free_ns = bench.clock.ns + 300
    running.hear_health()
    assert bench.line.waits == [free_ns] * 3
    assert [heard for heard, _, _ in bench.monitor.heard] == [b"a", b"ab", b"ab", b"abc"]
    assert [at_ns - free_ns for _, at_ns, _ in bench.monitor.heard] == [-300, -200, -100, 0]
    assert not any(final for _, _, final in bench.monitor.heard)


def test_an_answer_that_has_come_is_not_waited_for(bench: Bench) -> None:
    running = bench.alone()
    bench.monitor.patience = 2
    running._wire_free_ns = bench.clock.ns + 1_000
    running.hear_health()
    assert len(bench.line.waits) == 1


@pytest.mark.parametrize(("chunks", "reads"), [([256] * 9, 3), ([767, 1, 1], 2), ([767], 2)])
def test_a_line_that_babbles_is_listened_to_for_so_long_only(bench: Bench, chunks: list[int], reads: int) -> None:
    running = bench.alone()
    bench.monitor.patience = 5
    running._wire_free_ns = bench.clock.ns + 1
    bench.line.step_ns = 1
    bench.line.at_once = [bytes(count) for count in chunks]
    running.hear_health()
    babbles = sum(chunks) >= BABBLE_BYTES == 768
    assert bench.line.reads == reads
    assert len(bench.line.waits) == (not babbles)
    assert bench.line.discards == babbles
    assert running._bus.counters.stray_bytes == (768 + 40 if babbles else 0)


def test_stray_bytes_add_up_also_those_that_came_while_waiting(bench: Bench) -> None:
    running = bench.alone()
    bench.monitor.patience = 50
    running._wire_free_ns = bench.clock.ns + 1
    for _ in range(2):
        bench.line.awaited = [bytes(500), bytes(500), bytes(500)]
        running.hear_health()
    assert running._bus.counters.stray_bytes == 2 * (1000 + 40)


def test_the_last_chance_of_an_answer_is_within_what_the_cycle_heard(bench: Bench) -> None:
    running = bench.alone()
    bench.line.at_once = [b"ab"]
    running.hear_health()
    running.interpret(CycleRows(5, [None] * 7, b"cd", False, False), 7)
    assert bench.monitor.heard[-1] == (b"abcd", 7, True)


def test_alerts_are_counted_and_asked_about(bench: Bench) -> None:
    running = bench.alone()
    rows = [(0x80 if place in (1, 5) else 0x01, 0, 0, 2048) for place in range(7)]
    running.interpret(CycleRows(5, [None, *rows[1:]], b"", False, False), 7)
    assert bench.monitor.alerts == [2, 6]
    assert running._bus.counters.alerts == 2


def test_the_goals_that_were_sent_are_what_answers_are_held_against(bench: Bench) -> None:
    running = bench.alone()
    still: list[Any] = [(0, 0, 0, 2048)] * 7
    running.write([0.0, 2.0, 0.0, 0.0], bench.clock.ns)
    found = [running.interpret(CycleRows(5 * k, still, b"", False, False), 7).faults for k in range(8)]
    assert [(f.cause, f.servo_id) for f in found[-1]] == [(FaultCause.NO_EFFECT, 4)]


@pytest.mark.parametrize("between", [0, 300, 10_000])
def test_what_the_line_carries_in_a_cycle_and_between_two_counts_and_old_answers_are_no_noise(
    bench: Bench, between: int
) -> None:
    reader, monitor = bench.running.reader, bench.running.monitor
    most = reader.answer_bytes + monitor.answer_bytes + 128
    running = bench.alone()
    for bytes_more, late, told in ((0, False, False), (1, True, False), (1, False, True)):
        between = min(between, most)
        faults: list[DxlServoFault] = []
        for _ in range(5):
            bench.line.at_once = [bytes(between)] if between else []
            running.hear_health()
            heard = bytes(most - between + bytes_more)
            faults = running.interpret(CycleRows(5, list(STILL), heard, late, False), 7).faults
        assert [(f.cause, f.servo_id, f.expected) for f in faults] == told * [
            (FaultCause.NOISE, 1, f"at most {most} a cycle")
        ]


def test_nothing_of_an_arm_that_was_connected_is_armed_in_part(bench: Bench) -> None:
    assert bench.running.monitor.half_armed is False


# --- faults ----------------------------------------------------------------------------------------------------------


def test_a_trip_that_is_forgotten_is_new_when_it_comes_again_and_nothing_else_is(bench: Bench) -> None:
    running = bench.alone()
    trip, other = fault(FaultCause.WATCHDOG_TRIPPED, 4), fault(FaultCause.SILENT, 5)
    assert running.faults(reading(trip, other), []) == [trip, other]
    assert running.faults(reading(trip, other), []) == []
    running.forget_trips()
    assert running.faults(reading(trip, other), []) == [trip]


def test_faults_of_the_monitor_and_of_the_cycle_are_both_taken_and_the_known_kept(bench: Bench) -> None:
    running = bench.alone()
    old, seen, read = (fault(FaultCause.SILENT, i) for i in (1, 2, 3))
    known = [old]
    assert running.faults(reading(), known) is known
    bench.monitor.faults = [seen]
    known = running.faults(reading(), known)
    assert known == [old, seen]
    assert bench.monitor.faults == []
    assert running.faults(reading(read), known) == [old, seen, read]
    assert known == [old, seen], "what the driver holds is not changed behind its back"


def test_a_fault_is_new_once_for_each_cause_and_servo(bench: Bench) -> None:
    running = bench.alone()
    both = [fault(FaultCause.SILENT, 1), fault(FaultCause.TORQUE_LOST, 1), fault(FaultCause.SILENT, 2)]
    assert running.faults(reading(*both), []) == both
    assert running.faults(reading(*both), []) == []
    bench.monitor.faults = [fault(FaultCause.SILENT, 1)]
    new = fault(FaultCause.SILENT, 3)
    assert running.faults(reading(new), []) == [new], "one that is known does not hide those after it"


def test_every_new_fault_is_told_once_also_behind_another(bench: Bench) -> None:
    running, known = bench.alone(), list[Any]()
    for _ in range(3):
        known = running.faults(reading(fault(FaultCause.SILENT, 1)), known)
    for _ in range(3):
        known = running.faults(reading(fault(FaultCause.SILENT, 1), fault(FaultCause.TORQUE_LOST, 2)), known)
    known = running.faults(reading(fault(FaultCause.WATCHDOG_TRIPPED, 3)), known)
    assert [(event.kind.name, event.servo_id, event.joint, event.text) for event in bench.events] == [
        ("FAULT", 1, "joint 1", "does not answer: found nothing, expected more"),
        ("FAULT", 2, "joint 2", "torque is off: found nothing, expected more"),
    ]


def test_a_fault_that_explains_others_takes_their_place_and_says_so(bench: Bench) -> None:
    running = bench.alone()
    looked = [fault(FaultCause.SILENT, 4), fault(FaultCause.NO_EFFECT, 4)]
    cause = fault(FaultCause.REBOOTED, 4)
    assert running.faults(reading(cause), looked) == [cause]
    (event,) = bench.events
    assert (event.kind.name, event.servo_id, event.joint) == ("EXPLAINED", 4, "joint 4")
    assert event.text == f"{cause.cause.value}; it looked like: does not answer, {FaultCause.NO_EFFECT.value}"


def test_only_a_watchdog_keeps_what_it_explains_from_being_told_behind_it(bench: Bench) -> None:
    """A servo that is armed again is asked anew; of one with another defect everything that comes is kept."""
    running = bench.alone()
    broken, off = fault(FaultCause.HARDWARE_ERROR, 4), fault(FaultCause.TORQUE_LOST, 4)
    assert running.faults(reading(broken), []) == [broken]
    assert running.faults(reading(off), [broken]) == [broken, off]
    fired, still = fault(FaultCause.WATCHDOG_TRIPPED, 5), fault(FaultCause.NO_EFFECT, 5)
    assert running.faults(reading(fired, still), []) == [fired]
    assert running.faults(reading(still), []) == [still]


# --- sending ---------------------------------------------------------------------------------------------------------


def test_torques_go_out_as_counts_in_one_write_and_are_remembered(bench: Bench) -> None:
    running = bench.alone()
    sent = running.write([1.0, 0.5, -0.5, 0.1], bench.clock.ns)
    unit_Nm = 1.783 * 2.69e-3
    counts = [round(1.0 / (2 * unit_Nm)), round(0.5 / unit_Nm), -round(0.5 / unit_Nm)]
    np.testing.assert_allclose(sent[:3], np.array([2, 1, 1]) * counts * unit_Nm, rtol=1e-3)
    records = {record.slot.servo_id: record for record in running._records}
    assert [records[i].sent for i in (2, 3, 4, 5)] == [counts[0], counts[0], counts[1], counts[2]]
    assert [running._goals[i - 1] for i in (2, 3, 4, 5)] == [counts[0], counts[0], counts[1], counts[2]]
    assert running._goals[5] == records[6].sent > 0
    ((packets, _),) = bench.line.writes
    assert packets == b"".join(w.packet([records[i].sent for i in w.ids]) for w, _ in running._writers)
    before = [record.sent for record in records.values()]
    running.write([0.0] * 4, bench.clock.ns)
    assert [record.sent_before for i, record in records.items() if i in (2, 3, 4, 5, 6)] == before[1:6]
    assert [running._goals[i - 1] for i in (2, 3, 4, 5, 6)] == [0] * 5


def test_counts_are_made_for_the_speed_and_the_supply_of_that_joint(bench: Bench) -> None:
    running = bench.alone()
    running._interpreter.dq[:] = [9.0, 9.0, 9.0, 0.5]
    records = {record.slot.servo_id: record for record in running._records}
    records[6].voltage_V = 14.0
    running.write([0.0, 0.0, 0.0, 0.1], bench.clock.ns)
    assert records[6].sent == running._drives[3].command(0.1, 0.5, 14.0)[0]
    assert records[6].sent != running._drives[3].command(0.1, 0.5, 12.0)[0]


def test_the_gap_is_what_the_period_leaves_after_the_write(bench: Bench) -> None:
    running = bench.alone()
    write_ns = round(1e9 * cycle_budget(WX200, fast=True, link=LinkTiming()).write_s)
    bench.monitor.request, bench.monitor.question_ns = b"?", 123
    running.write([0.0] * 4, bench.clock.ns - 1_000)
    assert bench.monitor.gaps == [5_000_000 - 1_000 - write_ns]
    assert running._wire_free_ns == bench.clock.ns + write_ns + 123
    ((packets, deadline_ns),) = bench.line.writes
    assert packets.endswith(b"?")
    assert deadline_ns == bench.clock.ns + 5_000_000
    assert bench.monitor.wholes == [False], "nobody has answered yet"
    for rows in (list(STILL), [None, *STILL[1:]], [*STILL[:-1], None]):
        running.interpret(CycleRows(5, rows, b"", False, False), 7)
        running.write([0.0] * 4, bench.clock.ns - 1_000)
    assert bench.monitor.wholes[1:] == [True, False, False]


def test_a_width_goes_out_twice_behind_the_torques_in_the_place_of_a_question() -> None:
    """Nobody answers it: one of the two may get lost."""
    bench = Bench(with_gripper())
    running = bench.alone()
    grip, gripper = running.grip, running._records[6]
    assert grip is not None
    running.write([0.0] * 4, bench.clock.ns)
    rest = gripper.sent
    assert rest != grip.effort
    grip.go_to(0.074)
    running.write([0.0] * 4, bench.clock.ns)
    assert running._wire_free_ns == bench.clock.ns + running._write_ns, "no answer is waited for"
    assert (gripper.sent_before, gripper.sent, running._goals[6]) == (rest, grip.effort, grip.effort)
    for _ in range(2):
        running.write([0.0] * 4, bench.clock.ns)
        assert gripper.sent_before == gripper.sent == grip.effort, "none of before is right any more"
    torques, width, again, after = (packets for packets, _ in bench.line.writes)
    assert torques == after
    grip.go_on(grip)
    assert width == again == torques + grip.packets()
    assert len(bench.monitor.gaps) == 2, "the others ask"


def test_a_gripper_says_what_its_servo_said_in_the_last_cycle() -> None:
    bench = Bench(with_gripper())
    running = bench.alone()
    assert running.grip_state(5) is None, "before the first cycle"
    rows: list[Row | None] = [(0, 0, 0, 2048)] * 6
    running.interpret(CycleRows(5, [*rows, (0, 0, 0, 2875)], b"", False, False), 7)
    state = running.grip_state(77)
    assert state is not None
    assert (state.stamp_ns, state.width_m) == (77, pytest.approx(0.074, abs=1e-4))
    running.interpret(CycleRows(5, [*rows, None], b"", False, False), 7)
    assert running.grip_state(77) is None
    assert Bench().running.grip_state(77) is None, "an arm without one"


def test_made_again_it_takes_its_grip_up_again() -> None:
    running = Bench(with_gripper()).running
    assert running.grip is not None
    first = running.again().grip
    assert first is not None
    assert first.packets() == b""
    running.grip.go_to(0.03)
    second = running.again().grip
    assert second is not None
    assert second.packets() == running.grip.packets() != b""


def test_who_goes_on_takes_the_goals_that_the_servos_hold_and_says_what_they_ask_for(bench: Bench) -> None:
    running = bench.running
    rest = list(running._goals)
    running._records[3].voltage_V = 11.0
    torques = running.resume({2: 30, 3: 30, 6: -40}, [0.1, 0.2, 0.3, 0.4])
    one, _, _, four = running._drives
    assert torques[0] == one.goal_Nm(30, 0.1, running._records[1].voltage_V)
    assert torques[3] == four.goal_Nm(-40, 0.4, running._records[5].voltage_V)
    assert np.isnan(torques[1:3]).all(), "nobody knows what these hold"
    held = [rest[0], 30, 30, rest[3], rest[4], -40, rest[6]]
    assert running._goals == held
    assert [(record.sent, record.sent_before) for record in running._records] == [(count, count) for count in held]


def test_who_goes_on_looks_at_the_supply_before_the_round(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    looked: list[bool] = []
    monkeypatch.setattr(bench.running.monitor, "look_at_supply", lambda: looked.append(True))
    bench.running.resume({}, [0.0] * 4)
    assert looked == [True]


@pytest.mark.parametrize("awaited", [True, False])
def test_a_second_write_in_one_cycle_looks_for_the_answer_first(bench: Bench, awaited: bool) -> None:
    running = bench.alone()
    bench.monitor.patience = int(awaited)
    running.write([0.0] * 4, bench.clock.ns)
    assert len(bench.monitor.heard) == awaited


# --- health and recognition ------------------------------------------------------------------------------------------


def test_health_is_that_of_each_servo(bench: Bench) -> None:
    records = bench.running._records
    assert np.isnan(bench.running.health(0).current_A).all(), "before the first cycle"
    rows: list[Row | None] = [(0, 100 * place, 0, 2048) for place in range(7)]
    rows[2] = None
    bench.running.interpret(CycleRows(5, rows, b"", False, False), 7)
    for place, record in enumerate(records):
        record.temperature_C, record.voltage_V, record.slow_ns = 30.0 + place, 12.0 - 0.1 * place, 10 * place
    records[1].hardware, records[2].hardware = OVERLOAD, HOT
    health = bench.running.health(77)
    assert health.stamp_ns == 77
    assert health.servo_ids == (1, 2, 3, 4, 5, 6, 7)
    assert health.joints[:4] == ("waist", "shoulder", "shoulder", "elbow")
    np.testing.assert_allclose(health.temperature_C, 30.0 + np.arange(7))
    np.testing.assert_allclose(health.voltage_V, 12.0 - 0.1 * np.arange(7))
    assert health.slow_ns.tolist() == [0, 10, 20, 30, 40, 50, 60]
    assert health.error_bits.tolist() == [0, int(OVERLOAD), int(HOT), 0, 0, 0, 0]
    assert health.error_bits.dtype == np.uint8
    amperes = 2.69e-3 * 100 * np.arange(7)
    amperes[[2, 5, 6]] = np.nan  # one did not answer, two have no current sensor
    np.testing.assert_allclose(health.current_A, amperes)
    np.testing.assert_allclose(health.load, [np.nan] * 5 + [0.5, 0.6])
    np.testing.assert_allclose(health.temperature_limit_C, [80.0] * 5 + [72.0] * 2)
    np.testing.assert_allclose(health.voltage_min_V, [9.5] * 5 + [6.0] * 2)
    np.testing.assert_allclose(health.voltage_max_V, [16.0] * 5 + [14.0] * 2)
    np.testing.assert_allclose(health.stall_current_A, [2.3] * 5 + [1.4] * 2)


def pings(bench: Bench, models: Sequence[int]) -> list[tuple[int, int]]:
    """Let servos answer pings as such models; the list of what was asked."""
    asked: list[tuple[int, int]] = []
    answers = dict(zip(range(1, 8), models, strict=True))

    class Bus:
        def ping(self, servo_id: int, attempts: int) -> Any:
            asked.append((servo_id, attempts))
            return type("Ping", (), {"model_number": answers[servo_id]})

    running: Any = bench.running
    running._bus = Bus()
    return asked


def test_every_servo_is_asked_twice_at_most_and_must_be_the_model_it_was(bench: Bench) -> None:
    models = [servo.model_number for servo in bench.found]
    asked = pings(bench, models)
    bench.running.recognise()
    assert asked == [(i, 2) for i in range(1, 8)]
    pings(bench, [*models[:6], models[0]])
    with pytest.raises(IdentityError, match="model: found XM430-W350, expected XL430-W250"):
        bench.running.recognise()
