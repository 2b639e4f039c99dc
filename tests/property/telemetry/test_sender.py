"""Over any network that loses messages and answers, the recorder ends with everything the source still held."""

from __future__ import annotations

import random
from collections import Counter, deque
from itertools import pairwise

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from agent.telemetry.link.coverage import Coverage, count_of
from agent.telemetry.link.sender import (
    LOCKSTEP_PAUSE_S,
    PRESSING_PAUSE_S,
    LockstepPauses,
    Sender,
)
from agent.telemetry.link.source import TextSource
from agent.telemetry.link.wire import RANGES_MAX, BatchHeader, End, StreamStatus
from agent.telemetry.ring.reader import RowBlock


class Numbers:
    """A source of numbers that keeps the last `keep`."""

    source_id, batch_max = 42, 4

    def __init__(self, keep: int) -> None:
        self.written, self.end, self._keep = 0, End.OPEN, keep

    @property
    def oldest(self) -> int:
        return max(0, self.written - self._keep)

    def read(self, first: int, count: int) -> RowBlock:
        begin = max(first, self.oldest)
        count = min(count, self.written - begin)
        return RowBlock(begin, count, bytes(n % 251 for n in range(begin, begin + count)))


class Recorder:
    def __init__(self) -> None:
        self.have, self.ended, self.payload = Coverage(), False, dict[int, int]()

    def receive(self, header: BatchHeader, payload: bytes) -> None:
        assert header.source == 42
        if payload:
            self.have.add(header.first, header.first + len(payload) - 1)
        self.payload |= {header.first + i: byte for i, byte in enumerate(payload)}
        self.ended |= header.end is End.FINISHED

    def status(self) -> StreamStatus:
        return StreamStatus(42, tuple(self.have.ranges[-RANGES_MAX:]), self.ended)


def cycle(sender: Sender, recorder: Recorder, now_s: float, lost: random.Random, loss: float) -> None:
    for header, payload in sender.new(3, now_s):
        if lost.random() >= loss:
            recorder.receive(header, payload)
    if lost.random() >= loss:
        sender.on_status(recorder.status() if recorder.have.count or recorder.ended else None, now_s)
        for header, payload in sender.again(3, now_s):
            if lost.random() >= loss:
                recorder.receive(header, payload)


@given(st.integers(0, 60), st.integers(0, 2**32), st.sampled_from([0.0, 0.3, 0.7]), st.sampled_from([None, 5]))
def test_everything_arrives_over_a_network_that_loses(total: int, seed: int, loss: float, window: int | None) -> None:
    source, recorder, chance = Numbers(1000), Recorder(), random.Random(seed)
    sender = Sender(source, window=window)
    now_s = 0.0
    for _ in range(2000):
        if source.written < total:
            source.written += 1
        elif source.end is End.OPEN:
            source.end = End.FINISHED
        cycle(sender, recorder, now_s, chance, loss)
        if window is not None:
            assert sender.published - recorder.have.end <= window + recorder.have.count
            assert sender.published <= sender.acknowledged + window
        assert sender.acknowledged <= next((a for a, _ in recorder.have.missing(0, 10**6)), 0)
        if sender.complete:
            break
        now_s += 0.5
    assert sender.complete
    assert recorder.payload == {n: n % 251 for n in range(total)}
    assert recorder.ended
    assert (sender.lost, sender.unrecorded()) == (0, 0)


@example(steps=[12] * 30, keep=3, seed=1)  # more gaps beyond repair than a status has room for
@given(st.lists(st.integers(0, 12), min_size=1, max_size=30), st.integers(3, 8), st.integers(0, 2**32))
def test_what_the_source_lost_is_counted_and_does_not_keep_the_end_away(steps: list[int], keep: int, seed: int) -> None:
    source, recorder, chance = Numbers(keep), Recorder(), random.Random(seed)
    sender = Sender(source, window=None)
    now_s = 0.0
    for step in steps:
        source.written += step
        cycle(sender, recorder, now_s, chance, 0.3)
        now_s += 0.5
    source.end = End.DIED
    recorder.ended = True
    for _ in range(200):
        cycle(sender, recorder, now_s, chance, 0.0)
        now_s += 0.5
    assert sender.complete
    assert sender.published == source.written
    assert sender.lost <= source.written - recorder.have.count
    assert sender.lost + sender.unrecorded() == source.written - recorder.have.count, "each missing row is in one count"
    assert recorder.have.missing(source.oldest, source.written - 1) == []


def test_what_was_published_dropped_and_overwritten_is_not_called_recorded() -> None:
    source, recorder = Numbers(4), Recorder()
    sender = Sender(source, window=None)
    for _ in range(5):
        source.written += 4
        batches = list(sender.new(3, 0.0))
        if source.written != 8:  # the second batch is lost on the way, and the source keeps four
            for batch in batches:
                recorder.receive(*batch)
        sender.on_status(recorder.status(), 0.0)
    assert (sender.published, sender.lost, sender.unrecorded()) == (20, 0, 4)
    for now_s in (2.0, 4.0, 8.0):
        assert list(sender.again(3, now_s)) == []
        sender.on_status(recorder.status(), now_s)
    assert (sender.lost, sender.unrecorded()) == (0, 4)


def test_ranges_that_no_answer_has_room_for_any_more_stay_recorded_and_another_recorders_are_its_own() -> None:
    source = Numbers(1000)
    sender = Sender(source, window=None)
    source.written = 100
    for _ in range(9):
        list(sender.new(3, 0.0))
    sender.on_status(StreamStatus(42, ((0, 9), (20, 29)), False), 0.0)
    sender.on_status(StreamStatus(42, ((20, 39), (50, 99)), False), 0.0)
    assert sender.unrecorded() == 20
    sender.on_status(StreamStatus(42, ((0, 4),), False), 0.0)
    assert sender.unrecorded() == 95
    sender.on_status(None, 0.0)
    assert sender.unrecorded() == 100


def test_nothing_is_sent_twice_while_the_answers_keep_up() -> None:
    source, recorder = Numbers(1000), Recorder()
    sender, sent = Sender(source, window=None), 0
    for i in range(100):
        source.written += 2
        for header, payload in [*sender.new(3, i * 0.1), *sender.again(3, i * 0.1)]:
            recorder.receive(header, payload)
            sent += len(payload)
        sender.on_status(recorder.status(), i * 0.1)
        sent += sum(len(p) for _, p in sender.again(3, i * 0.1))
    assert sent == 200


@pytest.mark.parametrize("every", [1, 4, 16, 50])  # tenths of a second between two messages
def test_a_seldom_message_has_its_time_like_one_of_many_before_it_is_sent_again(every: int) -> None:
    source, recorder = Numbers(1000), Recorder()
    sender, sent, answer = Sender(source, window=None), 0, recorder.status()
    for tenth in range(1000):
        if tenth % every == 0:
            source.written += 1
        if tenth % 4 == 0:  # an answer in 0.4 s, of what was there when it left
            sender.on_status(answer, tenth / 10)
            answer = recorder.status()
        for header, payload in [*sender.new(3, tenth / 10), *sender.again(3, tenth / 10)]:
            recorder.receive(header, payload)
            sent += len(payload)
    assert sent == source.written


def test_a_seldom_message_that_got_lost_is_sent_again_as_soon_as_one_of_many() -> None:
    source, recorder = Numbers(1000), Recorder()
    sender, again = Sender(source, window=None), list[float]()
    for tenth in range(400):
        if tenth in (0, 300):
            source.written += 1
        for header, payload in sender.new(3, tenth / 10):
            if tenth < 300:
                recorder.receive(header, payload)
        sender.on_status(recorder.status(), tenth / 10)
        again += [tenth / 10 for _ in sender.again(3, tenth / 10)]
    assert 30.0 + 0.8 <= again[0] <= 30.0 + 1.2


def test_patience_grows_while_nothing_helps_so_a_deaf_recorder_is_not_flooded() -> None:
    source = Numbers(1000)
    source.written = 4
    sender = Sender(source, window=None)
    assert len(list(sender.new(3, 0.0))) == 1
    again = []
    for tenth in range(1000):
        sender.on_status(None, tenth / 10)
        again += [tenth / 10 for _ in sender.again(3, tenth / 10)]
    assert 10 <= len(again) <= 20
    assert again[0] <= 1.5
    assert max(b - a for a, b in pairwise(again)) <= 8.2


def test_a_recorder_that_comes_late_gets_a_long_history_in_seconds_not_minutes() -> None:
    source, recorder = Numbers(100_000), Recorder()
    sender, now_s = Sender(source, window=None), 0.0
    source.written = 3000
    published = len(list(sender.new(3000, now_s)))
    source.end = End.FINISHED
    resent = 0
    for tick in range(2000):  # 5 ms each; an answer every 0.25 s
        now_s = 0.005 * tick
        if tick % 50 == 0:
            sender.on_status(recorder.status(), now_s)
        for header, payload in [*sender.new(3, now_s), *sender.again(2, now_s)]:
            recorder.receive(header, payload)
            resent += 1
        if sender.complete:
            break
    assert sender.complete
    assert recorder.payload == {n: n % 251 for n in range(3000)}
    assert now_s < 6.0
    assert resent <= published + 10, "each batch once, and the end"


def recorded_live(delay_s: float, missed: int, keep: int) -> tuple[Recorder, dict[int, int]]:
    """A recorder that came when `missed` were gone by, over a network that takes so long; how often each was sent."""
    source, recorder, sent = Numbers(keep), Recorder(), Counter[int]()
    sender, on_its_way = Sender(source, window=None), deque[tuple[float, BatchHeader, bytes]]()
    source.written, answered = missed, False
    list(sender.new(missed, 0.0))
    for tick in range(1, 3000):  # 20 ms each, 4 new ones in each; an answer every 0.24 s, to what had come by then
        now_s = 0.02 * tick
        source.written += 4
        while on_its_way and on_its_way[0][0] <= now_s:
            recorder.receive(*on_its_way.popleft()[1:])
        if tick % 12 == 0 and recorder.have.count:
            answered = True
            sender.on_status(recorder.status(), now_s)
        batches = list(sender.new(32, now_s)) + (list(sender.again(2, now_s)) if answered else [])
        sent.update(header.first + i for header, payload in batches for i in range(len(payload)))
        on_its_way.extend((now_s + delay_s, *batch) for batch in batches)
    return recorder, sent


def test_what_was_missed_is_sent_again_while_new_ones_flow_before_the_source_has_to_drop_it() -> None:
    recorder, sent = recorded_live(0.0, 1000, keep=3000)
    assert recorder.have.ranges[0][0] == 0
    assert len(recorder.have.ranges) == 1
    assert max(sent.values()) == 1, "nothing twice"


@pytest.mark.parametrize(("delay_s", "missed", "still"), [(0.5, 8, 0), (0.5, 1000, 0), (3.0, 1000, 1000)])
def test_a_slow_network_gets_no_new_message_twice_and_is_not_flooded(delay_s: float, missed: int, still: int) -> None:
    recorder, sent = recorded_live(delay_s, missed, keep=10_000)
    assert count_of(recorder.have.missing(0, 11_000)) <= still
    assert max(sent[n] for n in range(missed, 13_000)) == 1
    assert sum(sent[n] for n in range(missed)) <= missed


def test_the_newest_are_sent_again_when_none_arrives_any_more() -> None:
    source, recorder = Numbers(1000), Recorder()
    sender = Sender(source, window=None)
    source.written = 8
    first, second = sender.new(2, 0.0)
    recorder.receive(*first)
    sender.on_status(recorder.status(), 0.25)
    assert list(sender.again(2, 1.0)) == []
    assert list(sender.again(2, 1.25)) == [second]


def test_an_answer_about_another_run_is_no_answer() -> None:
    source = Numbers(1000)
    source.written = 4
    sender = Sender(source, window=None)
    list(sender.new(3, 0.0))
    sender.on_status(StreamStatus(43, ((0, 3),), True), 0.0)
    assert sender.acknowledged == 0
    sender.on_status(StreamStatus(42, ((0, 3),), False), 0.0)
    assert sender.acknowledged == 4


def test_texts_are_kept_in_a_bounded_number() -> None:
    texts = TextSource(5)
    for i in range(10_005):
        texts.append(str(i).encode())
    assert (texts.written, texts.oldest) == (10_005, 5)
    assert texts.read(4, 1) == RowBlock(5, 0, b"")
    assert texts.read(10_004, 1) == RowBlock(10_004, 1, b"10004")


def publish_all(sender: Sender) -> int:
    return sum(bool(payload) for _, payload in sender.new(64, 0.0))


def test_telemetry_in_lockstep_looks_seldom_while_nobody_waits_for_it() -> None:
    source, pauses = Numbers(1000), LockstepPauses(64)
    sender = Sender(source, window=100)
    for _ in range(5):
        source.written += 10
        assert pauses.after(publish_all(sender), sender) == LOCKSTEP_PAUSE_S
    assert pauses.after(64, sender) == 0.0
    assert not sender.blocked


def test_telemetry_in_lockstep_looks_soon_while_its_window_is_full_and_ever_less_often_without_an_answer() -> None:
    source, pauses = Numbers(1000), LockstepPauses(64)
    sender = Sender(source, window=20)
    source.written = 50
    assert pauses.after(publish_all(sender), sender) == PRESSING_PAUSE_S
    assert sender.blocked
    waited = [pauses.after(publish_all(sender), sender) for _ in range(8)]
    assert waited == sorted(waited)
    assert waited[-1] == LOCKSTEP_PAUSE_S
    sender.on_status(StreamStatus(42, ((0, 9),), False), 0.0)
    assert not sender.blocked
    assert publish_all(sender) == 3  # ten more
    assert pauses.after(3, sender) == PRESSING_PAUSE_S


def test_telemetry_in_lockstep_looks_soon_for_the_last_answer() -> None:
    source, pauses = Numbers(1000), LockstepPauses(64)
    sender = Sender(source, window=100)
    source.written, source.end = 10, End.FINISHED
    assert pauses.after(publish_all(sender), sender) == PRESSING_PAUSE_S
    assert not sender.blocked
    assert not sender.complete


def test_without_a_window_nothing_is_held_back() -> None:
    source = Numbers(1000)
    sender = Sender(source, window=None)
    source.written = 500
    publish_all(sender)
    assert not sender.blocked
