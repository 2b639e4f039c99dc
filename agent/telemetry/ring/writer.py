"""The writing end of the ring between control thread and telemetry: a commit waits for no reader.

A row is committed when it lies in its slot with index and checksum and `written` counts it; a writer that is killed in
between leaves a row that no reader believes (`reader.py`).  The file survives its writer: the black box.  One that is
cut under its writer ends that process (SIGBUS); what goes on then maps nothing (`heir.py`).
"""

from __future__ import annotations

import mmap
import os
import struct
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from agent.telemetry.ring import file as ring_file
from agent.telemetry.ring.file import (
    ACKNOWLEDGED_WORD,
    FINISHED_WORD,
    MESSAGE_IN_SLOT,
    SLOTS_OFFSET,
    WRITTEN_WORD,
    RingError,
    RowFormat,
)
from agent.telemetry.row.sample import CDR_LITTLE_ENDIAN

DEFAULT_SLOTS: Final = 8192  # 41 s at 200 Hz, 16 s at 500 Hz; how large files are: `file_bytes`, docs/install.md
LOCKSTEP_TIMEOUT_S: Final = 30.0
_POLL_S: Final = 0.0002
_LOOK_S: Final = 0.02


def file_bytes(row_format: RowFormat, slots: int = DEFAULT_SLOTS) -> int:
    """Size of a ring's file."""
    return ring_file.make_header(row_format, slots=slots, name="", joints=(), created_ns=0).file_bytes


class RowsUntaken(RingError):
    """In lockstep nobody has taken the rows of a run in time, which ends it."""

    exit_code = 4


class RingWriter:
    """The writing end, for the control thread: fill `row` in place, call `commit`.

    `row` stays the same object for the whole life of the writer, so views of its fields may be taken once and kept.
    """

    def __init__(
        self, path: Path, row_format: RowFormat, name: str, joints: tuple[str, ...] = (), *, slots: int = DEFAULT_SLOTS
    ) -> None:
        """Create the ring at `path` (mode 0640) and take its lock.

        An unfinished ring of an earlier run is kept beside it as `<path>.previous`: it is that run's black box.
        Raises RingError when another writer is alive, or the memory is not there.
        """
        header = ring_file.make_header(row_format, slots=slots, name=name, joints=joints, created_ns=time.time_ns())
        try:
            fd = ring_file.claim(path, header)
        except OSError as error:
            raise RingError(
                f"cannot create the telemetry ring {path}",
                found=error.strerror,
                expected=f"a writable directory with {header.file_bytes >> 20} MB free",
                remedy="create the directory, or free space",
            ) from error
        self._fd = fd
        self.header = header
        at_once = mmap.MAP_SHARED | mmap.MAP_POPULATE  # all its pages, so that none is missing in the loop
        self._map = mmap.mmap(fd, header.file_bytes, at_once)
        self._bytes = memoryview(self._map)
        self._words = self._bytes.cast("Q")
        self._pack_slot_head = struct.Struct("=QI").pack_into
        self.row, self._staged = aligned_row(row_format.dtype)
        self.row["encapsulation"] = CDR_LITTLE_ENDIAN
        self.written = 0
        self.asked: Callable[[], bool] = lambda: False  # for something else than to wait for space

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def fileno(self) -> int:
        """Descriptor of the file, lock and all, for a process that may have to go on with it."""
        return self._fd

    def commit(self) -> None:
        """Make `row` visible as the next row.  One copy and one checksum; waits for nobody."""
        index = self.written
        header = self.header
        slot = SLOTS_OFFSET + index % header.slots * header.stride
        word = slot >> 3
        self._words[word] = 0  # a writer killed between here and the last store leaves a row nobody believes
        start = slot + MESSAGE_IN_SLOT
        self._bytes[start : start + header.row_bytes] = self._staged
        self._pack_slot_head(self._bytes, slot, index + 1, zlib.crc32(self._staged, index & 0xFFFFFFFF))
        self.written = index + 1
        self._words[WRITTEN_WORD] = index + 1

    def wait_for_space(self, timeout_s: float = LOCKSTEP_TIMEOUT_S) -> None:
        """Lockstep simulation only: wait until less than half the ring is unacknowledged, or this process is `asked`.

        Raises RowsUntaken when that takes longer than `timeout_s`: telemetry is missing or stuck.
        """
        enough = self.header.slots // 2
        if self.written - self._words[ACKNOWLEDGED_WORD] < enough:
            return
        now = look = time.monotonic()
        deadline = now + timeout_s
        while (waiting := self.written - self._words[ACKNOWLEDGED_WORD]) >= enough:
            now = time.monotonic()
            if now >= look:
                if self.asked():
                    return
                look = now + _LOOK_S
            if now >= deadline:
                raise RowsUntaken(
                    f"the telemetry of {self.header.name} does not keep up",
                    found=f"{waiting} rows waiting for {timeout_s:g} s",
                    expected=f"fewer than {enough}",
                    remedy="start `coop telemetry` and `coop record`, or see why they stand still",
                )
            time.sleep(_POLL_S)

    def finish(self) -> None:
        """Say that no row will follow."""
        self._words[FINISHED_WORD] = 1

    def close(self) -> None:
        """Unmap and give the lock back; the file stays for its readers.  Safe twice."""
        if self._fd < 0:
            return
        self._words.release()
        self._bytes.release()
        self._map.close()
        os.close(self._fd)
        self._fd = -1


def aligned_row(dtype: np.dtype[np.void]) -> tuple[NDArray[np.void], memoryview]:
    """One zeroed row whose payload, behind the 4-byte header, is 8-byte aligned, and its bytes."""
    memory = np.zeros(dtype.itemsize + 16, np.uint8)
    offset = (4 - memory.ctypes.data) % 8
    raw = memory[offset : offset + dtype.itemsize]
    return raw.view(dtype).reshape(()), raw.data
