"""The read of one cycle on a line that the test scripts to the nanosecond: when it asks, waits, asks again."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import pytest

from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.budget import LinkTiming
from drivers.dynamixel.cycle import MARKS, CycleReader, CycleRows, marked_groups
from drivers.dynamixel.line import codec
from drivers.dynamixel.line.bus import Bus, DxlCounters
from tests.support.servos.dxl_rig import WX200, at

MS, US = 1_000_000, 1_000
BEGIN_NS = 1_000_000_000
# 7 servos at 1 Mbit/s, 10 µs per byte: 21 bytes of request, turnaround 40 µs and 6 gaps of 5 µs, 106 bytes of reply,
# 1 ms in the adapter
FAST_WORST_NS = 210 * US + 40 * US + 30 * US + 1060 * US + 1 * MS
# one status packet each, of 18 bytes and 11 more
EACH_WORST_NS = 210 * US + 7 * (40 + 290) * US + 1 * MS
Arrivals = list[tuple[int, bytes]]  # ns after the request, and what comes then
Answer = Callable[[int, bytes], Arrivals]


def retry_ns(servos: int) -> int:
    """Asking some servos again, one status packet each."""
    return (14 + servos) * 10 * US + servos * (40 + 290) * US + 1 * MS


class Line:
    """A port and its clock: bytes come when the script says, time passes in waiting alone."""

    baud = 1_000_000

    def __init__(self, answer: Answer) -> None:
        self.ns = BEGIN_NS
        self.answer = answer
        self.writes: list[tuple[int, bytes, int]] = []
        self.waits: list[tuple[int, int]] = []  # when it began and how long it would have lasted
        self.coming: Arrivals = []
        self.number = 0  # of requests in this cycle

    def now_ns(self) -> int:
        return self.ns

    def write(self, data: bytes, deadline_ns: int) -> None:
        self.writes.append((self.ns, data, deadline_ns))
        self.number += 1
        self.coming += [(self.ns + delay_ns, part) for delay_ns, part in self.answer(self.number, data)]

    def read_until(self, deadline_ns: int) -> bytes:
        self.waits.append((self.ns, deadline_ns))
        due = min(self.coming, default=None, key=lambda arrival: arrival[0])
        if due is None or due[0] > deadline_ns:
            self.ns = max(self.ns, deadline_ns)
            return b""
        self.coming.remove(due)
        self.ns = max(self.ns, due[0])
        return due[1]


def asked(request: bytes) -> tuple[bool, int, int, tuple[int, ...]]:
    """Whether merged, address, length and servos of a request."""
    address, length = struct.unpack("<HH", request[8:12])
    return request[7] == 0x8A, address, length, tuple(request[12:-2])


def block(servo_id: int, length: int = 10) -> bytes:
    """What a servo has at the end of its block: current 10, 20, …, velocity 1, 2, …, position 2049, …"""
    return bytes(length - 10) + struct.pack("<hii", 10 * servo_id, servo_id, 2048 + servo_id)


def row(servo_id: int, error: int = 0) -> tuple[int, ...]:
    return error, 10 * servo_id, servo_id, 2048 + servo_id


def reply(
    request: bytes, *, silent: Sequence[int] = (), damaged: Sequence[int] = (), errors: dict[int, int] | None = None
) -> bytes:
    """What the servos answer; a silent one ends a merged reply."""
    merged, _, length, ids = asked(request)
    errors = errors or {}
    if not merged:
        packets = [codec.status(i, errors.get(i, 0), block(i, length)) for i in ids if i not in silent]
        whole = [p if p[4] not in damaged else p[:-1] + bytes((p[-1] ^ 0xFF,)) for p in packets]
        return b"".join(whole)
    size = 1 + len(ids) * (length + 4)
    out, bad = codec.HEADER + bytes((0xFE, size & 0xFF, size >> 8, 0x55)), []
    for servo_id in ids:
        if servo_id in silent:
            break
        out += bytes((errors.get(servo_id, 0), servo_id)) + block(servo_id, length)
        if servo_id in damaged:
            bad.append(len(out) - 1)
        out += codec.crc16(out).to_bytes(2, "little")
    return bytes(byte ^ 0xFF if place in bad else byte for place, byte in enumerate(out))


def whole(delay_ns: int = 2 * MS, **how: Any) -> Answer:
    """Every request is answered at once after a while."""
    return lambda _, request: [(delay_ns, reply(request, **how))]


def silence(_: int, __: bytes) -> Arrivals:
    return []


class Bench:
    """A reader on a scripted line."""

    def __init__(
        self, answer: Answer, arm: ArmMap = WX200, *, fast: bool = True, link: LinkTiming | None = None
    ) -> None:
        self.arm = arm
        self.line = Line(answer)
        self.counters = DxlCounters()
        port: Any = self.line
        bus = Bus(port, self.line, self.counters)
        self.reader = CycleReader(bus, arm, self.line, self.counters, fast=fast, link=link or LinkTiming())

    def read(self) -> CycleRows:
        """One cycle, a period after the last one began."""
        self.begin_ns = self.line.ns = BEGIN_NS if not self.line.writes else self.line.ns + 10 * MS
        self.line.coming.clear()
        self.line.number = 0
        self.first = len(self.line.writes)
        self.line.waits.clear()
        return self.reader.read()

    @property
    def requests(self) -> list[tuple[int, bytes]]:
        """When and what the last cycle asked."""
        return [(at_ns - self.begin_ns, data) for at_ns, data, _ in self.line.writes[self.first :]]


ROWS = [row(i) for i in range(1, 8)]
SLOW = at(WX200, rate_hz=100.0)


# --- a healthy cycle -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fast", [True, False])
def test_rows_come_in_the_order_of_the_arm_whatever_the_order_asked_for(fast: bool) -> None:
    bench = Bench(whole(), fast=fast)
    orders = set()
    for _ in range(20):
        cycle = bench.read()
        assert cycle.rows == ROWS
        assert (cycle.late, cycle.damaged) == (False, False)
        ((at_ns, request),) = bench.requests
        assert at_ns == 0
        assert cycle.heard == reply(request)
        assert asked(request)[0] is fast
        orders.add(asked(request))
    assert len(orders) == (14 if fast else MARKS)
    assert bench.counters == DxlCounters()


def test_a_request_must_be_taken_before_the_read_is_over() -> None:
    bench = Bench(whole())
    bench.read()
    assert [deadline_ns - bench.begin_ns for _, _, deadline_ns in bench.line.writes] == [4_500 * US]
    assert bench.reader.end_ns == 4_500 * US


@pytest.mark.parametrize("fast", [True, False])
def test_the_stamp_is_when_the_servos_heard_the_request_and_not_in_the_future(fast: bool) -> None:
    bench = Bench(whole(2 * MS), fast=fast)
    assert bench.read().stamp_ns - bench.begin_ns == 250 * US
    bench = Bench(whole(200 * US), fast=fast)
    assert bench.read().stamp_ns - bench.begin_ns == 200 * US
    bench = Bench(whole(2 * MS), fast=fast, link=LinkTiming(turnaround_s=100e-6))
    assert bench.read().stamp_ns - bench.begin_ns == 310 * US


def test_a_servo_that_says_it_did_not_is_missing_and_one_with_an_alert_is_not() -> None:
    bench = Bench(whole(errors={2: 0x80, 4: 0x01, 6: 0x87}))
    assert bench.read().rows == [ROWS[0], row(2, 0x80), ROWS[2], None, ROWS[4], None, ROWS[6]]
    assert bench.counters.per_servo == {4: 1, 6: 1}
    assert len(bench.requests) == 1
    assert bench.counters.timeouts == 1


# --- requests that cannot be taken for each other --------------------------------------------------------------------


def test_merged_reads_of_many_servos_differ_by_order_and_two_blocks_must_agree() -> None:
    groups = marked_groups((1, 2, 3, 4, 5), fast=True)
    turns = [(1, 2, 3, 4, 5), (2, 3, 4, 5, 1), (3, 4, 5, 1, 2), (4, 5, 1, 2, 3), (5, 1, 2, 3, 4)]
    assert [group.ids for group in groups] == [order for turn in turns for order in (turn, turn[::-1])]
    assert {asked(group.request)[:3] for group in groups} == {(True, 126, 10)}
    assert {group._proof for group in groups} == {2}


@pytest.mark.parametrize(("ids", "fast"), [((1, 2, 3, 4), True), ((1,), True), ((1, 2, 3, 4, 5), False)])
def test_other_reads_differ_by_their_length(ids: tuple[int, ...], fast: bool) -> None:
    groups = marked_groups(ids, fast=fast)
    assert [asked(g.request)[:3] for g in groups] == [(fast, 126 - more, 10 + more) for more in range(9)]
    turns = [(*ids[k % len(ids) :], *ids[: k % len(ids)]) for k in range(9)]
    assert [group.ids for group in groups] == turns
    assert {group._proof for group in groups} == {1}
    for group in groups:
        assert group.parse(reply(group.request), final=False).rows == [row(i) for i in group.ids]


# --- how long it waits ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rate_hz", "fast", "wait_ns"),
    [
        (200.0, True, round(1.05 * FAST_WORST_NS) + 500 * US),
        (205.0, True, round(0.9e9 / 205.0) - retry_ns(1) - 50 * US),
        (100.0, False, round(1.05 * EACH_WORST_NS) + 500 * US),
    ],
)
def test_the_first_answer_is_waited_for_a_little_longer_than_a_healthy_one_takes(
    rate_hz: float, fast: bool, wait_ns: int
) -> None:
    bench = Bench(silence, at(WX200, rate_hz=rate_hz), fast=fast)
    assert bench.read().late is False
    cycle = bench.read()
    assert (cycle.late, cycle.damaged, cycle.heard) == (False, False, b"")
    first, again = bench.requests
    assert again[0] == pytest.approx(wait_ns, abs=1)
    assert cycle.rows == [None] * 7
    assert bench.line.ns - bench.begin_ns == bench.reader.end_ns
    assert bench.counters.retries == 2
    assert [d - bench.begin_ns for _, _, d in bench.line.writes[-2:]] == [bench.reader.end_ns] * 2
    assert first[0] == 0


@pytest.mark.parametrize(("rate_hz", "fast"), [(290.0, True), (200.0, False), (1e9 / 4.43e6, True)])
def test_where_asking_again_has_no_room_all_the_time_is_for_the_first_answer(rate_hz: float, fast: bool) -> None:
    bench = Bench(silence, at(WX200, rate_hz=rate_hz), fast=fast)
    bench.read()
    assert len(bench.requests) == 1
    assert bench.line.waits[0] == (bench.begin_ns, bench.begin_ns + bench.reader.end_ns)
    assert bench.line.ns - bench.begin_ns == bench.reader.end_ns == round(0.9e9 / rate_hz)
    assert bench.counters.retries == 0


def test_what_has_begun_to_come_is_waited_for() -> None:
    """Until the rest has had its time on the wire and in the adapter, whose timer is taken a tenth longer."""

    def in_two(over_ns: int) -> Answer:
        def answer(number: int, request: bytes) -> Arrivals:
            data = reply(request)
            return [(2_900 * US, data[:50]), (4_560 * US + over_ns, data[50:])] if number == 1 else []

        return answer

    for over_ns, again in ((0, 0), (1, 1)):
        bench = Bench(in_two(over_ns), at(WX200, rate_hz=120.0))
        assert bench.read().rows == ROWS
        assert len(bench.requests) == 1 + again


def test_what_is_too_long_already_is_waited_behind_for_as_long_as_the_adapter_may_keep_it() -> None:
    bench = Bench(whole(), SLOW)
    bench.read()
    old = reply(bench.requests[0][1])
    bench.line.answer = lambda number, _: [(2_900 * US, old)] if number == 1 else []
    bench.read()
    assert bench.requests[1][0] == 4 * MS


@pytest.mark.parametrize(("count", "at_once"), [(768, False), (769, True)])
def test_babble_is_more_than_768_bytes(count: int, at_once: bool) -> None:
    bench = Bench(lambda number, _: [(100 * US, bytes(count))] if number == 1 else [], SLOW)
    bench.read()
    assert (bench.requests[1][0] == 100 * US) is at_once
    bench = Bench(lambda number, _: [(100 * US, bytes(count))] if number == 2 else [], SLOW)
    bench.read()
    assert (bench.line.ns - bench.begin_ns == bench.reader.end_ns) is not at_once


def test_a_first_part_does_not_make_the_wait_shorter_nor_longer_than_the_cycle() -> None:
    bench = Bench(lambda _, request: [(100 * US, reply(request)[:50]), (2_900 * US, reply(request)[50:])])
    assert bench.read().rows == ROWS
    assert len(bench.requests) == 1
    bench = Bench(lambda n, request: [(2_900 * US, reply(request)[:20])] if n == 1 else [])
    bench.read()
    assert bench.line.waits[1][1] - bench.begin_ns <= bench.reader.end_ns
    assert bench.line.ns - bench.begin_ns == bench.reader.end_ns


def test_a_line_that_babbles_is_not_listened_to_for_ever() -> None:
    bench = Bench(lambda _, __: [(k * 10 * US, bytes(100)) for k in range(1, 300)])
    cycle = bench.read()
    assert cycle.rows == [None] * 7
    assert bench.line.ns - bench.begin_ns < 200 * US
    assert 768 < len(cycle.heard) <= 1_000


# --- asking again ----------------------------------------------------------------------------------------------------


def then(first: dict[str, Any] | None, second: dict[str, Any] | None = None, delay_ns: int = 2 * MS) -> Answer:
    """The first request of a cycle is answered in one way, the second in another or not at all."""

    def answer(number: int, request: bytes) -> Arrivals:
        how = first if number == 1 else second
        return [] if how is None else [(delay_ns if number == 1 else 200 * US, reply(request, **how))]

    return answer


def test_a_merged_reply_that_was_cut_short_is_completed_by_asking_the_others() -> None:
    """The one that cut it is asked last, so that it cannot keep the others waiting."""
    bench = Bench(then({"silent": (3,)}, {}), SLOW)
    cycle = bench.read()
    assert cycle.rows == ROWS
    assert cycle.late is False
    assert asked(bench.requests[1][1]) == (False, 126, 10, (4, 5, 6, 7, 3))
    assert (bench.counters.retries, bench.counters.timeouts, bench.counters.per_servo) == (1, 0, {})
    assert cycle.heard == reply(bench.requests[0][1], silent=(3,)) + reply(bench.requests[1][1])


def test_after_damage_the_joints_that_are_controlled_are_asked_for_first() -> None:
    bench = Bench(then({"damaged": (1, 2, 3, 5)}, {"silent": (2,)}), SLOW)
    cycle = bench.read()
    assert asked(bench.requests[1][1])[3] == (2, 5, 1, 3)
    assert cycle.rows == [ROWS[0], None, *ROWS[2:]]
    assert cycle.damaged is True
    assert bench.counters.corrupt == 4
    assert bench.counters.per_servo == {2: 1}
    assert bench.counters.timeouts == 1


def test_damage_in_both_answers_adds_up() -> None:
    bench = Bench(then({"damaged": (1, 2)}, {"damaged": (2,)}), SLOW)
    assert bench.read().rows == [ROWS[0], None, *ROWS[2:]]
    assert bench.counters.corrupt == 3


def test_the_second_request_carries_the_mark_of_its_cycle() -> None:
    bench = Bench(then({"damaged": (4,)}, {}), SLOW)
    marks = []
    for _ in range(12):
        bench.reader._careful_left = 0
        assert bench.read().damaged is True
        _, address, length, ids = asked(bench.requests[1][1])
        assert (ids, address + length) == ((4,), 136)
        marks.append(length - 10)
    assert marks == [0, 1, 2, 3, 4, 5, 6, 7, 8, 0, 1, 2]
    assert (bench.counters.corrupt, bench.counters.timeouts) == (12, 0)


def test_only_as_many_are_asked_again_as_there_is_time_for() -> None:
    """At 180 Hz the read is over after 5 ms; an answer at the right moment leaves time for exactly three."""
    for late_ns, count in ((0, 3), (1, 2)):
        delay_ns = 5 * MS - retry_ns(3) + late_ns
        bench = Bench(then({"damaged": (1, 2, 3, 4)}, {}, delay_ns), at(WX200, rate_hz=180.0))
        bench.read()
        assert asked(bench.requests[1][1])[3] == (2, 4, 1)[:count]


def test_where_no_time_is_left_nobody_is_asked_and_the_first_answer_still_counts() -> None:
    def slow(_: int, request: bytes) -> Arrivals:
        data = reply(request)
        return [(2_900 * US, data[:60]), (4_450 * US, data[60:])]

    bench = Bench(slow)
    assert bench.read().rows == ROWS
    assert len(bench.requests) == 1
    assert bench.counters == DxlCounters()
    assert bench.line.ns - bench.begin_ns == 4_450 * US


def test_where_nobody_is_asked_again_the_rest_may_come_in_parts() -> None:
    def in_parts(_: int, request: bytes) -> Arrivals:
        data = reply(request)
        return [(2_800 * US, data[:90]), (4_100 * US, data[90:98]), (4_200 * US, data[98:])]

    bench = Bench(in_parts, at(WX200, rate_hz=205.0))
    cycle = bench.read()
    assert len(bench.requests) == 1
    assert cycle.rows == ROWS
    assert cycle.damaged is False
    assert bench.line.ns - bench.begin_ns == 4_200 * US


def test_the_second_answer_may_come_in_parts_too_and_its_last_servo_ends_it() -> None:
    def in_parts(number: int, request: bytes) -> Arrivals:
        data = reply(request, silent=(5,))
        return [] if number == 1 else [(100 * US, data[:40]), (300 * US, data[40:])]

    bench = Bench(in_parts, SLOW)
    assert bench.read().rows == [*ROWS[:4], None, *ROWS[5:]]
    assert bench.line.ns - bench.begin_ns == bench.requests[1][0] + 300 * US


def test_the_first_answer_may_come_while_the_second_is_waited_for() -> None:
    bench = Bench(lambda n, request: [(4 * MS, reply(request))] if n == 1 else [], at(WX200, rate_hz=120.0))
    cycle = bench.read()
    assert len(bench.requests) == 2
    assert cycle.rows == ROWS
    assert bench.line.ns - bench.begin_ns == 4 * MS, "nothing more is waited for"


def test_the_wait_ends_when_the_last_one_asked_again_has_answered() -> None:
    bench = Bench(then({"silent": (3,)}, {"silent": (5,)}), SLOW)
    cycle = bench.read()
    assert cycle.rows == [*ROWS[:4], None, *ROWS[5:]]
    assert bench.line.ns - bench.begin_ns == bench.requests[1][0] + 200 * US


def test_babble_ends_the_second_wait_too() -> None:
    def babble(number: int, request: bytes) -> Arrivals:
        if number == 1:
            return [(2 * MS, reply(request, damaged=(4,)))]
        return [(k * 10 * US, bytes(100)) for k in range(1, 300)]

    bench = Bench(babble, SLOW)
    assert bench.read().rows == [*ROWS[:3], None, *ROWS[4:]]
    assert bench.line.ns - bench.begin_ns < bench.requests[1][0] + 200 * US


def test_one_that_answers_neither_time_is_counted_each_cycle() -> None:
    bench = Bench(whole(silent=(6,)), SLOW)
    for count in (1, 2, 3):
        assert bench.read().rows == [*ROWS[:5], None, ROWS[6]]
        assert bench.counters.per_servo == {6: count}
        assert bench.counters.timeouts == count


# --- status packets for a while --------------------------------------------------------------------------------------


def merged_or_not(bench: Bench, cycles: int) -> list[bool]:
    found = []
    for _ in range(cycles):
        bench.read()
        found.append(asked(bench.requests[0][1])[0])
    return found


def test_after_a_merged_reply_that_was_cut_short_ten_cycles_use_status_packets() -> None:
    bench = Bench(then({"silent": (3,)}, {}), SLOW)
    bench.read()
    bench.line.answer = whole()
    assert merged_or_not(bench, 13) == [False] * 10 + [True] * 3


def test_in_those_cycles_the_patience_is_that_of_status_packets() -> None:
    bench = Bench(then({"silent": (3,)}, {}), SLOW)
    bench.read()
    bench.line.answer = silence
    bench.read()
    assert bench.requests[1][0] == pytest.approx(round(1.05 * EACH_WORST_NS) + 500 * US, abs=1)


def test_a_servo_that_stays_silent_is_gone_around_for_ten_cycles_at_a_time() -> None:
    bench = Bench(whole(silent=(3,)), SLOW)
    assert merged_or_not(bench, 23) == [True, *[False] * 10] * 2 + [True]


def test_silence_of_all_is_no_reason_for_status_packets() -> None:
    bench = Bench(silence, SLOW)
    assert merged_or_not(bench, 3) == [True] * 3


def test_where_status_packets_do_not_fit_the_cycle_they_are_not_used() -> None:
    worst_s = EACH_WORST_NS * 1e-9
    for rate_hz, fits in ((0.9 / worst_s - 0.1, True), (0.9 / worst_s + 0.1, False)):
        bench = Bench(whole(1_500 * US, silent=(3,)), at(WX200, rate_hz=rate_hz))
        assert merged_or_not(bench, 2) == [True, not fits]


# --- answers to earlier requests ------------------------------------------------------------------------------------


def once(data: bytes) -> Answer:
    """The first request of a cycle is answered with that, others with nothing."""
    return lambda number, _: [(1 * MS, data)] if number == 1 else []


def test_an_answer_to_the_last_cycle_is_late_and_never_a_row() -> None:
    bench = Bench(whole())
    bench.read()
    bench.line.answer = once(reply(bench.requests[0][1]))
    cycle = bench.read()
    assert cycle.rows == [None] * 7
    assert (cycle.late, cycle.damaged) == (True, False)
    assert bench.counters.late == 1
    assert bench.counters.per_servo == dict.fromkeys(range(1, 8), 1)


def test_a_late_answer_before_the_right_one_is_counted_and_does_no_harm() -> None:
    bench = Bench(whole())
    bench.read()
    old = reply(bench.requests[0][1])
    bench.line.answer = lambda _, request: [(1 * MS, old), (2 * MS, reply(request))]
    cycle = bench.read()
    assert cycle.rows == ROWS
    assert cycle.late is True
    assert len(bench.requests) == 1
    assert (bench.counters.late, bench.counters.timeouts) == (1, 0)
    assert cycle.heard == old + reply(bench.requests[0][1])


def test_an_adapter_that_repeats_itself_is_never_believed_when_its_mark_comes_round() -> None:
    bench = Bench(whole())
    bench.read()
    old = reply(bench.requests[0][1])
    bench.line.answer, late = once(old), []
    for k in range(1, 30):  # the mark comes round every 14 cycles
        cycle = bench.read()
        assert cycle.rows == [None] * 7, k
        assert cycle.late is True
        counted = bench.counters.late - sum(late)
        late.append(counted)
    assert (late[0], late[13], late[27]) == (1, 1, 1)
    assert min(late) == 1
    bench.line.answer = whole()
    assert bench.read().rows == ROWS
    bench.line.answer = once(old)
    assert bench.read().late is True


def test_a_reply_like_the_last_one_is_fresh_when_that_one_was() -> None:
    """A servo that stands still answers with the same bytes each time the order comes round."""
    bench = Bench(whole(), replace(WX200, joints=WX200.joints[:1] + WX200.joints[2:3]))
    heard = [bench.read() for _ in range(20)]
    assert all(not cycle.late and None not in cycle.rows for cycle in heard)
