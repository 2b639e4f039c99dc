"""The ring of an agent's events and health: what goes in comes out, and what makes no sense is left out."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from agent.telemetry.ring.file import SLOTS_OFFSET
from agent.telemetry.ring.heir import RingHeir
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.ring.texts import TEXT_FORMAT, TextReader, TextWriter, texts_path
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.event import TEXT_MAX_BYTES, Event, Level
from agent.telemetry.row.topics import Kind

LONGEST = TEXT_MAX_BYTES


@pytest.fixture
def ring(tmp_path: Path) -> Path:
    return tmp_path / "left.ring"


def event(text: str) -> Event:
    return Event(7, "left", Level.INFO, text)


def write_raw(ring: Path, rows: list[tuple[int, int, bytes]]) -> None:
    """Rows of (kind, length, text), whatever they say."""
    with RingWriter(texts_path(ring), TEXT_FORMAT, "left", slots=16) as writer:
        for kind, length, text in rows:
            writer.row["kind"], writer.row["length"] = kind, length
            writer.row["text"][: len(text)] = list(text)
            writer.commit()


def test_events_and_health_come_back_in_order_with_their_kinds(ring: Path) -> None:
    writer = TextWriter(ring, "left")
    writer.event(event("a longer text first"))
    writer.health(8, {"temperature_C": [31.5]})
    writer.event(event("short"))
    reader = TextReader(ring)
    assert reader.read_new() == [
        (Kind.EVENT, event("a longer text first").to_json()),
        (Kind.HEALTH, b'{"utc_ns":8,"temperature_C":[31.5]}'),
        (Kind.EVENT, event("short").to_json()),
    ]
    assert reader.read_new() == []
    assert reader.pid == os.getpid()
    for end in (writer, reader):
        end.close()
        end.close()


def test_texts_lie_beside_the_ring_of_rows(ring: Path) -> None:
    assert texts_path(ring) == ring.with_name("left.ring.texts")
    TextWriter(ring, "left").close()
    assert texts_path(ring).exists()


def test_a_thousand_texts_wait_for_their_reader(ring: Path) -> None:
    writer = TextWriter(ring, "left")
    for i in range(1024 + 3):
        writer.event(event(f"text {i}"))
    texts = [json.loads(text)["text"] for _, text in TextReader(ring).read_new()]
    assert texts == [f"text {i}" for i in range(3, 1024 + 3)]


def test_kinds_are_the_numbers_that_readers_know(ring: Path) -> None:
    write_raw(ring, [(0, 2, b"ab"), (1, 2, b"cd")])
    assert TextReader(ring).read_new() == [(Kind.EVENT, b"ab"), (Kind.HEALTH, b"cd")]


def test_what_makes_no_sense_is_left_out(ring: Path) -> None:
    longest = b"x" * LONGEST
    write_raw(ring, [(2, 2, b"ab"), (0, LONGEST + 1, longest), (1, LONGEST, longest), (7, LONGEST + 1, b"")])
    assert TextReader(ring).read_new() == [(Kind.HEALTH, longest)]


@pytest.mark.parametrize("extra", [0, 1])
def test_health_that_is_too_long_is_replaced_by_its_size(ring: Path, extra: int) -> None:
    frame = len(b'{"utc_ns":8,"a":""}')
    writer = TextWriter(ring, "left")
    writer.health(8, {"a": "n" * (LONGEST - frame + extra)})
    ((kind, text),) = TextReader(ring).read_new()
    assert kind is Kind.HEALTH
    assert (len(text) == LONGEST) == (extra == 0)
    assert json.loads(text).get("truncated_bytes") == (LONGEST + 1 if extra else None)


def test_an_end_is_said_and_the_ring_given_back(ring: Path) -> None:
    writer = TextWriter(ring, "left")
    with RingReader(texts_path(ring), TEXT_FORMAT) as reader:
        assert not reader.finished
        writer.finish()
        assert reader.finished
        assert reader.writer_alive
        writer.close()
        assert not reader.writer_alive


def test_a_closed_reader_has_no_descriptor(ring: Path) -> None:
    def descriptors() -> int:
        return len(list(Path("/proc/self/fd").iterdir()))

    TextWriter(ring, "left").close()
    before = descriptors()
    TextReader(ring).close()
    assert descriptors() == before


def test_another_process_goes_on_with_the_texts_of_one_that_died(ring: Path) -> None:
    first = TextWriter(ring, "left")
    first.event(event("first"))
    heir = RingHeir(os.dup(first.fileno()), TEXT_FORMAT)
    second = TextWriter.of(heir)
    first.event(event("last words"))
    first.close()
    assert heir.catch_up() == 2
    second.event(event("of the other"))
    reader = TextReader(ring)
    assert [Event.from_json(text).text for _, text in reader.read_new()] == ["first", "last words", "of the other"]
    for end in (reader, second):
        end.close()


def test_texts_behind_a_damaged_one_are_read_at_the_same_look(ring: Path) -> None:
    writer = TextWriter(ring, "left")
    for text in ("first", "second", "third"):
        writer.event(event(text))
    with texts_path(ring).open("r+b", buffering=0) as file, RingReader(texts_path(ring), TEXT_FORMAT) as geometry:
        os.pwrite(file.fileno(), bytes(64), SLOTS_OFFSET + geometry.header.stride + 40)
    reader = TextReader(ring)
    assert [Event.from_json(text).text for _, text in reader.read_new()] == ["first", "third"]
    for end in (reader, writer):
        end.close()
