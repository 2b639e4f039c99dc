"""The read of one cycle on a line that the test scripts to the nanosecond: what it asks, and how long it waits."""

from __future__ import annotations

from itertools import permutations

import pytest

from drivers.dynamixel.budget import LinkTiming
from drivers.dynamixel.cycle import MARKS, PLAIN_BYTES_MAX, marked_groups
from drivers.dynamixel.line.bus import DxlCounters
from tests.support.servos.dxl_rig import WX200, at
from tests.support.servos.scripted_line import (
    EACH_WORST_NS,
    FAST_WORST_NS,
    MS,
    ROWS,
    SLOW,
    US,
    Answer,
    Arrivals,
    Bench,
    asked,
    reply,
    retry_ns,
    row,
    silence,
    whole,
)

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


@pytest.mark.parametrize("fast", [True, False])
def test_the_longest_answer_is_that_of_each_servo_with_the_longest_mark(fast: bool) -> None:
    assert Bench(whole(), fast=fast).reader.answer_bytes == 7 * (PLAIN_BYTES_MAX + 11)


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


@pytest.mark.parametrize("count", range(2, 10))
def test_the_answer_to_no_other_request_has_as_many_blocks_in_the_order_asked_for_as_are_proof(count: int) -> None:
    """However many of its other blocks are damaged, and so contradict nothing."""
    groups = marked_groups(tuple(range(1, count + 1)), fast=True)
    for asked_for, answered in permutations(groups, 2):
        if asked_for.data_length == answered.data_length:  # else its head is another
            agree = sum(a == b for a, b in zip(asked_for.ids, answered.ids, strict=True))
            assert agree < asked_for._proof
    agree = 2 if count % 2 == 0 else 1
    assert {group._proof for group in groups} == {1 + agree if count > 4 else 1}, "and no more, for few may answer"


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
