"""The reading end of the ring between control thread and telemetry; there may be many.

A reader copies first and believes nothing that does not carry the right index before and after the copy and the right
CRC32, so a torn row is never returned, whatever the order in which another core sees the writer's stores.  It maps
nothing: of a file that is cut while it is read, rows are missing, and the process lives to tell.
"""

from __future__ import annotations

import contextlib
import os
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from agent.telemetry.ring import file as ring_file
from agent.telemetry.ring import words
from agent.telemetry.ring.file import (
    ACKNOWLEDGED_WORD,
    FINISHED_WORD,
    MESSAGE_IN_SLOT,
    SLOTS_OFFSET,
    WRITTEN_MAX,
    WRITTEN_WORD,
    RingError,
    RingHeader,
    RowFormat,
)

_READ_ATTEMPTS: Final = 3  # a row that is bad this often is damaged, not late in coming from another core


@dataclass(frozen=True, slots=True)
class RowBlock:
    """Consecutive rows, each a complete message."""

    first: int  # ring index of the first row
    count: int
    payload: bytes


class RingReader:
    """A reading end: opens the file for reading, unless it is to acknowledge and writes that one word."""

    def __init__(self, path: Path, row_format: RowFormat, *, acknowledges: bool = False) -> None:
        """Open the ring at `path`, at its oldest row.  Raises RingError when it is missing or not such a ring."""
        with contextlib.ExitStack() as undo:
            try:
                access = os.O_RDWR if acknowledges else os.O_RDONLY
                fd = os.open(path, access | os.O_NONBLOCK | os.O_CLOEXEC)  # a pipe is not waited for
                undo.callback(os.close, fd)
                self.header = RingHeader.unpack(path, os.pread(fd, SLOTS_OFFSET, 0))
                ring_file.check_format(path, self.header, row_format, os.fstat(fd).st_size)
                self._path, self._fd, self._written = path, fd, 0
                self._look()
            except OSError as error:
                raise RingError(
                    f"cannot open the telemetry ring {path}",
                    found=error.strerror,
                    expected="the file an agent made",
                    remedy="start the agent first, or correct the path",
                ) from error
            undo.pop_all()
        self.missed = 0  # rows overwritten before they were read
        self.damaged = 0  # rows whose checksum stays wrong
        self._next = 0
        self._bad_reads = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def written(self) -> int:
        """Rows committed so far; as far as was seen, where the file has been cut.  Raises RingError for no count."""
        self._look()
        return self._written

    @property
    def cut(self) -> str:
        """What is left of the file, where it has been cut; empty otherwise."""
        return words.cut(self._fd, self.header)

    @property
    def next_index(self) -> int:
        """Index of the row `read_new` looks for next."""
        return self._next

    @property
    def oldest(self) -> int:
        """Index of the oldest row that may still be in the ring."""
        return max(0, self.written - self.header.slots)

    @property
    def finished(self) -> bool:
        """Whether the writer said that no row will follow."""
        return bool(self._word(FINISHED_WORD))

    @property
    def writer_alive(self) -> bool:
        """Whether a process still holds the writer's lock."""
        return ring_file.is_locked(self._fd)

    @property
    def replaced(self) -> bool:
        """Whether the path leads to another ring by now."""
        try:
            return self._path.stat().st_ino != os.fstat(self._fd).st_ino
        except FileNotFoundError:
            return False

    def read_new(self, max_rows: int) -> RowBlock:
        """Return the next rows, at most `max_rows`, perhaps none; `missed` counts what was overwritten meanwhile."""
        written = self.written
        start = max(self._next, written - self.header.slots)
        self.missed += start - self._next
        self._next = start
        block = self.read_at(start, min(max_rows, written - start))
        bad = block.first - start
        if bad and start + bad > self.oldest and self._bad_reads < _READ_ATTEMPTS:
            self._bad_reads += 1  # not overwritten: another core's stores are still on their way
            return RowBlock(start, 0, b"")
        overwritten = min(bad, max(0, self.oldest + 1 - start))
        self.missed += overwritten
        self.damaged += bad - overwritten
        self._bad_reads = 0
        self._next = block.first + block.count
        return block

    def read_at(self, first: int, count: int) -> RowBlock:
        """Return the first run of intact rows among `count` rows from index `first`.

        When there is none the block is empty and its `first` is behind them.
        """
        if count <= 0:
            return RowBlock(first, 0, b"")
        copy, intact = self._copy(first, count)
        where = np.flatnonzero(intact)
        if not len(where):
            return RowBlock(first + count, 0, b"")
        begin = int(where[0])
        broken = np.flatnonzero(~intact[begin:])
        end = begin + int(broken[0]) if len(broken) else count
        messages = copy[begin:end, MESSAGE_IN_SLOT : MESSAGE_IN_SLOT + self.header.row_bytes]
        return RowBlock(first + begin, end - begin, messages.tobytes())

    def read_last(self, count: int) -> RowBlock:
        """Return the newest run of intact rows among the last `count` that were written; empty where there is none.

        What a writer did last is behind a damaged row, not before it.
        """
        end = self.written
        newest = following = self.read_at(max(0, end - count), min(count, end))
        while following.count:
            newest, behind = following, following.first + following.count
            following = self.read_at(behind, end - behind)
        return newest

    def acknowledge(self, index: int) -> None:
        """Tell a writer in lockstep that the rows before `index` are safe and may be overwritten."""
        words.put_word(self._fd, ACKNOWLEDGED_WORD, index)

    def close(self) -> None:
        """Let go of the file.  Safe twice."""
        if self._fd < 0:
            return
        os.close(self._fd)
        self._fd = -1

    def _look(self) -> None:
        written = self._word(WRITTEN_WORD)
        if written > WRITTEN_MAX:
            raise RingError(
                f"{self._path} has a damaged count of rows",
                found=written,
                expected=f"at most {WRITTEN_MAX}",
                remedy="restart the agent",
            )
        self._written = max(self._written, written)

    def _word(self, word: int) -> int:
        return words.word_at(self._fd, 8 * word)

    def _copy(self, first: int, count: int) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Private copy (count, stride) of the slots, and which of them (count,) hold the row they should."""
        header, stride = self.header, self.header.stride
        copy = np.zeros((count, stride), np.uint8)  # what the file has lost stays zero, which is no row's index
        memory = memoryview(copy.data).cast("B")
        done = 0
        while done < count:
            place = (first + done) % header.slots
            some = min(count - done, header.slots - place)
            os.preadv(self._fd, [memory[done * stride : (done + some) * stride]], SLOTS_OFFSET + place * stride)
            done += some
        expected = np.arange(first + 1, first + count + 1, dtype=np.uint64)
        intact = copy[:, :8].copy().view(np.uint64)[:, 0] == expected
        end = MESSAGE_IN_SLOT + header.row_bytes
        stored = copy[:, 8:12].copy().view(np.uint32)[:, 0].tolist()
        for i in np.flatnonzero(intact).tolist():
            row = memory[i * stride + MESSAGE_IN_SLOT : i * stride + end]
            if zlib.crc32(row, (first + i) & 0xFFFFFFFF) != stored[i] or not self._still_holds(first + i):
                intact[i] = False
        return copy, intact

    def _still_holds(self, index: int) -> bool:
        header = self.header
        return words.word_at(self._fd, SLOTS_OFFSET + index % header.slots * header.stride) == index + 1
