"""The recorder's door lets in what belongs to the run, once, and counts everything else."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.log.read import read_log
from agent.telemetry.link.intake import TOLD_MAX, Intake, Rejection
from agent.telemetry.link.source import HEALTH_KEPT, TEXTS_KEPT
from agent.telemetry.link.stream import SILENT_S
from agent.telemetry.link.wire import (
    BatchHeader,
    End,
    RecorderStatus,
    Sent,
    StreamStatus,
    pack_status,
    seal_of,
    unpack_status,
)
from agent.telemetry.ring.texts import TEXT_SLOTS
from agent.telemetry.row.event import UTC_END_NS, Event, Level, encode
from agent.telemetry.row.received import Rows, Text
from agent.telemetry.row.topics import PLANT, Address, Kind
from tests.support.telemetry.log_maker import LogMaker
from tests.support.telemetry.telemetry_cell import CELL, CONFIG_ID, SERVOS, layout_of, make_rows

KEY = Address(CELL, "left", Kind.STATE).key
RING = 77


FILES = "c0ffee" * 10


def intake() -> Intake:
    return Intake(CELL, {"left": 3, "right": 3}, has_plant=True, config_id=CONFIG_ID, fingerprint=FILES)


def sent(member: str = "left", run: int = RING, *, cell: str = CELL, files: str = FILES) -> Sent:
    return Sent(seal_of(cell, files, member, layout_of(member)), run)


def header(
    first: int, written: int, *, end: End = End.OPEN, source: int = RING, missed: int = 0, by: Sent | None = None
) -> bytes:
    return BatchHeader(source, first, written, missed, end).pack(sent() if by is None else by)


def sequences(taken: list) -> list[int]:
    return [s for item in taken for s in item.rows["sequence"].tolist()]


def test_rows_go_in_as_they_came_and_once() -> None:
    door, rows = intake(), make_rows("left", 30)
    (first,) = door.take(KEY, rows[:10].tobytes(), header(0, 30))
    assert isinstance(first, Rows)
    assert first.rows.tobytes() == rows[:10].tobytes()
    assert door.take(KEY, rows[:10].tobytes(), header(0, 30)) == []
    assert sequences(door.take(KEY, rows[5:15].tobytes(), header(5, 30))) == list(range(10, 15))
    assert sequences(door.take(KEY, rows[20:30].tobytes(), header(20, 30))) == list(range(20, 30))
    assert sequences(door.take(KEY, rows[12:25].tobytes(), header(12, 30))) == list(range(15, 20))
    assert door.streams[KEY].duplicates == 10 + 5 + 8
    assert not door.rejected


def damaged(field: str, value: int) -> bytes:
    rows = make_rows("left", 4)
    rows[field][2] = value
    return rows.tobytes()


def told_at(utc_ns: int) -> bytes:
    return Event(utc_ns, "left", Level.INFO, "HOLD").to_json()


GOOD = make_rows("left", 4).tobytes()


@pytest.mark.parametrize(
    ("key", "payload", "attachment", "why"),
    [
        ("coop/paper/third/state", GOOD, header(0, 4), Rejection.UNKNOWN_KEY),
        ("coop/paper/left/torque", GOOD, header(0, 4), Rejection.UNKNOWN_KEY),
        (KEY, GOOD, b"", Rejection.NO_HEADER),
        (KEY, GOOD, header(0, 4)[:-1], Rejection.NO_HEADER),
        (KEY, GOOD, b"XXXX" + header(0, 4)[4:], Rejection.NO_HEADER),
        (KEY, GOOD, header(9, 4), Rejection.NO_HEADER),
        (KEY, GOOD, header(0, 4, source=0), Rejection.NO_HEADER),
        (KEY, GOOD, BatchHeader(RING, 0, 4, 0).pack(), Rejection.WRONG_SEAL),
        (KEY, GOOD, header(0, 4, by=sent("right")), Rejection.WRONG_SEAL),
        (KEY, GOOD, header(0, 4, by=sent(cell="other")), Rejection.WRONG_SEAL),
        (KEY, GOOD, header(0, 4, by=sent(files="f00d")), Rejection.WRONG_SEAL),
        (KEY, GOOD, header(0, 4, by=Sent(seal_of(CELL, FILES, "left", layout_of(PLANT)))), Rejection.WRONG_SEAL),
        (KEY, b"", BatchHeader(RING, 0, 0, 0, End.FINISHED).pack(), Rejection.WRONG_SEAL),
        (KEY, GOOD[:-1], header(0, 4), Rejection.WRONG_LENGTH),
        (KEY, b"", header(0, 4), Rejection.WRONG_LENGTH),
        (KEY, damaged("encapsulation", 1), header(0, 4), Rejection.WRONG_ENCAPSULATION),
        (KEY, damaged("sigma_min", 1), BatchHeader(RING, 0, 4, 0).pack(sent(), GOOD), Rejection.DAMAGED),
        (KEY, damaged("config_id", 1), header(0, 4), Rejection.WRONG_CONFIG),
        (KEY, damaged("joint_count", 7), header(0, 4), Rejection.WRONG_JOINTS),
        (KEY, damaged("utc_ns", -1), header(0, 4), Rejection.IMPOSSIBLE_TIME),
        (KEY, damaged("utc_ns", UTC_END_NS), header(0, 4), Rejection.IMPOSSIBLE_TIME),
        (KEY, damaged("sequence", 1), header(0, 4), Rejection.WRONG_ORDER),
        (KEY, GOOD, header(0, 3), Rejection.WRONG_ORDER),
        (KEY, make_rows(PLANT, 45).tobytes(), header(0, 45), Rejection.WRONG_LENGTH),
        ("coop/paper/left/event", b"{}", header(0, 1), Rejection.NOT_A_TEXT),
        ("coop/paper/left/health", b"[1]", header(0, 1), Rejection.NOT_A_TEXT),
        ("coop/paper/left/event", b"", header(0, 1), Rejection.WRONG_LENGTH),
        ("coop/paper/left/event", told_at(-1), header(0, 1), Rejection.IMPOSSIBLE_TIME),
        ("coop/paper/left/event", told_at(UTC_END_NS), header(0, 1), Rejection.IMPOSSIBLE_TIME),
        ("coop/paper/left/health", b'{"utc_ns": -1}', header(0, 1), Rejection.IMPOSSIBLE_TIME),
        ("coop/paper/left/health", b'{"utc_ns": %d}' % UTC_END_NS, header(0, 1), Rejection.IMPOSSIBLE_TIME),
    ],
)
def test_what_does_not_belong_is_counted_and_left_out(
    key: str, payload: bytes, attachment: bytes, why: Rejection
) -> None:
    door = intake()
    assert door.take(key, payload, attachment) == []
    assert dict(door.rejected) == {why: 1}
    assert all(stream.have.count == 0 and not stream.source for stream in door.streams.values())
    assert door.completeness({})["left.refused"] == str(int(key in door.streams))


@pytest.mark.parametrize("utc_ns", [0, UTC_END_NS - 1])
def test_what_the_door_lets_in_the_log_takes_at_the_ends_of_time_too(tmp_path: Path, utc_ns: int) -> None:
    door, maker, rows = intake(), LogMaker(tmp_path / "run.mcap"), make_rows("left", 4)
    rows["utc_ns"][2] = utc_ns
    for item in door.take(KEY, rows.tobytes(), header(0, 4)):
        maker.channels.write_rows(item)
    for kind, text in ((Kind.EVENT, told_at(utc_ns)), (Kind.HEALTH, encode({"utc_ns": utc_ns, **SERVOS}))):
        for item in door.take(Address(CELL, "left", kind).key, text, header(0, 1)):
            maker.channels.write_text(item)
    assert maker.finish()
    assert not door.rejected
    log = read_log(tmp_path / "run.mcap")
    assert log.agents["left"].tobytes() == rows.tobytes()
    assert [event.utc_ns for event in log.events] == [utc_ns]


@given(st.binary(max_size=200), st.binary(max_size=60), st.sampled_from([KEY, "coop/paper/left/event", "x"]))
def test_nothing_that_comes_in_can_break_the_door(payload: bytes, attachment: bytes, key: str) -> None:
    door = intake()
    assert door.take(key, payload, attachment) == []
    door.take(key, payload, header(0, 1))
    assert door.take(KEY, GOOD, header(0, 4))


def test_rows_must_go_up_across_batches_too() -> None:
    door, rows = intake(), make_rows("left", 8)
    door.take(KEY, rows[:4].tobytes(), header(0, 8))
    assert door.take(KEY, rows[2:6].tobytes(), header(4, 8)) == []
    assert door.rejected[Rejection.WRONG_ORDER] == 1


def test_a_ring_of_the_next_run_waits_for_the_next_log_and_one_of_the_last_stays_out() -> None:
    door, rows = intake(), make_rows("left", 8)
    door.take(KEY, rows.tobytes(), header(0, 8))
    door.take(KEY, b"", header(8, 8, end=End.FINISHED))
    assert door.take(KEY, rows.tobytes(), header(0, 8, source=99)) == []
    assert door.another_run
    assert door.streams[KEY].source == RING
    assert door.take(
        Address(CELL, "right", Kind.STATE).key, make_rows("right", 4).tobytes(), header(0, 4, by=sent("right"))
    )
    assert not door.another_run, "of this message alone"
    door.begin_log()
    (item,) = door.take(KEY, rows[:5].tobytes(), header(0, 8, source=99))
    assert isinstance(item, Rows)
    assert not door.another_run
    assert door.take(KEY, rows.tobytes(), header(0, 8)) == []
    assert door.rejected[Rejection.ANOTHER_RUN] == 1
    told = door.completeness({})
    assert (told["left.rows_expected"], told["left.rows_recorded"], told["left.end"]) == ("8", "5", "open")


def test_a_new_run_of_an_arm_that_has_nothing_in_the_log_needs_no_other_log() -> None:
    door, rows = intake(), make_rows("left", 8)
    door.take(KEY, rows.tobytes(), header(0, 8))
    door.take(KEY, b"", header(8, 8, end=End.DIED))
    door.begin_log()
    assert door.take(KEY, rows.tobytes(), header(0, 8, source=99))
    assert not door.another_run


def test_logs_of_one_run_have_their_parts_of_it_and_what_comes_late_is_in_the_later_one() -> None:
    door, rows = intake(), make_rows("left", 20)
    door.take(KEY, rows[:4].tobytes(), header(0, 20, missed=1))
    door.take(KEY, rows[6:10].tobytes(), header(6, 20, missed=1))
    first = door.completeness({}, continued=True)
    door.begin_log()
    door.take(KEY, rows[4:6].tobytes(), header(4, 20, missed=1))
    door.take(KEY, rows[10:].tobytes(), header(10, 20, missed=1))
    door.take(KEY, b"", header(20, 20, end=End.FINISHED, missed=1))
    second = door.completeness({})
    assert (first["left.rows_expected"], first["left.rows_recorded"]) == ("10", "8")
    assert (first["left.end"], first["left.gaps"], first["left.lost_in_ring"]) == ("continued", "[[4, 5]]", "1")
    assert (first["left.lost_on_the_way"], first["left.awaited"]) == ("0", "1"), "it may come in the next log"
    assert (second["left.rows_before"], second["left.rows_expected"], second["left.rows_recorded"]) == (
        "10",
        "10",
        "10",
    )
    assert (first["left.late_rows"], second["left.late_rows"], second["left.late"]) == ("0", "2", "[[4, 5]]")
    assert second["left.missing_before"] == "0"
    assert (second["left.end"], second["left.gaps"], second["left.lost_in_ring"]) == ("finished", "[]", "0")


def run_of(door: Intake, member: str, source: int, *stretches: tuple[int, int]) -> None:
    """These of the 9 rows of a run, and its end; a log ends behind each stretch but the last."""
    rows, key = make_rows(member, 9), Address(CELL, member, Kind.STATE).key
    rows["sequence"] *= 4
    for i, (first, last) in enumerate(stretches):
        if i:
            door.completeness({}, continued=True)
            door.begin_log()
        door.take(key, rows[first : last + 1].tobytes(), header(first, 9, source=source, by=sent(member)))
    door.take(key, b"", header(9, 9, end=End.FINISHED, source=source, by=sent(member)))


def test_a_recording_is_whole_when_its_logs_together_have_every_row() -> None:
    door = intake()
    run_of(door, "left", 5, (5, 6), (0, 4), (7, 8))
    told = door.completeness({})
    assert (told["left.rows_before"], told["left.rows_expected"], told["left.rows_recorded"]) == ("7", "2", "2")
    assert not door.whole, "the others are absent"
    run_of(door, PLANT, 6, (0, 8))
    run_of(door, "right", 7, (5, 8), (0, 4))
    told = door.completeness({})
    assert (told["right.late_rows"], told["right.late"], told["right.rows_recorded"]) == ("5", "[[0, 16]]", "0")
    assert door.whole


@pytest.mark.parametrize("whole", [True, False])
def test_a_recording_without_a_row_of_an_earlier_run_is_not_whole(whole: bool) -> None:
    door = intake()
    for member in ("right", PLANT):
        run_of(door, member, 7, (0, 8))
    run_of(door, "left", 5, (0 if whole else 1, 3), (4, 8))
    assert door.whole is whole
    door.begin_log()
    assert door.completeness({})["left.missing_before"] == str(int(not whole))
    for source in (6, 8):
        run_of(door, "left", source, (0, 8))
        assert door.streams[KEY].source == source
        assert door.whole is whole
        door.begin_log()


def test_rows_that_come_twice_are_in_the_log_once() -> None:
    door, rows = intake(), make_rows("left", 8)
    for _ in range(3):
        door.take(KEY, rows.tobytes(), header(0, 8))
    told = door.completeness({})
    assert (told["left.rows_recorded"], told["left.duplicates"]) == ("8", "16")


@pytest.mark.parametrize("gap", [False, True])
def test_a_part_is_complete_when_all_of_its_rows_are_there(gap: bool) -> None:
    door = intake()
    for member in ("left", "right", PLANT):
        rows, key = make_rows(member, 6), Address(CELL, member, Kind.STATE).key
        door.take(key, rows[:2].tobytes(), header(0, 6, by=sent(member)))
        door.take(key, rows[3 if gap else 2 : 5].tobytes(), header(3 if gap else 2, 6, by=sent(member)))
    assert door.completeness({}, continued=True)["complete"] == str(not gap).lower()
    assert door.completeness({})["complete"] == "false"


def test_events_are_recorded_once_even_when_telemetry_starts_again() -> None:
    door, key = intake(), Address(CELL, "left", Kind.EVENT).key
    text = Event(5, "left", Level.WARN, "HOLD").to_json()
    (item,) = door.take(key, text, header(0, 1, source=5))
    assert isinstance(item, Text)
    assert item.event == Event.from_json(text)
    assert door.take(key, text, header(0, 1, source=5)) == []
    assert door.take(key, text, header(0, 1, source=6)) == []
    health = json.dumps({"utc_ns": 3}).encode()
    assert len(door.take(Address(CELL, "left", Kind.HEALTH).key, health, header(0, 1))) == 1


def test_two_telemetry_processes_of_one_run_are_both_heard_and_each_text_goes_in_once() -> None:
    """The second one would else silence the first for good, also when it has ended."""
    door, events, healths = intake(), *(Address(CELL, "left", kind).key for kind in (Kind.EVENT, Kind.HEALTH))
    door.take(KEY, GOOD, header(0, 4))
    told = [Event(n, "left", Level.INFO, "mode").to_json() for n in range(4)]
    assert door.take(events, told[0], header(0, 1, source=5))
    assert not door.take(events, told[0], header(0, 2, source=6))
    assert not door.told_twice, "the first one may have been ended"
    assert door.take(events, told[1], header(1, 2, source=6))
    assert door.take(events, told[2], header(1, 2, source=5))
    assert door.told_twice == {"left"}
    assert door.take(events, told[3], header(2, 3, source=5))
    assert door.take(events, b"", header(3, 3, end=End.FINISHED, source=5)) == []
    assert door.streams[events].status == StreamStatus(5, ((0, 2),), ended=True), "so that it ends, too"
    health = json.dumps({"utc_ns": 3}).encode()
    assert [len(door.take(healths, health, header(0, 1, source=by))) for by in (5, 6)] == [1, 0]
    assert not door.rejected
    door.begin_log()
    assert not door.told_twice, "of the log before"
    door.take(KEY, b"", header(4, 4, end=End.FINISHED))
    door.take(KEY, GOOD, header(0, 4, source=88, by=sent(run=88)))
    door.take(KEY, GOOD, header(0, 4, source=88, by=sent(run=88)))
    assert door.take(events, told[0], header(0, 1, source=7, by=sent(run=88))) == []
    late = Event(9, "left", Level.INFO, "late").to_json()
    assert door.take(events, late, header(3, 4, source=5)) == [], "of a run before"
    assert not door.told_twice


def test_completeness_says_what_is_missing_and_why() -> None:
    door = intake()
    for member in ("left", "right", PLANT):
        rows, key = make_rows(member, 20), Address(CELL, member, Kind.STATE).key
        rows["sequence"] += 100
        parts = [(0, 20)] if member != "right" else [(2, 8), (10, 20)]
        for a, b in parts:
            door.take(key, rows[a:b].tobytes(), header(a, 20, missed=2 if member == "right" else 0, by=sent(member)))
        door.take(key, b"", header(20, 20, end=End.FINISHED, missed=2 if member == "right" else 0, by=sent(member)))
    told = door.completeness({"left": 3})
    assert told["complete"] == "false"
    assert told["left.lost_on_disk"] == "3"
    assert (told["left.rows_expected"], told["left.rows_recorded"], told["left.gaps"]) == ("20", "17", "[]")
    assert json.loads(told["right.gaps"]) == [[100, 101], [108, 109]]
    assert (told["right.lost_in_ring"], told["right.lost_on_the_way"]) == ("2", "2")
    assert told["plant.end"] == "finished"


def test_an_end_without_rows_is_taken_and_makes_no_arm_complete() -> None:
    door = intake()
    for member in ("left", "right", PLANT):
        key = Address(CELL, member, Kind.STATE).key
        if member != "left":
            door.take(key, make_rows(member, 6).tobytes(), header(0, 6, by=sent(member)))
        at = 0 if member == "left" else 6
        door.take(key, b"", header(at, at, end=End.FINISHED, by=sent(member)))
    assert door.streams[KEY].status.ended, "or its telemetry would send it again for ever"
    assert door.completeness({})["complete"] == "false"
    assert not door.whole
    door.take(KEY, GOOD, header(0, 4, source=8))
    door.take(KEY, b"", header(4, 4, end=End.FINISHED, source=8))
    assert door.completeness({})["complete"] == "true"


def test_another_publisher_has_to_wait_until_the_present_one_is_silent_while_it_speaks() -> None:
    door, rows = intake(), make_rows("left", 30)
    door.take(KEY, rows[:10].tobytes(), header(0, 30), 0.0)
    other = {"key": KEY, "payload": GOOD, "attachment": header(0, 4, source=99)}
    assert door.take(**other, now_s=9.0) == []  # a recorder that stood still sees the other one first
    door.take(KEY, rows[10:20].tobytes(), header(10, 30), 9.0)
    assert door.take(**other, now_s=9.1) == []
    assert door.take(**other, now_s=9.1 + 0.99 * SILENT_S) == []
    assert (door.another_run, door.rejected[Rejection.ANOTHER_PUBLISHER]) == (False, 3)
    door.take(**other, now_s=9.1 + SILENT_S)
    assert door.another_run
    door.begin_log()
    assert sequences(door.take(**other, now_s=9.2 + SILENT_S)) == [0, 1, 2, 3]


def test_texts_of_another_run_than_the_one_being_recorded_are_left_out() -> None:
    door, key = intake(), Address(CELL, "left", Kind.EVENT).key
    door.take(KEY, GOOD, header(0, 4))
    text = Event(5, "left", Level.WARN, "HOLD").to_json()
    assert door.take(key, text, header(0, 1, source=5, by=sent(run=99))) == []
    assert dict(door.rejected) == {Rejection.ANOTHER_PUBLISHER: 1}
    assert door.take(key, text, header(0, 1, source=6))
    door.take(KEY, b"", header(4, 4, end=End.DIED))
    later = Event(6, "left", Level.INFO, "started").to_json()
    assert door.take(key, later, header(0, 1, source=7, by=sent(run=99))), "before the first row of the next run"


def test_texts_have_an_end_too_and_those_of_a_run_before_are_left_out() -> None:
    door, key = intake(), Address(CELL, "left", Kind.EVENT).key
    texts = [Event(n, "left", Level.INFO, "mode").to_json() for n in range(4)]
    assert door.take(key, texts[0], header(0, 2, source=5))
    assert door.take(key, b"", header(2, 2, end=End.FINISHED, source=5)) == []
    assert (door.streams[key].end, door.streams[key].written) == (End.FINISHED, 2)
    assert door.take(key, texts[1], header(1, 2, source=5)), "what was lost on the way comes after the end"
    assert door.take(key, texts[2], header(0, 1, source=6))
    assert door.streams[key].end is End.OPEN
    assert door.take(key, texts[3], header(0, 1, source=5)) == []
    assert door.take(key, b"", header(2, 2, end=End.DIED, source=5)) == []
    assert (door.streams[key].source, door.streams[key].end) == (6, End.OPEN)
    assert not door.rejected


def test_a_text_that_comes_twice_is_counted_as_that() -> None:
    door, key = intake(), Address(CELL, "left", Kind.EVENT).key
    text = Event(5, "left", Level.WARN, "HOLD").to_json()
    assert door.take(key, text, header(0, 3, source=5))
    assert door.take(key, text, header(0, 3, source=5)) == []
    assert door.streams[key].duplicates == 1
    assert door.take(key, text, header(1, 3, source=5)) == [], "told again under another number"
    assert door.streams[key].duplicates == 2
    assert door.streams[key].have.count == 2, "or its telemetry would send it again for ever"


def test_a_flood_of_texts_ends_with_a_count_and_the_next_log_has_room_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agent.telemetry.link.intake.TEXTS_MAX", 3)
    door, key = intake(), Address(CELL, "left", Kind.HEALTH).key
    taken = [len(door.take(key, json.dumps({"utc_ns": n}).encode(), header(n, 9))) for n in range(5)]
    assert taken == [1, 1, 1, 0, 0]
    assert dict(door.rejected) == {Rejection.TOO_MANY_TEXTS: 2}
    assert door.completeness({})["left.refused"] == "2"
    door.begin_log()
    assert not door.rejected
    assert door.take(key, b'{"utc_ns": 5}', header(5, 9))
    assert door.completeness({})["left.refused"] == "0"


def test_what_was_refused_at_the_gate_is_counted_with_the_rest() -> None:
    door = intake()
    door.take(KEY, GOOD, b"")
    door.also_refused(Counter({Rejection.NO_HEADER: 2, Rejection.UNKNOWN_KEY: 4}), Counter({KEY: 2}))
    assert dict(door.rejected) == {Rejection.NO_HEADER: 3, Rejection.UNKNOWN_KEY: 4}
    told = door.completeness({})
    assert (told["left.refused"], told["right.refused"]) == ("3", "0")
    assert told[f"rejected.{Rejection.NO_HEADER.value}"] == "3"


def test_a_row_that_the_disk_lost_makes_a_log_incomplete() -> None:
    door = intake()
    for member in ("left", "right", PLANT):
        key = Address(CELL, member, Kind.STATE).key
        door.take(key, make_rows(member, 6).tobytes(), header(0, 6, by=sent(member)))
        door.take(key, b"", header(6, 6, end=End.FINISHED, by=sent(member)))
    assert door.completeness({"left": 0})["complete"] == "true"
    assert door.completeness({"right": 1})["complete"] == "false"


@pytest.mark.parametrize("absent", ["nothing", "a row", "the end", "an arm"])
def test_complete_means_every_row_and_every_end_of_every_member(absent: str) -> None:
    door = intake()
    for member in ("left", "right", PLANT):
        rows, key = make_rows(member, 6), Address(CELL, member, Kind.STATE).key
        if member == "left" and absent == "an arm":
            continue
        door.take(
            key, rows[: 5 if member == "left" and absent == "a row" else 6].tobytes(), header(0, 6, by=sent(member))
        )
        if not (member == "left" and absent == "the end"):
            door.take(key, b"", header(6, 6, end=End.DIED, by=sent(member)))
    assert door.completeness({})["complete"] == str(absent == "nothing").lower()
    assert door.whole == (absent == "nothing")


def test_a_long_run_with_losses_keeps_its_books_bounded() -> None:
    door, rows = intake(), make_rows("left", 5000)
    for i in range(0, 5000, 2):
        door.take(KEY, rows[i : i + 1].tobytes(), header(i, 5000))
    stream = door.streams[KEY]
    assert stream.have.count == 2500
    assert stream.gaps(5000)[:2] == [(1, 1), (3, 3)]
    assert len(stream.status.have) <= 16


@pytest.mark.parametrize("kind", [Kind.EVENT, Kind.HEALTH])
def test_of_very_many_texts_the_newest_are_known_again(monkeypatch: pytest.MonkeyPatch, kind: Kind) -> None:
    """Memory of the recorder stays flat over hours of them."""
    monkeypatch.setitem(TOLD_MAX, kind, 50)
    door, key = intake(), Address(CELL, "left", kind).key
    texts = [
        Event(n, "left", Level.INFO, "mode").to_json() if kind is Kind.EVENT else encode({"utc_ns": n, **SERVOS})
        for n in range(200)
    ]
    for n, text in enumerate(texts):
        assert door.take(key, text, header(n, 200, source=5))
    assert [len(door.take(key, texts[n], header(n, 200, source=6))) for n in (199, 150, 149)] == [0, 0, 1]


def test_as_many_texts_are_known_again_as_a_telemetry_process_that_is_started_again_tells() -> None:
    assert TOLD_MAX[Kind.EVENT] == TEXTS_KEPT
    assert TOLD_MAX[Kind.HEALTH] == TEXT_SLOTS > HEALTH_KEPT


@given(
    st.dictionaries(
        st.text(max_size=10),
        st.builds(
            StreamStatus,
            st.integers(0, 2**64 - 1),
            st.lists(st.tuples(st.integers(0, 99), st.integers(0, 99)), max_size=16).map(tuple),
            st.booleans(),
        ),
    )
)
def test_a_status_comes_back_as_it_was(streams: dict[str, StreamStatus]) -> None:
    for recording, cause in ((True, ""), (False, "File too large")):
        told = unpack_status(pack_status(recording, cause, streams, b"ours"), b"ours")
        assert told == RecorderStatus(recording, cause, streams)


@pytest.mark.parametrize(
    "payload",
    [b"", b"[]", b"{}", b'{"streams": 3}', b'{"seal": "6f757273", "streams": {"a": {}}}', b"\xff",
     pack_status(True, "", {}, b"theirs")],
)  # fmt: skip
def test_what_is_no_status_is_refused(payload: bytes) -> None:
    with pytest.raises(ValueError, match=r"."):
        unpack_status(payload, b"ours")


@given(st.binary(max_size=60))
def test_a_header_is_what_it_was_or_is_refused(data: bytes) -> None:
    try:
        back = BatchHeader.unpack(data)
    except ValueError:
        return
    assert back.pack() == data
