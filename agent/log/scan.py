"""Walks an MCAP file record by record, however it ends and whatever is damaged in it.  Reads only, trusts no length.

A file cut at any byte gives everything before the cut; a damaged chunk is left out and told of, the rest is read.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import Final

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Footer, Header, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC as MAGIC

CHUNK_BYTES_MAX: Final = 1 << 28
MESSAGE_HEAD: Final = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_RECORD_HEAD: Final = struct.Struct("<BQ")
_BAD_RECORD: Final = (ValueError, RuntimeError, OverflowError, McapError, struct.error, zstandard.ZstdError)

Record = Header | Schema | Channel | Attachment | Metadata


@dataclass(frozen=True, slots=True)
class Messages:
    """The messages of one intact chunk, as places in its uncompressed bytes."""

    data: bytes
    places: list[tuple[int, int, int]]  # channel, begin of the message, end; MESSAGE_HEAD lies right before the begin


class LogScan:
    """One pass over a file; `problems`, `finished` and `intact_bytes` are valid when the iteration has ended."""

    def __init__(self, data: memoryview) -> None:
        """`data`: the whole file, its magic first."""
        self._data = data
        self._data_ended = False
        self.problems: list[str] = []
        self.damaged = 0  # records left out because a checksum or their structure is wrong
        self.finished = False  # index and closing magic are there
        self.intact_bytes = len(MAGIC)  # up to the end of the last whole record

    def __iter__(self) -> Iterator[Record | Messages]:
        data, position = self._data, len(MAGIC)
        while position + _RECORD_HEAD.size <= len(data):
            opcode, length = _RECORD_HEAD.unpack_from(data, position)
            begin, end = position + _RECORD_HEAD.size, position + _RECORD_HEAD.size + length
            if end > len(data):
                break
            try:
                yield from self._record(opcode, data[begin:end], position)
            except _BAD_RECORD as error:
                self.damaged += 1
                self.problems.append(f"damaged at byte {position}: {error or type(error).__name__}")
            self.intact_bytes = position = end
            if opcode == Opcode.FOOTER:
                self.finished = bytes(data[end:]) == MAGIC
                break
        if self.finished and not self._data_ended:
            self.damaged += 1
            self.problems.append("the end of the data is not where it should be")
        if not self.finished:
            rest = len(data) - self.intact_bytes
            self.problems.append(f"the file ends without its index{f', {rest} bytes of a record cut' if rest else ''}")

    def _record(self, opcode: int, body: memoryview, position: int) -> Iterator[Record | Messages]:
        if opcode == Opcode.CHUNK:
            yield from _split(_uncompressed(body))
        elif opcode == Opcode.ATTACHMENT:
            if zlib.crc32(body[:-4]) != struct.unpack("<I", body[-4:])[0]:
                raise ValueError("attachment with a wrong checksum")
            yield Attachment.read(_stream(body))
        elif opcode == Opcode.METADATA:
            yield Metadata.read(_stream(body))
        elif opcode == Opcode.HEADER:
            yield Header.read(_stream(body))
        elif opcode == Opcode.DATA_END:
            self._data_ended = True
            expected = DataEnd.read(_stream(body)).data_section_crc
            if expected and zlib.crc32(self._data[:position]) != expected:
                raise ValueError("the data have a wrong checksum")
        elif opcode == Opcode.FOOTER:
            footer = Footer.read(_stream(body))
            crc_at = position + _RECORD_HEAD.size + 16
            if footer.summary_crc and zlib.crc32(self._data[footer.summary_start : crc_at]) != footer.summary_crc:
                raise ValueError("the index has a wrong checksum")


def library_of(data: memoryview) -> str | None:
    """Who wrote the file; None when it is no MCAP file."""
    if bytes(data[: len(MAGIC)]) != MAGIC:
        return None
    first = next(iter(LogScan(data)), None)
    return first.library if isinstance(first, Header) else ""


def _stream(body: memoryview) -> ReadDataStream:
    return ReadDataStream(BytesIO(body))


def _uncompressed(body: memoryview) -> bytes:
    chunk = Chunk.read(_stream(body))
    if chunk.uncompressed_size > CHUNK_BYTES_MAX:
        raise ValueError(f"a chunk of {chunk.uncompressed_size} bytes")
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    return stream.read(length)


def _split(data: bytes) -> Iterator[Record | Messages]:
    """Schemas and channels of a chunk, then all its messages at once."""
    places = []
    position, size = 0, len(data)
    head, channel_of, message = _RECORD_HEAD.unpack_from, struct.Struct("<H").unpack_from, int(Opcode.MESSAGE)
    while position < size:
        opcode, length = head(data, position)
        begin, position = position + 9, position + 9 + length
        if position > size:
            raise ValueError("a record reaches out of its chunk")
        if opcode == message:
            places.append((channel_of(data, begin)[0], begin + MESSAGE_HEAD.size, position))
        elif opcode == Opcode.SCHEMA:
            yield Schema.read(_stream(memoryview(data)[begin:position]))
        elif opcode == Opcode.CHANNEL:
            yield Channel.read(_stream(memoryview(data)[begin:position]))
    if places:
        yield Messages(data, places)
