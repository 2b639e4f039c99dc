"""Walks an MCAP file record by record, however it ends and whatever is damaged in it; holds one record at a time.

A file cut at any byte gives everything before the cut; a damaged record is left out and told of, the rest is read.
Behind a record whose length is wrong the scan goes on at the next one that shows by its checksum or its structure, and
by what follows it, that it is one.
"""

from __future__ import annotations

import errno
import os
import re
import stat
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Final

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, DataEnd, Footer, Header, Metadata, Schema
from mcap.writer import MCAP0_MAGIC as MAGIC

from agent.log.chunk import RECORD_HEAD_BYTES
from agent.log.messages import Messages, split
from agent.log.records import BAD_RECORD, RECORD_HEAD, attachment, length_by_content, stream_of, uncompressed

RECORD_BYTES_MAX: Final = 1 << 28
_FOOTER_CRC_AT: Final = RECORD_HEAD_BYTES + 16
_PIECE: Final = 1 << 20
_BEGINNING: Final = MAGIC + bytes([Opcode.HEADER])  # of a log; what ends one is not followed by a header
_FOUND_AGAIN: Final = (Opcode.FOOTER, Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.DATA_END)
_MARK: Final = re.compile(  # a log's beginning, or the head of a record to go on at, of less than 4 GB
    b"(?=" + re.escape(_BEGINNING) + b"|[" + b"".join(b"\\x%02x" % kind for kind in _FOUND_AGAIN) + b"].{4}\0{4})", re.S
)

Record = Header | Schema | Channel | Attachment | Metadata


class LogScan:
    """One pass over a file; `problems`, `finished` and `intact_bytes` are valid when the iteration has ended."""

    def __init__(self, file: BinaryIO, *, looks_ahead: bool = True) -> None:
        """`file`: from its first byte on, of the length that it has now.

        looks_ahead: where something is damaged, schemas and channels behind it come before the rest, for the record
        that declared them may be lost; at its end a finished log has them again.
        """
        self._file = file
        self._size = file.seek(0, 2)
        self._crc = 0  # of everything before the record at hand
        self._data_ended = False
        self._looks_ahead = looks_ahead
        self.problems: list[str] = []
        self.damaged = 0  # records left out because a checksum or their structure is wrong
        self.finished = False  # index and closing magic are there
        self.closed = False  # and nothing is behind them
        self.another_at: int | None = None  # where another log begins behind the end of this one, or where it is cut
        self.intact_bytes = len(MAGIC)  # up to the end of the last whole record

    def __iter__(self) -> Iterator[Record | Messages]:
        self._crc = zlib.crc32(self._bytes(0, len(MAGIC)))
        position, footer = len(MAGIC), False
        while position + RECORD_HEAD_BYTES <= self._size and not footer:
            opcode, length = RECORD_HEAD.unpack(self._bytes(position, RECORD_HEAD_BYTES))
            before, end = self._crc, position + RECORD_HEAD_BYTES + length
            try:
                yield from self._record(opcode, position, length)
            except BAD_RECORD as error:
                what = f"damaged at byte {position}: {error or type(error).__name__}"
                if (whole := self._whole_but_for_its_head(opcode, position, length)) is not None:
                    (opcode, length), self._crc = whole, before
                    end = position + RECORD_HEAD_BYTES + length
                    self.problems.append(f"{what}; what it holds is whole")
                    yield from self._record(opcode, position, length)
                else:
                    yield from self._declared_behind()
                    known = length <= RECORD_BYTES_MAX and self._length(opcode, position) is not None
                    torn = known and end > self._size
                    next_at = self._next_behind(position, end)
                    if self.another_at is None and not (torn and next_at is None):
                        self._damage(what)
                    if next_at is None:
                        break
                    opcode, end = 0, next_at
            self.intact_bytes = position = end
            footer = opcode == Opcode.FOOTER
        self.finished = footer and self._bytes(position, len(MAGIC)) == MAGIC
        if self.finished:
            self._tell_of_end(position + len(MAGIC))
        else:
            self._tell_cut()

    def _declared_behind(self) -> Iterator[Record]:
        if self._looks_ahead:
            self._looks_ahead = False
            ahead = LogScan(self._file, looks_ahead=False)
            yield from (record for record in ahead if isinstance(record, Schema | Channel))

    def _tell_of_end(self, ends: int) -> None:
        if not self._data_ended:
            self._damage("the end of the data is not where it should be")
        self.closed = ends == self._size
        if not self.closed:
            another = self._bytes(ends, len(MAGIC)) == MAGIC
            self.another_at = ends if another else None
            what = "another log, which is not read" if another else "no part of it"
            self.problems.append(f"{self._size - ends} bytes behind its end are {what}")

    def _tell_cut(self) -> None:
        rest, what = self._size - self.intact_bytes, "of a record cut"
        if self.another_at is not None:
            what = "are a record cut and another log, which is not read"
        self.problems.append(f"the file ends without its index{f', {rest} bytes {what}' if rest else ''}")

    def _damage(self, what: str) -> None:
        self.damaged += 1
        self.problems.append(what)

    def _bytes(self, at: int, length: int) -> bytes:
        self._file.seek(at)
        return self._file.read(length)

    # ------------------------------------------------------------------------------------------ behind a damaged record

    def _length(self, opcode: int, position: int) -> int | None:
        return length_by_content(opcode, lambda at, size: self._bytes(position + RECORD_HEAD_BYTES + at, size))

    def _is_likely(self, position: int) -> bool:
        """Whether here the file ends, or there is a record whose length agrees with what it holds."""
        if position + RECORD_HEAD_BYTES > self._size:
            return position == self._size
        opcode, length = RECORD_HEAD.unpack(self._bytes(position, RECORD_HEAD_BYTES))
        held = self._length(opcode, position)
        return held is not None and held <= length <= self._size - position - RECORD_HEAD_BYTES

    def _is_whole(self, opcode: int, position: int, length: int) -> bool:
        """Whether there is such a record: by its checksum, or by its structure and what follows where it has none."""
        end = position + RECORD_HEAD_BYTES + length
        if length > RECORD_BYTES_MAX or end > self._size:
            return False
        body = self._bytes(position + RECORD_HEAD_BYTES, length)
        try:
            if opcode == Opcode.CHUNK:
                return bool(list(split(uncompressed(body))))  # an empty one is told from zeros by nothing
            if opcode == Opcode.ATTACHMENT:
                return attachment(body).data is not None
            if opcode == Opcode.METADATA:
                Metadata.read(stream_of(body))
        except BAD_RECORD:
            return False
        return self._bytes(end, len(MAGIC)) == MAGIC if opcode == Opcode.FOOTER else self._is_likely(end)

    def _whole_but_for_its_head(self, opcode: int, position: int, length: int) -> tuple[int, int] | None:
        """Opcode and length of a record of which the head alone is damaged."""
        for kind in (opcode, int(Opcode.CHUNK)):
            held = self._length(kind, position)
            if held is not None and (kind, held) != (opcode, length) and self._is_whole(kind, position, held):
                return kind, held
        return None

    def _next_behind(self, position: int, end: int) -> int | None:
        """Where the next record begins behind a damaged one; `another_at` says where another log does before that."""
        agrees = end <= self._size and self._is_likely(end)
        until = min(self._size, end + len(_BEGINNING) - 1) if agrees else self._size
        for at in self._marks(position, until):
            if self._bytes(at, len(_BEGINNING)) == _BEGINNING:
                self.another_at = at
                return None
            opcode, length = RECORD_HEAD.unpack(self._bytes(at, RECORD_HEAD_BYTES))
            if not agrees and self._length(opcode, at) == length and self._is_whole(opcode, at, length):
                return at
        return end if agrees else None

    def _marks(self, begin: int, end: int) -> Iterator[int]:
        """Where in these bytes another log or a record may begin."""
        kept, at = b"", begin
        while piece := self._bytes(at, min(end - at, _PIECE)):
            kept, at = kept + piece, at + len(piece)
            if kept != bytes(len(kept)):  # a hole, in which there is nothing to look for
                yield from (at - len(kept) + found.start() for found in _MARK.finditer(kept))
            kept = kept[1 - len(_BEGINNING) :]

    # --------------------------------------------------------------------------------------------------- of one record

    def _record(self, opcode: int, position: int, length: int) -> Iterator[Record | Messages]:
        end = position + RECORD_HEAD_BYTES + length
        if end > self._size:
            raise ValueError(f"a record of {length} bytes, {end - self._size} more than are there")
        before = self._crc
        self._crc = zlib.crc32(self._bytes(position, RECORD_HEAD_BYTES), before)
        if length > RECORD_BYTES_MAX:
            self._crc = self._checksum(length, self._crc)
            raise ValueError(f"a record of {length} bytes")
        body = self._file.read(length)
        self._crc = zlib.crc32(body, self._crc)
        held = length_by_content(opcode, lambda at, size: body[at : at + size])
        if held != length and opcode != Opcode.MESSAGE:  # a later MCAP may add fields at the end, and other records
            chunk_held = length_by_content(Opcode.CHUNK, lambda at, size: body[at : at + size])
            if chunk_held == length or not self._is_likely(end):
                raise ValueError(f"a record of {length} bytes that says it is of {held}")
        if opcode == Opcode.CHUNK:
            yield from split(uncompressed(body))
        elif opcode == Opcode.ATTACHMENT:
            yield attachment(body)
        elif opcode == Opcode.METADATA:
            yield Metadata.read(stream_of(body))
        elif opcode == Opcode.HEADER:
            yield Header.read(stream_of(body))
        elif opcode == Opcode.SCHEMA and not self._looks_ahead:
            yield Schema.read(stream_of(body))
        elif opcode == Opcode.CHANNEL and not self._looks_ahead:
            yield Channel.read(stream_of(body))
        elif opcode == Opcode.DATA_END:
            self._data_ended = True
            expected = DataEnd.read(stream_of(body)).data_section_crc
            if expected and before != expected and not self.problems:  # else it follows from what was told
                self._damage(f"damaged at byte {position}: the data have a wrong checksum")
        elif opcode == Opcode.FOOTER:
            if len(MAGIC) <= self._size - end and self._bytes(end, len(MAGIC)) != MAGIC:
                raise ValueError("the end is not where it should be")
            if wrong := self._wrong_summary(Footer.read(stream_of(body)), position):
                self._damage(f"damaged at byte {position}: {wrong}")

    def _wrong_summary(self, footer: Footer, position: int) -> str:
        length = position + _FOOTER_CRC_AT - footer.summary_start
        if not footer.summary_crc:
            return ""
        if length < 0:
            return "the index is not where it should be"
        self._file.seek(footer.summary_start)
        return "the index has a wrong checksum" if self._checksum(length, 0) != footer.summary_crc else ""

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
