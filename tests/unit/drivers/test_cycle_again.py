"""The read of one cycle when an answer is missing, damaged or of an earlier request: who is asked again, and how."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivers.dynamixel.line.bus import DxlCounters
from tests.support.servos.dxl_rig import WX200, at
from tests.support.servos.scripted_line import (
    EACH_WORST_NS,
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
    silence,
    then,
    whole,
)

# --- asking again ----------------------------------------------------------------------------------------------------


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
