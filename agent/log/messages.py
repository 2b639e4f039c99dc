"""The messages of a chunk as arrays: those of one channel and one size that lie one behind the other at once."""

from __future__ import annotations

from collections.abc import Container, Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from agent.log.chunk import HEAD, LOG_TIME_AT, RECORD_HEAD_BYTES, RecordCopy
from agent.log.records import RECORD_HEAD, stream_of

_CHANNEL_AT: Final = RECORD_HEAD_BYTES + 2  # a message record begins with opcode, length, channel


class Run(NamedTuple):
    """Message records of one channel and one size, one behind the other."""

    channel: int
    begin: int  # of the first record
    stride: int  # bytes of each record
    number: int  # how many


@dataclass(frozen=True, slots=True)
class Messages:
    """The messages of one intact chunk, in its uncompressed bytes."""

    data: bytes
    runs: list[Run]

    def payloads(self, run: Run) -> NDArray[np.uint8]:
        """The messages (number, size) of a run, without their heads."""
        shape, first = (run.number, run.stride - HEAD.itemsize), run.begin + HEAD.itemsize
        return np.ndarray(shape, np.uint8, self.data, first, (run.stride, 1))

    def copy(self, channels: Container[int]) -> RecordCopy:
        """The message records of these channels."""
        runs = [run for run in self.runs if run.channel in channels]
        content = b"".join(self.data[run.begin : run.begin + run.stride * run.number] for run in runs)
        numbers, strides = (np.array([getattr(run, name) for run in runs], np.int64) for name in ("number", "stride"))
        each = np.repeat(strides, numbers)
        offsets = np.cumsum(each) - each
        time_at = offsets[:, None] + np.arange(LOG_TIME_AT, LOG_TIME_AT + 8)
        times = np.frombuffer(content, np.uint8)[time_at].view("<u8")[:, 0] if runs else np.empty(0, np.uint64)
        return RecordCopy(content, np.repeat([run.channel for run in runs], numbers), times, offsets.astype(np.uint64))


def split(data: bytes) -> Iterator[Schema | Channel | Messages]:
    """Schemas and channels of a chunk, then all its messages at once."""
    runs = []
    position, size = 0, len(data)
    head, message = RECORD_HEAD.unpack_from, int(Opcode.MESSAGE)
    while position < size:
        opcode, length = head(data, position)
        begin, position = position, position + RECORD_HEAD_BYTES + length
        if position > size:
            raise ValueError("a record reaches out of its chunk")
        if opcode == message:
            run = _run_at(data, begin, RECORD_HEAD_BYTES + length)
            runs.append(run)
            position = begin + run.stride * run.number
        elif opcode == Opcode.SCHEMA:
            yield Schema.read(stream_of(memoryview(data)[begin + RECORD_HEAD_BYTES : position]))
        elif opcode == Opcode.CHANNEL:
            yield Channel.read(stream_of(memoryview(data)[begin + RECORD_HEAD_BYTES : position]))
    if runs:
        yield Messages(data, runs)


def _run_at(data: bytes, begin: int, stride: int) -> Run:
    """The message record at `begin`, and those like it right behind it."""
    if stride < HEAD.itemsize:
        raise ValueError("a message without its head")
    alike = data[begin : begin + _CHANNEL_AT]
    position, end = begin + stride, len(data) - stride
    while position <= end and data.startswith(alike, position):
        position += stride
    return Run(int.from_bytes(alike[RECORD_HEAD_BYTES:], "little"), begin, stride, (position - begin) // stride)
