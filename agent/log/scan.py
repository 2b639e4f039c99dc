"""Walks an MCAP file record by record, however it ends and whatever is damaged in it; holds one record at a time.

A file cut at any byte gives everything before the cut; a damaged chunk is left out and told of, the rest is read.
"""

from __future__ import annotations

import errno
import os
import stat
import struct
import zlib
from collections.abc import Container, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Footer, Header, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC as MAGIC
from numpy.typing import NDArray

from agent.log.chunk import HEAD, LOG_TIME_AT, RECORD_HEAD_BYTES, RecordCopy

CHUNK_BYTES_MAX: Final = 1 << 28
RECORD_BYTES_MAX: Final = 1 << 28
_RECORD_HEAD: Final = struct.Struct("<BQ")
_CHUNK_HEAD: Final = struct.Struct("<QQQII")  # times, size, checksum, length of the compression's name
_CHANNEL_AT: Final = RECORD_HEAD_BYTES + 2  # a message record begins with opcode, length, channel
_FOOTER_CRC_AT: Final = RECORD_HEAD_BYTES + 16
_BAD_RECORD: Final = (ValueError, RuntimeError, OverflowError, McapError, struct.error, zstandard.ZstdError)
_PIECE: Final = 1 << 20
_BEGINNING: Final = MAGIC + bytes([Opcode.HEADER])  # of a log; what ends one is not followed by a header

Record = Header | Schema | Channel | Attachment | Metadata


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


class LogScan:
    """One pass over a file; `problems`, `finished` and `intact_bytes` are valid when the iteration has ended."""

    def __init__(self, file: BinaryIO) -> None:
        """`file`: from its first byte on, of the length that it has now."""
        self._file = file
        self._size = file.seek(0, 2)
        self._crc = 0  # of everything before the record at hand
        self._data_ended = False
        self.problems: list[str] = []
        self.damaged = 0  # records left out because a checksum or their structure is wrong
        self.finished = False  # index and closing magic are there
        self.another_at: int | None = None  # where another log begins behind the end of this one, or where it is cut
        self.intact_bytes = len(MAGIC)  # up to the end of the last whole record

    def __iter__(self) -> Iterator[Record | Messages]:
        self._file.seek(0)
        self._crc = zlib.crc32(self._file.read(len(MAGIC)))
        position = len(MAGIC)
        while position + RECORD_HEAD_BYTES <= self._size:
            head = self._file.read(RECORD_HEAD_BYTES)
            opcode, length = _RECORD_HEAD.unpack(head)
            end = position + RECORD_HEAD_BYTES + length
            if end > self._size:
                break
            try:
                yield from self._record(opcode, length, head, position)
            except _BAD_RECORD as error:
                if self._another_within(position, end + len(_BEGINNING) - 1):
                    break
                self._damage(f"damaged at byte {position}: {error or type(error).__name__}")
            self.intact_bytes = position = end
            self._file.seek(end)
            if opcode == Opcode.FOOTER:
                self.finished = self._file.read(len(MAGIC)) == MAGIC
                break
        if self.finished and not self._data_ended:
            self._damage("the end of the data is not where it should be")
        ends, another = self._file.tell(), self.finished and self._file.read(len(MAGIC)) == MAGIC
        if self.finished and ends < self._size:
            self.another_at = ends if another else None
            what = "another log, which is not read" if another else "no part of it"
            self.problems.append(f"{self._size - ends} bytes behind its end are {what}")
        if not self.finished:
            self._tell_cut()

    def _tell_cut(self) -> None:
        rest, what = self._size - self.intact_bytes, "of a record cut"
        if self._another_within(self.intact_bytes, self._size):
            what = "are a record cut and another log, which is not read"
        self.problems.append(f"the file ends without its index{f', {rest} bytes {what}' if rest else ''}")

    def _another_within(self, begin: int, end: int) -> bool:
        """Whether another log begins in these bytes, which are no record; `another_at` says where."""
        self._file.seek(begin)
        kept, at = b"", begin
        while self.another_at is None and (piece := self._file.read(min(end - begin, _PIECE))):
            found = (kept + piece).find(_BEGINNING)
            if found >= 0:
                self.another_at = at - len(kept) + found
            kept, at, begin = (kept + piece)[1 - len(_BEGINNING) :], at + len(piece), begin + len(piece)
        return self.another_at is not None

    def _damage(self, what: str) -> None:
        self.damaged += 1
        self.problems.append(what)

    def _record(self, opcode: int, length: int, head: bytes, position: int) -> Iterator[Record | Messages]:
        before = self._crc
        if length > RECORD_BYTES_MAX:
            self._crc = self._checksum(length, zlib.crc32(head, before))
            raise ValueError(f"a record of {length} bytes")
        body = self._file.read(length)
        self._crc = zlib.crc32(body, zlib.crc32(head, before))
        if opcode == Opcode.CHUNK:
            yield from _split(_uncompressed(body))
        elif opcode == Opcode.ATTACHMENT:
            if zlib.crc32(memoryview(body)[:-4]) != struct.unpack("<I", body[-4:])[0]:
                raise ValueError("attachment with a wrong checksum")
            yield Attachment.read(_stream(body))
        elif opcode == Opcode.METADATA:
            yield Metadata.read(_stream(body))
        elif opcode == Opcode.HEADER:
            yield Header.read(_stream(body))
        elif opcode == Opcode.DATA_END:
            self._data_ended = True
            expected = DataEnd.read(_stream(body)).data_section_crc
            if expected and before != expected:
                raise ValueError("the data have a wrong checksum")
        elif opcode == Opcode.FOOTER:
            self._check_summary(Footer.read(_stream(body)), position)

    def _check_summary(self, footer: Footer, position: int) -> None:
        length = position + _FOOTER_CRC_AT - footer.summary_start
        if not footer.summary_crc:
            return
        if length < 0:
            raise ValueError("the index is not where it should be")
        self._file.seek(footer.summary_start)
        if self._checksum(length, 0) != footer.summary_crc:
            raise ValueError("the index has a wrong checksum")

    def _checksum(self, length: int, crc: int) -> int:
        """CRC32 of the next so many bytes of the file, going on from `crc`."""
        while length > 0 and (piece := self._file.read(min(length, _PIECE))):
            crc, length = zlib.crc32(piece, crc), length - len(piece)
        return crc


def open_file(path: Path) -> BinaryIO:
    """A file to be read, as often as wanted.  Raises OSError, for a pipe or a device too, and waits for neither."""
    fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    mode = os.fstat(fd).st_mode
    if not stat.S_ISREG(mode):
        os.close(fd)
        found = os.strerror(errno.EISDIR) if stat.S_ISDIR(mode) else "no regular file"
        raise OSError(errno.EINVAL, found, str(path))
    return os.fdopen(fd, "rb")


def library_of(file: BinaryIO) -> str | None:
    """Who wrote the file; None when it is no MCAP file."""
    file.seek(0)
    if file.read(len(MAGIC)) != MAGIC:
        return None
    first = next(iter(LogScan(file)), None)
    return first.library if isinstance(first, Header) else ""


def _stream(body: bytes | memoryview) -> ReadDataStream:
    return ReadDataStream(BytesIO(body))


def _uncompressed(body: bytes) -> bytes:
    """Content of a chunk.  Raises ValueError when it is too large or its checksum is wrong."""
    _, _, size, crc, name_length = _CHUNK_HEAD.unpack_from(body)
    if size > CHUNK_BYTES_MAX:
        raise ValueError(f"a chunk of {size} bytes")
    name_at = _CHUNK_HEAD.size
    packed_at = name_at + name_length + 8
    if body[name_at : name_at + name_length] != b"zstd":
        stream, length = get_chunk_data_stream(Chunk.read(_stream(body)), validate_crc=True)
        return stream.read(length)
    packed = memoryview(body)[packed_at : packed_at + int.from_bytes(body[packed_at - 8 : packed_at], "little")]
    if zstandard.frame_content_size(packed) not in (-1, size):
        raise ValueError("a chunk of another size than it says")
    data = zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    if len(data) != size or (crc and zlib.crc32(data) != crc):
        raise ValueError("a chunk with a wrong checksum")
    return data


def _split(data: bytes) -> Iterator[Record | Messages]:
    """Schemas and channels of a chunk, then all its messages at once."""
    runs = []
    position, size = 0, len(data)
    head, message = _RECORD_HEAD.unpack_from, int(Opcode.MESSAGE)
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
            yield Schema.read(_stream(memoryview(data)[begin + RECORD_HEAD_BYTES : position]))
        elif opcode == Opcode.CHANNEL:
            yield Channel.read(_stream(memoryview(data)[begin + RECORD_HEAD_BYTES : position]))
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
