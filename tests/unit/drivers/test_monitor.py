"""The slow checks in the gaps of the cycle: who is asked when, what an answer is taken for, and what is made of it."""

from __future__ import annotations

import struct

import pytest

from drivers.dynamixel.budget import LinkTiming, gaps_of, group_read_s
from drivers.dynamixel.errors import FaultCause
from drivers.dynamixel.events import DriverEvent, OncePerServo
from drivers.dynamixel.line import codec
from drivers.dynamixel.monitor import SKIPPED_MAX, GapMonitor, Page, ServoRecord, status_bytes
from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import HardwareError
from drivers.dynamixel.servo.thermal import ThermalWatch
from tests.support.servos.dxl_rig import WX200

BAUD, LINK = 1_000_000, LinkTiming()
AMPLE_NS = 10_000_000
WATCHDOG = 10
HEALTHY = (1, 1, 0, WATCHDOG, 0)  # torque, LED, hardware error, watchdog, goal
OVERLOAD, HOT_BIT = HardwareError.OVERLOAD, HardwareError.OVERHEATING


def records() -> list[ServoRecord]:
    """Of all seven servos, as bring-up found them."""
    return [
        ServoRecord(
            slot=slot,
            goal=table.GOAL_CURRENT,
            watchdog=WATCHDOG,
            shutdown=OVERLOAD,
            voltage_limits_V=(9.5, 16.0),
            thermal=ThermalWatch(80.0),
            voltage_V=12.0,
            temperature_C=30.0,
        )
        for slot in WX200.slots
    ]


class Bench:
    """A monitor, its records, what it told, and a bus that answers as the test says."""

    def __init__(self, per_gap: int = 2, *, fast: bool = False) -> None:
        self.records = records()
        self.events: list[DriverEvent] = []
        self.monitor = GapMonitor(
            self.records, per_gap, BAUD, LINK, OncePerServo(self.events.append), fast=fast
        )  # fmt: skip
        self.now_ns = 0

    def ask(self, gap_ns: int = AMPLE_NS) -> tuple[Page, tuple[int, ...]] | None:
        """Page and servos of the next question."""
        request, wire_ns = self.monitor.question(gap_ns)
        if not request:
            assert wire_ns == 0
            return None
        address, *ids = struct.unpack("<H", request[8:10])[0], *request[12:-2]
        page = next(page for page in Page if page.value[0] == address)
        return page, tuple(ids)

    def reply(self, ids: tuple[int, ...], *values: tuple[int, ...], page: Page = Page.STATUS, error: int = 0) -> bytes:
        return b"".join(
            codec.status(i, error, struct.pack("<" + page.value[1], *v)) for i, v in zip(ids, values, strict=True)
        )

    def tell(self, servo_id: int, *values: int, page: Page = Page.STATUS, error: int = 0) -> None:
        """Let one servo's answer come: the next question goes round until it is asked."""
        for _ in range(40):
            asked = self.ask()
            assert asked is not None
            found, ids = asked
            others = HEALTHY if found is Page.STATUS else (120, 30)
            rows = [values if (i, found) == (servo_id, page) else others for i in ids]
            self.now_ns += 5_000_000
            self.monitor.answer(self.reply(ids, *rows, page=found, error=error), self.now_ns, final=True)
            if servo_id in ids and found is page:
                return
        raise AssertionError(f"servo {servo_id} is never asked")

    def causes(self) -> list[tuple[str, int]]:
        return [(fault.cause.name, fault.servo_id) for fault in self.monitor.faults]


# --- who is asked when -----------------------------------------------------------------------------------------------


def answered(bench: Bench, count: int) -> list[tuple[str, tuple[int, ...]]]:
    asked = []
    for _ in range(count):
        question = bench.ask()
        assert question is not None
        page, ids = question
        asked.append((page.name, ids))
        rows = [HEALTHY if page is Page.STATUS else (120, 30)] * len(ids)
        bench.monitor.answer(bench.reply(ids, *rows, page=page), 0, final=False)
        assert not bench.monitor.awaited
    return asked


def test_all_are_asked_in_turn_and_every_eighth_question_is_a_slow_one() -> None:
    groups = [(1, 2), (3, 4), (5, 6), (7,)]
    often = [("STATUS", groups[k % 4]) for k in range(14 * 4)]
    seldom = [("SLOW", groups[k % 4]) for k in range(8)]
    wanted = []
    for k in range(8):
        wanted += [*often[7 * k : 7 * k + 7], seldom[k]]
    assert answered(Bench(), 64) == wanted


@pytest.mark.parametrize("per_gap", [0, 1])
def test_where_a_gap_has_room_for_none_each_is_asked_alone_when_one_has(per_gap: int) -> None:
    assert [ids for _, ids in answered(Bench(per_gap), 7)] == [(i,) for i in range(1, 8)]


@pytest.mark.parametrize(("per_gap", "gaps"), [(7, 2), (2, 5), (1, 8)])
def test_a_round_counts_the_gaps_of_slow_questions(per_gap: int, gaps: int) -> None:
    assert gaps_of(-(-len(WX200.slots) // per_gap)) == gaps


def test_gaps_that_are_too_short_do_not_silence_the_checks_for_ever_and_are_told_once() -> None:
    bench = Bench()
    (wire_ns,) = {bench.monitor.question(AMPLE_NS)[1]}
    bench.monitor.answer(b"", 0, final=True)
    assert bench.ask() is None, "the answer that was missed may come yet"
    asked = [bench.ask(wire_ns - 1) for _ in range(SKIPPED_MAX + 1)]
    assert asked == [None] * SKIPPED_MAX + [(Page.STATUS, (3, 4))]
    (told,) = bench.events
    wire_ms, left_ms = (f"{ns * 1e-6:.1f} ms" for ns in (wire_ns, wire_ns - 1))
    assert told.kind.name == "SLOW_CHECKS"
    assert told.text == f"a question takes {wire_ms}, and the cycle leaves {left_ms}: every 25th waits"
    bench.monitor.answer(bench.reply((3, 4), HEALTHY, HEALTHY), 0, final=True)
    asked = [bench.ask(gap_ns) for gap_ns in [wire_ns - 1] * SKIPPED_MAX + [wire_ns]]
    assert asked == [None] * SKIPPED_MAX + [(Page.STATUS, (5, 6))]
    bench.monitor.answer(bench.reply((5, 6), HEALTHY, HEALTHY), 0, final=True)
    assert [bench.ask(-wire_ns) for _ in range(SKIPPED_MAX)] == [None] * SKIPPED_MAX, "one that fits counts anew"
    assert bench.monitor.question(-wire_ns, whole=False)[0] == b"", "a bus that is silent has no time to spare"
    assert bench.ask(-wire_ns) == (Page.STATUS, (7,))
    assert len(bench.events) == 1


def test_cycles_in_which_servos_are_silent_count_for_nothing() -> None:
    bench = Bench()
    for _ in range(3 * SKIPPED_MAX):
        assert bench.monitor.question(0, whole=False) == (b"", 0)
    assert [bench.ask(0) for _ in range(SKIPPED_MAX)] == [None] * SKIPPED_MAX
    assert bench.ask(0) == (Page.STATUS, (1, 2))


@pytest.mark.parametrize("fast", [False, True])
def test_a_gap_that_is_too_short_by_a_nanosecond_is_left_alone(fast: bool) -> None:
    bench = Bench(3, fast=fast)
    wire_s = sum(group_read_s(3, 6, BAUD, fast=fast, link=LINK))
    wire_ns = round(1.1 * 1e9 * wire_s)
    assert bench.monitor.question(wire_ns - 1) == (b"", 0)
    request, occupied_ns = bench.monitor.question(wire_ns)
    assert request
    assert occupied_ns == wire_ns
    assert request == bench.monitor._often[0].read.request, "nothing was passed over"


@pytest.mark.parametrize("per_gap", [1, 3, 7])
def test_the_longest_answer_is_the_status_of_as_many_servos_as_a_gap_takes(per_gap: int) -> None:
    assert Bench(per_gap).monitor.answer_bytes == len(codec.status(1, 0, bytes(6))) * per_gap


def test_nothing_is_asked_while_an_answer_is_awaited() -> None:
    bench = Bench()
    assert not bench.monitor.awaited
    assert bench.ask() == (Page.STATUS, (1, 2))
    assert bench.monitor.awaited
    assert bench.ask() is None
    bench.monitor.answer(b"", 0, final=False)
    assert bench.monitor.awaited
    assert bench.ask() is None


def test_after_a_missed_answer_one_gap_is_left_empty_and_the_miss_is_counted() -> None:
    bench = Bench()
    bench.ask()
    bench.monitor.answer(bench.reply((1,), HEALTHY), 0, final=True)
    assert (bench.monitor.misses, bench.monitor.awaited) == (1, False)
    assert bench.ask() is None
    assert bench.ask() == (Page.STATUS, (3, 4))
    bench.monitor.answer(bench.reply((3, 4), HEALTHY, HEALTHY), 0, final=True)
    assert bench.monitor.misses == 1
    assert bench.ask() == (Page.STATUS, (5, 6))


def test_an_answer_that_nobody_asked_for_is_nothing() -> None:
    bench = Bench()
    bench.monitor.answer(bench.reply((1, 2), (0, 0, 0, 0, 0), HEALTHY), 0, final=True)
    assert bench.causes() == []
    assert bench.monitor.misses == 0


def test_an_alert_is_asked_about_at_once_and_once() -> None:
    bench = Bench()
    assert answered(bench, 1) == [("STATUS", (1, 2))]
    bench.monitor.alert(6)
    bench.monitor.alert(5)
    bench.monitor.alert(3)
    assert [ids for _, ids in answered(bench, 4)] == [(5, 6), (3, 4), (3, 4), (5, 6)], "every other gap is the round's"


def test_a_servo_whose_error_stands_takes_no_more_than_every_other_gap_from_the_round() -> None:
    undisturbed, bench, asked = answered(Bench(), 64), Bench(), []
    for _ in range(128):
        for servo_id in (2, 7):  # as every answer of theirs says
            bench.monitor.alert(servo_id)
        asked += answered(bench, 1)
    assert asked[::2] == [("STATUS", (1, 2)), ("STATUS", (7,))] * 32
    assert asked[1::2] == undisturbed


def test_an_alert_waits_for_a_gap_that_is_long_enough() -> None:
    bench = Bench()
    bench.monitor.alert(7)
    assert bench.ask(10) is None
    assert bench.ask() == (Page.STATUS, (7,))


# --- what is made of a status ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "cause", "found", "expected"),
    [
        ((0, 0, 0, WATCHDOG, 0), FaultCause.REBOOTED, "Torque Enable 0, LED 0", "1, 1"),
        ((0, 1, 0, WATCHDOG, 0), FaultCause.TORQUE_LOST, "Torque Enable 0", "1"),
        ((1, 1, 0, -1, 0), FaultCause.WATCHDOG_TRIPPED, "Bus Watchdog -1", "10"),
        ((1, 1, 0, 9, 0), FaultCause.REBOOTED, "Bus Watchdog 9", "10"),
        ((0, 0, 0x20, WATCHDOG, 0), FaultCause.HARDWARE_ERROR, "OVERLOAD", "no error"),
    ],
)
@pytest.mark.parametrize("servo_id", [1, 4, 7])
def test_a_status_that_is_not_as_it_should_be_is_a_fault(
    servo_id: int, values: tuple[int, ...], cause: FaultCause, found: str, expected: str
) -> None:
    bench = Bench()
    for _ in range(2):
        bench.tell(servo_id, *values)
    (fault,) = bench.monitor.faults
    assert (fault.cause, fault.servo_id, fault.found, fault.expected) == (cause, servo_id, found, expected)
    assert fault.hardware == (OVERLOAD if cause is FaultCause.HARDWARE_ERROR else 0)


@pytest.mark.parametrize(
    ("half_armed", "watchdog", "cause"),
    [
        (True, 0, FaultCause.WATCHDOG_TRIPPED),
        (False, 0, FaultCause.REBOOTED),
        (True, 9, FaultCause.REBOOTED),
        (True, -1, FaultCause.WATCHDOG_TRIPPED),
    ],
)
def test_a_watchdog_that_was_cleared_to_be_armed_is_none_of_a_servo_that_restarted(
    half_armed: bool, watchdog: int, cause: FaultCause
) -> None:
    bench = Bench()
    bench.monitor.half_armed = half_armed
    bench.tell(4, 1, 1, 0, watchdog, 0)
    (fault,) = bench.monitor.faults
    assert (fault.cause, fault.found, fault.expected) == (cause, f"Bus Watchdog {watchdog}", "10")


def test_no_goal_is_doubted_while_watchdogs_are_armed_again_for_those_of_rest_went_out_past_the_loop() -> None:
    bench = Bench()
    bench.monitor.half_armed = True
    for _ in range(3):
        bench.tell(4, 1, 1, 0, WATCHDOG, 77)
    assert bench.causes() == []
    bench.monitor.half_armed = False
    bench.tell(4, 1, 1, 0, WATCHDOG, 77)
    assert bench.causes() == [], "one doubt is none yet"
    bench.tell(4, 1, 1, 0, WATCHDOG, 77)
    assert bench.causes() == [("GOAL_IGNORED", 4)]


def test_faults_of_different_servos_and_causes_are_all_kept() -> None:
    bench = Bench()
    bench.tell(1, 0, 1, 0, WATCHDOG, 0)
    bench.tell(2, 0, 1, 0, WATCHDOG, 0)
    bench.tell(1, 1, 1, 0, -1, 0)
    assert bench.causes() == [("TORQUE_LOST", 1), ("TORQUE_LOST", 2), ("WATCHDOG_TRIPPED", 1)]


def test_a_healthy_status_is_no_fault() -> None:
    bench = Bench()
    bench.tell(2, *HEALTHY)
    assert bench.causes() == []
    assert bench.events == []


@pytest.mark.parametrize("error", [1, 7, 0x40, 0x80])
def test_what_a_servo_answers_with_an_error_is_believed_only_when_it_is_the_alert(error: int) -> None:
    bench = Bench()
    bench.tell(1, 0, 1, 0, WATCHDOG, 0, error=error)
    assert bool(bench.causes()) == (error == 0x80)


def test_a_servo_that_works_with_its_led_off_has_not_restarted() -> None:
    bench = Bench()
    bench.tell(1, 1, 0, 0, WATCHDOG, 0)
    assert bench.causes() == []


def test_a_fault_of_another_cause_does_not_carry_the_error_bits() -> None:
    bench = Bench()
    bench.tell(1, 0, 1, int(HOT_BIT), WATCHDOG, 0)
    (fault,) = bench.monitor.faults
    assert (fault.cause, fault.hardware) == (FaultCause.TORQUE_LOST, 0)


def test_an_error_bit_that_does_not_stop_the_servo_is_told_once_until_it_is_gone() -> None:
    bench = Bench()
    for bits in (int(HOT_BIT), int(HOT_BIT), 0, int(HOT_BIT)):
        bench.tell(5, 1, 1, bits, WATCHDOG, 0)
        assert bench.records[4].hardware == bits
    assert bench.causes() == []
    told = [(event.kind.name, event.servo_id, event.joint, event.text) for event in bench.events]
    assert told == [("HARDWARE_WARNING", 5, "wrist_angle", "OVERHEATING")] * 2


def test_an_error_bit_that_stops_the_servo_is_a_fault_and_not_told_as_one_that_does_not() -> None:
    bench = Bench()
    bench.tell(5, 0, 1, int(OVERLOAD), WATCHDOG, 0)
    assert [fault.hardware for fault in bench.monitor.faults] == [OVERLOAD]
    assert bench.events == []
    bench.tell(5, 0, 1, int(OVERLOAD | HOT_BIT), WATCHDOG, 0)
    bench.tell(5, 0, 1, int(OVERLOAD), WATCHDOG, 0)
    bench.tell(5, 0, 1, int(OVERLOAD | HOT_BIT), WATCHDOG, 0)
    assert [(event.kind.name, event.text) for event in bench.events] == [("HARDWARE_WARNING", "OVERHEATING")] * 2


def test_a_goal_is_the_last_one_sent_or_the_one_before() -> None:
    bench = Bench()
    record = bench.records[3]
    record.sent, record.sent_before = 40, 30
    for goal in (40, 30, 40):
        bench.tell(4, 1, 1, 0, WATCHDOG, goal)
        assert record.goal_doubts == 0
    assert bench.causes() == []


def test_a_servo_that_was_sent_nothing_should_have_no_goal() -> None:
    bench = Bench()
    bench.tell(4, 1, 1, 0, WATCHDOG, 1)
    assert bench.records[3].goal_doubts == 1


def test_one_wrong_goal_is_a_doubt_that_is_asked_about_at_once_and_two_are_a_fault() -> None:
    bench = Bench()
    bench.records[3].sent = bench.records[3].sent_before = 40
    bench.tell(4, 1, 1, 0, WATCHDOG, 20)
    assert bench.causes() == []
    assert bench.ask() == (Page.STATUS, (3, 4)), "out of turn"
    bench.monitor.answer(bench.reply((3, 4), HEALTHY, (1, 1, 0, WATCHDOG, 20)), 0, final=True)
    (fault,) = bench.monitor.faults
    assert (fault.cause, fault.servo_id) == (FaultCause.GOAL_IGNORED, 4)
    assert (fault.found, fault.expected) == ("Goal Current 20", "40")


def test_a_doubt_that_was_cleared_is_forgotten() -> None:
    bench = Bench()
    bench.records[3].sent = bench.records[3].sent_before = 40
    for goal in (20, 40, 20, 40):
        bench.tell(4, 1, 1, 0, WATCHDOG, goal)
    assert bench.causes() == []


# --- what is made of the slow values ---------------------------------------------------------------------------------


def test_supply_and_temperature_of_all_servos_are_asked_for_first_where_they_are_old() -> None:
    """Every other gap is the round's all the same."""
    bench = Bench()
    bench.monitor.look_at_supply()
    asked = []
    for _ in range(8):
        page, ids = bench.ask() or (None, ())
        asked.append((page, ids))
        bench.monitor.answer(
            bench.reply(ids, *[HEALTHY if page is Page.STATUS else (115, 30)] * len(ids), page=page), 9, final=True
        )
    groups = [(1, 2), (3, 4), (5, 6), (7,)]
    assert asked == [(page, group) for group in groups for page in (Page.SLOW, Page.STATUS)]
    assert {record.voltage_V for record in bench.records} == {11.5}


def test_temperature_and_voltage_are_remembered_in_their_units() -> None:
    bench = Bench()
    bench.tell(3, 113, 41, page=Page.SLOW)
    assert (bench.records[2].voltage_V, bench.records[2].temperature_C) == (pytest.approx(11.3), 41.0)
    assert (bench.records[2].slow_ns, bench.records[6].slow_ns) == (bench.now_ns, 0), "the last has not been asked yet"
    assert bench.events == []


@pytest.mark.parametrize(("decivolts", "told"), [(99, True), (100, False), (155, False), (156, True)])
@pytest.mark.fault("S3")
def test_a_supply_within_half_a_volt_of_a_limit_is_told(decivolts: int, told: bool) -> None:
    bench = Bench()
    for record in bench.records:
        record.voltage_limits_V = (9.5, 16.0)
    bench.tell(3, decivolts, 30, page=Page.SLOW)
    assert [event.kind.name for event in bench.events] == ["VOLTAGE"] * told
    if told:
        assert bench.events[0].text == f"{decivolts / 10:.1f} V of 9.5 to 16.0 V"
        assert (bench.events[0].servo_id, bench.events[0].joint) == (3, "shoulder")


@pytest.mark.parametrize(("temperature", "told"), [(74, []), (75, ["HOT"]), (79, ["HOT"])])
@pytest.mark.fault("S3")
def test_a_servo_within_five_degrees_of_its_limit_is_told(temperature: int, told: list[str]) -> None:
    bench = Bench()
    bench.tell(6, 120, temperature, page=Page.SLOW)
    assert [event.kind.name for event in bench.events] == told
    if told:
        assert bench.events[0].text == f"{temperature} °C of 80 °C"


def test_a_servo_that_will_get_too_hot_is_told_before_and_not_twice_when_it_is() -> None:
    bench = Bench(7)
    temperature, kinds = 60.0, []
    while temperature < 76.0:
        bench.tell(6, 120, round(temperature), page=Page.SLOW)
        bench.now_ns += 1_000_000_000
        temperature += 0.2
        kinds = [event.kind.name for event in bench.events]
    assert kinds == ["HEATING", "HOT"]
    assert "of 80 °C" in bench.events[0].text
    assert int(bench.events[0].text.split()[0]) < 70


def test_a_servo_that_is_hot_already_is_not_told_to_become_so() -> None:
    bench = Bench()
    thermal = ThermalWatch(80.0)
    bench.records[5].thermal = thermal
    for second in range(100):  # in the shade of other questions: told of nothing yet
        thermal.add(float(second), 60.0 + 0.2 * second)
    assert thermal.heating
    bench.now_ns = 100_000_000_000
    bench.tell(6, 120, 80, page=Page.SLOW)
    assert thermal.heating
    assert [event.kind.name for event in bench.events] == ["HOT"]


# --- bytes -----------------------------------------------------------------------------------------------------------


def test_the_status_is_mapped_from_the_registers_it_tells_of() -> None:
    assert status_bytes(table.GOAL_CURRENT) == (64, 65, 70, 98, 102, 103)
    assert status_bytes(table.GOAL_PWM) == (64, 65, 70, 98, 100, 101)
    assert Page.STATUS.value == (224, "BBBbh")
    assert Page.SLOW.value == (144, "HB")
