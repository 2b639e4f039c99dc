"""Whatever the batches and chunks, independent readers find every message, its times and every checksum right."""

from __future__ import annotations

import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.records import Attachment, Channel, Schema

from agent.log.chunk import HEAD, Group, Message
from agent.log.messages import Messages
from agent.log.scan import LogScan
from agent.log.writer import BatchWriter

SIZES = {1: 5, 2: 40, 3: 17}  # bytes of a message by channel
DTYPES = {channel: np.dtype(f"V{size}") for channel, size in SIZES.items()}
FILLED = np.dtype({"names": ["number"], "formats": ["<u4"], "offsets": [9], "itemsize": 17})
TEMPLATE = bytes(range(100, 117))
batches = st.lists(st.tuples(st.sampled_from(["one", "two", "together"]), st.integers(1, 12)), max_size=25)
Written = list[tuple[int, int, int, bytes]]  # channel, sequence, time, message


def template_with(number: int) -> bytes:
    return TEMPLATE[:9] + number.to_bytes(4, "little") + TEMPLATE[13:]


def write(plan: list[tuple[str, int]], chunk_bytes: int, flush_every: int) -> tuple[bytes, Written]:
    """A finished file, and what was put into it, in order."""
    file, written = io.BytesIO(), []
    writer = BatchWriter(file.write, chunk_bytes=chunk_bytes)
    writer.start("ros2", "test")
    writer.add_attachment(Attachment(1, 2, "a.json", "application/json", b"{}"))
    writer.add_schema(Schema(7, b"uint8[] data\n", "ros2msg", "some/msg/Name"))
    for channel in SIZES:
        writer.add_channel(Channel(channel, f"/{channel}", "cdr", {"k": "v"}, 7))
    groups = {
        "one": Group([Message(1, DTYPES[1])]),
        "two": Group([Message(2, DTYPES[2])]),
        "together": Group([Message(2, DTYPES[2], bytes(40)), Message(3, FILLED, TEMPLATE)]),
    }
    begin = 1000
    for i, (name, size) in enumerate(plan):
        group = groups[name]
        sequences, times = np.arange(begin, begin + size), np.arange(begin, begin + size) * 3 - (i % 3) * 500
        contents = {c: [bytes([c, i, k] * SIZES[c])[: SIZES[c]] for k in range(size)] for c in SIZES}
        contents[3] = [template_with(i) for _ in range(size)]
        records = writer.append(group, sequences, times)
        for channel, message in zip(group.channels, group.names, strict=True):
            if channel == 3:
                records[message]["number"] = i
            else:
                records[message] = np.array([np.void(content) for content in contents[channel]], DTYPES[channel])
        for k in range(size):
            written += [(c, int(sequences[k]), int(times[k]), contents[c][k]) for c in group.channels]
        if writer.full or i % flush_every == 0:
            writer.end_chunk()
        begin += size
    writer.add_metadata("last", {"complete": "true"})
    writer.finish()
    return file.getvalue(), written


@given(batches, st.sampled_from([100, 700, 1 << 20]), st.integers(1, 6))
def test_every_reader_finds_every_message(plan: list[tuple[str, int]], chunk_bytes: int, flush_every: int) -> None:
    data, written = write(plan, chunk_bytes, flush_every)
    streamed = NonSeekingReader(io.BytesIO(data), validate_crcs=True).iter_messages(log_time_order=False)
    assert [(c.id, m.sequence, m.log_time, m.data) for _, c, m in streamed] == written
    reader = SeekingReader(io.BytesIO(data), validate_crcs=True)
    indexed = [(c.id, m.sequence, m.log_time, m.data) for _, c, m in reader.iter_messages(log_time_order=True)]
    assert sorted(indexed) == sorted(written)
    assert [time for _, _, time, _ in indexed] == sorted(time for _, _, time, _ in written)
    for channel in SIZES:
        some = [m.data for _, _, m in reader.iter_messages(topics=[f"/{channel}"], log_time_order=False)]
        assert sorted(some) == sorted(message for c, _, _, message in written if c == channel)


@given(batches, st.sampled_from([100, 1 << 20]), st.integers(1, 6))
def test_the_summary_counts_what_is_there(plan: list[tuple[str, int]], chunk_bytes: int, flush_every: int) -> None:
    data, written = write(plan, chunk_bytes, flush_every)
    summary = SeekingReader(io.BytesIO(data)).get_summary()
    statistics, times = summary.statistics, [time for _, _, time, _ in written]
    assert statistics.message_count == len(written)
    assert statistics.channel_message_counts == {c: n for c in SIZES if (n := sum(w[0] == c for w in written))}
    assert (statistics.message_start_time, statistics.message_end_time) == (
        (min(times), max(times)) if times else (0, 0)
    )
    assert statistics.chunk_count == len(summary.chunk_indexes)
    assert (statistics.attachment_count, statistics.metadata_count) == (1, 1)
    assert [a.name for a in summary.attachment_indexes] == ["a.json"]
    assert [m.name for m in summary.metadata_indexes] == ["last"]
    assert {c.topic for c in summary.channels.values()} == {f"/{c}" for c in SIZES}
    for index in summary.chunk_indexes:
        at = index.chunk_start_offset
        assert data[at] == Opcode.CHUNK
        assert int.from_bytes(data[at + 1 : at + 9], "little") + 9 == index.chunk_length
        assert data[at + index.chunk_length] == Opcode.MESSAGE_INDEX


@given(batches, st.sampled_from([100, 1 << 20]))
def test_our_own_scan_finds_the_same_and_no_damage(plan: list[tuple[str, int]], chunk_bytes: int) -> None:
    data, written = write(plan, chunk_bytes, 3)
    scan, found = LogScan(io.BytesIO(data)), []
    for record in scan:
        if isinstance(record, Messages):
            copy = record.copy(set(SIZES))
            heads = [np.frombuffer(copy.content, HEAD, 1, offset)[0] for offset in copy.offsets.tolist()]
            assert copy.channels.tolist() == [head["channel"] for head in heads]
            assert copy.times.tolist() == [head["log_time"] for head in heads]
            payloads = [payload.tobytes() for run in record.runs for payload in record.payloads(run)]
            for head, payload in zip(heads, payloads, strict=True):
                found.append((int(head["channel"]), int(head["sequence"]), int(head["log_time"]), payload))
    assert found == written
    assert scan.finished
    assert scan.problems == []


@given(batches, st.sets(st.sampled_from(sorted(SIZES))), st.sampled_from([100, 1 << 20]))
def test_a_copy_of_some_channels_is_a_file_with_all_of_their_messages(
    plan: list[tuple[str, int]], channels: set[int], chunk_bytes: int
) -> None:
    data, written = write(plan, 700, 3)
    file = io.BytesIO()
    writer = BatchWriter(file.write, chunk_bytes=chunk_bytes)
    writer.start("ros2", "copy")
    for record in LogScan(io.BytesIO(data)):
        if isinstance(record, Schema):
            writer.add_schema(record)
        elif isinstance(record, Channel) and record.id in channels:
            writer.add_channel(record)
        elif isinstance(record, Messages):
            copy = record.copy(channels)
            if copy.content:
                writer.append_copy(copy)
            if writer.full:
                writer.end_chunk()
    writer.finish()
    expected = [w for w in written if w[0] in channels]
    for reader in (NonSeekingReader, SeekingReader):
        found = reader(io.BytesIO(file.getvalue()), validate_crcs=True).iter_messages(log_time_order=False)
        assert sorted((c.id, m.sequence, m.log_time, m.data) for _, c, m in found) == sorted(expected)


@pytest.mark.parametrize("size", [1, 30, 31, 1000])
def test_room_is_what_makes_a_chunk_full(size: int) -> None:
    writer = BatchWriter(io.BytesIO().write, chunk_bytes=1000)
    group = Group([Message(1, np.dtype(f"V{size}"))])
    rows = writer.room(group.dtype.itemsize)
    numbers = np.arange(rows)
    if rows > 1:
        writer.append(group, numbers[1:], numbers[1:])
        assert not writer.full
        assert writer.room(group.dtype.itemsize) == 1
    writer.append(group, numbers[:1], numbers[:1])
    assert writer.full
    assert writer.room(group.dtype.itemsize) == 1
