"""Events survive their JSON, fit their row whatever they say, and foreign texts are told apart from them."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.log.standard import log_message
from agent.modes import Mode
from agent.safety import Flag
from agent.telemetry.ring.texts import TextReader, TextWriter
from agent.telemetry.row.derive import RowEvents
from agent.telemetry.row.event import TEXT_MAX_BYTES, Event, Level, health_time
from agent.telemetry.row.sample import AGENT_STATE
from agent.telemetry.row.topics import Kind

plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)


@given(st.integers(0, 2**63 - 1), st.text(), st.sampled_from(Level), st.text(), st.dictionaries(st.text(), plain))
def test_an_event_fits_its_row_and_comes_back_unless_it_was_cut(utc_ns, source, level, text, data) -> None:
    event = Event(utc_ns, source, level, text, data)
    encoded = event.to_json()
    assert len(encoded) <= TEXT_MAX_BYTES
    back = Event.from_json(encoded)
    assert (back.utc_ns, back.level) == (utc_ns, level)
    assert back == event or back.data == {"truncated": True}
    assert text.startswith(back.text)


def test_an_event_that_is_too_long_loses_its_data_first_then_its_end() -> None:
    assert Event.from_json(Event(0, "left", Level.INFO, "short", {"x": "y" * 2000}).to_json()).text == "short"
    cut = Event.from_json(Event(0, "\N{GRINNING FACE}" * 99, Level.INFO, "\N{GRINNING FACE}" * 999).to_json())
    assert cut.text == "\N{GRINNING FACE}" * (len(cut.text))
    assert cut.data == {"truncated": True}


def test_an_event_of_a_path_that_is_no_utf_8_is_one_that_a_log_takes() -> None:
    port = os.fsdecode(b"/dev/\xfe")
    event = Event.from_json(Event(1, port, Level.INFO, f"torque on: {port}", {port: 1}).to_json())
    assert (event.source, event.text) == (r"/dev/\udcfe", r"torque on: /dev/\udcfe")
    assert rb"torque on: /dev/\udcfe" in log_message(event)


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"[]",
        b"null",
        b"{}",
        b"\xff\xfe",
        b'{"utc_ns": -1, "source": "a", "level": "INFO", "text": "b"}',
        b'{"utc_ns": 1e3, "source": "a", "level": "INFO", "text": "b"}',
        b'{"utc_ns": true, "source": "a", "level": "INFO", "text": "b"}',
        b'{"utc_ns": 1, "source": 2, "level": "INFO", "text": "b"}',
        b'{"utc_ns": 1, "source": "a", "level": "LOUD", "text": "b"}',
        b'{"utc_ns": 1, "source": "a", "level": "INFO", "text": "b", "data": []}',
        b"[" * 900,
        b'"' + b"x" * 2000 + b'"',
    ],
)
def test_what_is_no_event_is_refused(payload: bytes) -> None:
    with pytest.raises(ValueError, match=r"."):
        Event.from_json(payload)
    with pytest.raises(ValueError, match=r"."):
        health_time(payload if b"utc_ns" not in payload or b"-1" in payload else b"{}")


def test_texts_go_through_their_ring_and_not_a_number_becomes_null(tmp_path: Path) -> None:
    ring = tmp_path / "left.ring"
    writer = TextWriter(ring, "left")
    reader = TextReader(ring)
    event = Event(7, "left", Level.ERROR, "servo 3 silent", {"id": 3})
    writer.event(event)
    writer.health(8, {"temperature_C": [31.5, float("nan")]})
    writer.health(9, {"too": "x" * 5000})
    (first, a), (second, b), (_, c) = reader.read_new()
    assert (first, Event.from_json(a)) == (Kind.EVENT, event)
    assert (second, json.loads(b)) == (Kind.HEALTH, {"utc_ns": 8, "temperature_C": [31.5, None]})
    assert health_time(b) == 8
    assert json.loads(c)["truncated_bytes"] > 5000
    assert reader.read_new() == []
    writer.finish()
    reader.close()
    writer.close()


def rows(modes: list[Mode], flags: list[Flag] | None = None, period_ns: int = 5_000_000) -> np.ndarray:
    out = np.zeros(len(modes), AGENT_STATE.dtype)
    out["mode"] = modes
    out["flags"] = flags or 0
    out["sequence"] = np.arange(len(modes))
    out["utc_ns"] = out["sequence"] * period_ns
    return out


@pytest.mark.parametrize("cut", range(6))
def test_mode_changes_are_told_once_wherever_the_batches_are_cut(cut: int) -> None:
    data = rows([Mode.READY, Mode.READY, Mode.TRACK, Mode.TRACK, Mode.HOLD, Mode.FAULT])
    watcher = RowEvents("left")
    events = watcher.watch(data[:cut]) + watcher.watch(data[cut:])
    assert [(e.text, e.level) for e in events] == [
        ("mode READY → TRACK", Level.INFO),
        ("mode TRACK → HOLD", Level.WARN),
        ("mode HOLD → FAULT", Level.ERROR),
    ]
    assert [e.data["sequence"] for e in events] == [2, 4, 5]


def test_a_fluttering_flag_is_told_of_once_a_second() -> None:
    count = 600
    flutter = [Flag.RATE_LIMITED if i % 2 else Flag.NONE for i in range(count)]
    events = RowEvents("left").watch(rows([Mode.TRACK] * count, flutter))
    assert [e.data["t"] for e in events] == [0.0] * 3
    assert [e.data["sequence"] for e in events] == [1, 201, 401]


def test_flags_that_come_together_are_told_each() -> None:
    both = Flag.NOT_FINITE | Flag.SATURATED
    events = RowEvents("left").watch(rows([Mode.TRACK] * 3, [Flag.NONE, both, both]))
    assert {(e.text, e.level) for e in events} == {
        ("safety: not finite", Level.ERROR),
        ("safety: saturated", Level.WARN),
    }


def test_a_mode_nobody_knows_does_not_stop_the_telemetry() -> None:
    (event,) = RowEvents("left").watch(rows([Mode.TRACK, 77]))
    assert event.text == "mode TRACK → 77"
