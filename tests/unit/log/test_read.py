"""Reading a log gives back exactly what was recorded, and says what is missing or wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from agent.log.read import LogError, open_log, read_log
from agent.log.writer import CHUNK_BYTES
from agent.telemetry.row.event import Event, Level
from agent.telemetry.row.sample import AGENT_STATE
from tests.support.telemetry.log_maker import RUN_JSON, LogMaker, make_log
from tests.support.telemetry.telemetry_cell import make_rows


def test_rows_events_attachments_and_metadata_come_back(tmp_path: Path) -> None:
    event = Event(5, "left", Level.WARN, "mode TRACK → HOLD", {"limit": 1.5})
    later = Event(9, "left", Level.INFO, "later")
    rows = make_log(tmp_path / "run.mcap", events=[later, event])
    log = read_log(tmp_path / "run.mcap")
    assert set(log.agents) == {"left", "right"}
    for member, sent in rows.items():
        got = log.plant if member == "plant" else log.agents[member]
        assert got.tobytes() == sent.tobytes()
        assert not got.flags.writeable
    assert log.events == [event, later]
    assert log.attachments["run.json"] == RUN_JSON
    assert log.run_info() == {"cell": "paper", "rate_hz": 200.0}
    assert log.metadata["recorder"] == {"host": "bench"}
    assert (log.cell, log.complete, log.problems) == ("paper", True, ())
    assert log.gaps == {"left": (), "right": (), "plant": ()}


def test_rows_are_sorted_and_each_is_there_once_whatever_the_order_they_came_in(tmp_path: Path) -> None:
    rows = make_rows("left", 60)
    maker = LogMaker(tmp_path / "run.mcap")
    for part in (rows[40:], rows[:20], rows[10:50]):
        maker.write("left", part)
    maker.finish()
    assert read_log(tmp_path / "run.mcap").agents["left"].tobytes() == rows.tobytes()


def test_what_is_in_a_log_twice_counts_once_and_is_told(tmp_path: Path) -> None:
    maker = LogMaker(tmp_path / "run.mcap", has_plant=False)
    rows, event = make_rows("left", 60), Event(5, "left", Level.WARN, "mode TRACK → HOLD", {"limit": 1.5})
    for _ in range(2):
        maker.write("left", rows)
        maker.event(event)
    maker.event(replace(event, utc_ns=6))
    maker.finish()
    log = read_log(tmp_path / "run.mcap")
    assert log.agents["left"].tobytes() == rows.tobytes()
    assert log.events == [event, replace(event, utc_ns=6)]
    told = "are in the log more than once, and count once"
    assert log.problems == (f"60 of the rows of left {told}", f"1 of the events {told}")
    assert not log.complete


def test_what_an_agent_tells_before_its_first_row_comes_before_what_the_row_tells(tmp_path: Path) -> None:
    maker = LogMaker(tmp_path / "run.mcap")
    first = Event(5, "left", Level.WARN, "safety: off track", {"sequence": 0})
    told, later = Event(5, "left", Level.INFO, "torque on"), Event(9, "left", Level.WARN, "mode", {"sequence": 8})
    ended = Event(9, "left", Level.INFO, "run ended in HOLD")
    maker.write("left", make_rows("left", 10))
    for event in (first, told, later, ended):
        maker.event(event)
    maker.finish()
    assert read_log(tmp_path / "run.mcap").events == [told, first, later, ended]


def test_rows_by_column_are_the_rows_whatever_the_order_they_came_in(tmp_path: Path) -> None:
    rows = make_rows("left", 60)
    maker = LogMaker(tmp_path / "run.mcap")
    for part in (rows[40:], rows[:20], rows[10:50]):
        maker.write("left", part)
    maker.finish()
    with open_log(tmp_path / "run.mcap") as log:
        for f in AGENT_STATE.fields:
            assert np.array_equal(log.agents["left"][f.name], rows[f.name]), f.name
        assert np.array_equal(log.agents["left"][10:20]["q"], rows["q"][10:20])


def test_a_log_by_column_says_the_same_as_one_in_memory(tmp_path: Path) -> None:
    rows = make_rows("left", 60)
    maker = LogMaker(tmp_path / "run.mcap")
    maker.write("left", rows[np.r_[0:10, 11:60]])
    maker.write("plant", make_rows("plant", 5))
    maker.event(Event(5, "left", Level.WARN, "mode TRACK → HOLD", {"limit": 1.5}))
    maker.finish()
    whole = read_log(tmp_path / "run.mcap")
    with open_log(tmp_path / "run.mcap", folder=tmp_path) as log:
        told = ("path", "cell", "events", "attachments", "metadata", "complete", "gaps", "problems")
        assert [getattr(log, name) for name in told] == [getattr(whole, name) for name in told]
        assert log.run_info() == whole.run_info()
        assert list(log.agents) == list(whole.agents)
        assert len(log.plant) == len(whole.plant) == 5
        assert len(log.agents["right"]) == 0


def test_a_record_larger_than_any_of_ours_is_left_out_and_what_follows_is_read(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    rows = make_log(path, finish=False)
    data = path.read_bytes()
    huge = (1 << 28) + 1
    with path.open("wb") as file:
        file.write(data[:8] + b"\x80" + huge.to_bytes(8, "little"))
        file.truncate(17 + huge)  # a hole: takes no room
        file.seek(17 + huge)
        file.write(data[8:])
    log = read_log(path)
    assert log.agents["left"].tobytes() == rows["left"].tobytes()
    assert log.problems[0] == f"damaged at byte 8: a record of {huge} bytes"


def test_gaps_are_named_by_their_sequence_numbers(tmp_path: Path) -> None:
    rows = make_rows("left", 60)
    maker = LogMaker(tmp_path / "run.mcap")
    maker.write("left", rows[np.r_[0:10, 11:20, 35:60]])
    maker.finish(complete=False)
    log = read_log(tmp_path / "run.mcap")
    assert log.gaps["left"] == ((10, 10), (20, 34))
    assert not log.complete


def test_an_unfinished_log_is_read_up_to_its_end_and_is_not_complete(tmp_path: Path) -> None:
    rows = make_log(tmp_path / "run.mcap", finish=False)
    log = read_log(tmp_path / "run.mcap")
    assert log.agents["right"].tobytes() == rows["right"].tobytes()
    assert not log.complete
    assert "ends without its index" in log.problems[0]


def test_a_log_larger_than_a_chunk_is_read_whole(tmp_path: Path) -> None:
    count = 3 * CHUNK_BYTES // AGENT_STATE.dtype.itemsize
    rows = make_log(tmp_path / "run.mcap", count, batches=7)
    assert read_log(tmp_path / "run.mcap").agents["left"].tobytes() == rows["left"].tobytes()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot read"),
        (b"", "is no MCAP file"),
        (b"\x89PNG not a log", "is no MCAP file"),
        (b"\x89MCAP0\r\n", "holds no rows"),
        (b"\x89MCAP0\r\n" + b"\xff" * 300, "holds no rows"),
    ],
)
def test_what_is_no_log_is_refused(tmp_path: Path, content: bytes | None, message: str) -> None:
    path = tmp_path / "run.mcap"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(LogError, match=message) as refusal:
        read_log(path)
    assert refusal.value.remedy


def foreign_log(path: Path, topic: str, schema: str, definition: str) -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel(topic, "cdr", writer.register_schema(schema, "ros2msg", definition.encode()))
        writer.add_message(channel, 0, b"\0\1\0\0" + bytes(100), 0)
        writer.finish()


def test_a_log_of_another_release_is_refused_not_misread(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    foreign_log(path, "/coop/paper/left/state", "coop_msgs/msg/AgentState", AGENT_STATE.definition.replace("q", "Q"))
    with pytest.raises(LogError, match="has another layout"):
        read_log(path)


def test_a_field_in_other_words_is_the_same_field_and_one_in_other_units_is_not(tmp_path: Path) -> None:
    path, own = tmp_path / "run.mcap", AGENT_STATE.definition
    foreign_log(path, "/coop/paper/left/state", "coop_msgs/msg/AgentState", own.replace("friction feed-forward", "-"))
    assert read_log(path).problems == ("left: a row of 104 bytes left out",), "a row is looked at"
    foreign_log(path, "/coop/paper/left/state", "coop_msgs/msg/AgentState", own.replace("[J]", "[mJ]"))
    with pytest.raises(LogError, match="found coop_msgs/msg/AgentState in other units"):
        read_log(path)


def test_a_log_of_somebody_else_holds_no_rows(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    foreign_log(path, "/camera", "sensor_msgs/msg/Image", "uint8[] data\n")
    with pytest.raises(LogError, match="holds no rows"):
        read_log(path)


def test_a_row_of_a_wrong_length_is_left_out_and_told_of(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    foreign_log(path, "/coop/paper/left/state", "coop_msgs/msg/AgentState", AGENT_STATE.definition)
    log = read_log(path)
    assert len(log.agents["left"]) == 0
    assert log.problems == ("left: a row of 104 bytes left out",)
    assert not log.complete


def test_a_log_without_a_description_says_so(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    foreign_log(path, "/coop/paper/left/state", "coop_msgs/msg/AgentState", AGENT_STATE.definition)
    with pytest.raises(LogError, match="does not say which run it is"):
        read_log(path).run_info()
