"""The ring of a writer that has died, for whoever goes on with it; nothing that becomes of the file ends this process.

It writes by calls where the writer before it stored into memory: a file that has been cut under both ended the one, and
is mended by the other.  What cannot be written is lost, and the loop goes on.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from agent.telemetry.ring import file as ring_file
from agent.telemetry.ring import words
from agent.telemetry.ring.file import FINISHED_WORD, SLOTS_OFFSET, WRITTEN_MAX, WRITTEN_WORD, RingHeader, RowFormat
from agent.telemetry.ring.writer import RingWriter, aligned_row
from agent.telemetry.row.sample import CDR_LITTLE_ENDIAN

_HEAD_BYTES: Final = 8 * WRITTEN_WORD  # what does not change as long as the ring lives
_SLOT_HEAD: Final = struct.Struct("=QI")


def _tell_nobody(_: str) -> None:
    """Where nobody asks."""


class RingHeir(RingWriter):
    """Goes on behind the last row of another writer; as long as that one lives nothing may be committed here."""

    def __init__(self, fd: int, row_format: RowFormat) -> None:
        """fd: a descriptor of the ring that its writer has passed on; this one's from now on.

        The lock stays with whoever holds such a descriptor, so readers notice nothing.  Raises RingError for a file
        that is no such ring; fd is then closed.
        """
        path = Path(f"/proc/self/fd/{fd}")
        try:
            self._head = os.pread(fd, SLOTS_OFFSET, 0)
            self.header = RingHeader.unpack(path, self._head)
            ring_file.check_format(path, self.header, row_format, os.fstat(fd).st_size)
        except BaseException:
            os.close(fd)
            raise
        self._head = self._head[:_HEAD_BYTES]
        self._fd = fd
        self.row, self._staged = aligned_row(row_format.dtype)
        self.row["encapsulation"] = CDR_LITTLE_ENDIAN
        self.failed: Callable[[str], None] = _tell_nobody  # is told why rows are lost, the first time
        self._has_failed = False
        self.written = 0
        self.catch_up()

    def catch_up(self) -> int:
        """How many rows there are, whoever wrote them, and as far as was seen in a file that is whole no more."""
        written = words.word_at(self._fd, 8 * WRITTEN_WORD)
        if self.written < written <= WRITTEN_MAX:
            self.written = written
        return self.written

    @property
    def damage(self) -> str:
        """What has become of the file: that it was cut, or written over; empty while it is whole."""
        left = words.cut(self._fd, self.header)
        if left:
            return f"cut to {left}"
        return "" if os.pread(self._fd, _HEAD_BYTES, 0) == self._head else "written over"

    def mend(self, rows: Sequence[bytes]) -> None:
        """Make a ring again of a file that is none any more, with these rows as its last ones."""
        try:
            if words.cut(self._fd, self.header):
                os.ftruncate(self._fd, self.header.file_bytes)
            os.pwrite(self._fd, self._head, 0)
        except OSError as error:
            self._fail(error)
        for index, row in enumerate(rows, self.written - len(rows)):
            self._put(index, row)
        self._put_word(WRITTEN_WORD, self.written)

    def commit(self) -> None:
        """Make `row` visible as the next row; one that cannot be written is lost.

        A file that has been cut or written over meanwhile is made anew first, or nobody who comes later could read it.
        """
        if damage := self.damage:
            self._lose(f"the file was {damage}, and is made anew")
            self.mend(())
        self._put(self.written, self._staged)
        self.written += 1
        self._put_word(WRITTEN_WORD, self.written)

    def wait_for_space(self, timeout_s: float = 0.0) -> None:
        """Nothing waits: who goes on has the time of a real arm."""

    def finish(self) -> None:
        """Say that no row will follow."""
        self._put_word(FINISHED_WORD, 1)

    def close(self) -> None:
        """Let go of the file, and of the lock with it.  Safe twice."""
        if self._fd < 0:
            return
        os.close(self._fd)
        self._fd = -1

    def _put(self, index: int, row: bytes | memoryview) -> None:
        """In one call, its index first: a reader believes no half of it."""
        place = SLOTS_OFFSET + index % self.header.slots * self.header.stride
        head = _SLOT_HEAD.pack(index + 1, zlib.crc32(row, index & 0xFFFFFFFF))
        try:
            os.pwritev(self._fd, [head, row], place)
        except OSError as error:
            self._fail(error)

    def _put_word(self, word: int, value: int) -> None:
        try:
            words.put_word(self._fd, word, value)
        except OSError as error:
            self._fail(error)

    def _fail(self, error: OSError) -> None:
        self._lose(error.strerror or str(error))

    def _lose(self, why: str) -> None:
        if not self._has_failed:
            self._has_failed = True
            self.failed(why)
