"""The disk under a log: what is written to it, when that is safe, and how much room is left."""

from __future__ import annotations

import errno
import os
import threading
from pathlib import Path
from typing import Final

SYNC_S: Final = 1.0


class Sink:
    """What the MCAP writer writes to: straight to the descriptor, and it knows how far all was well."""

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self.position = 0
        self.good = 0

    def write(self, data: bytes | bytearray) -> None:
        """All of it.  Raises OSError."""
        view = memoryview(data)
        while view:
            count = os.write(self._fd, view)
            self.position += count
            view = view[count:]


class Syncer:
    """fdatasync once a second in a thread of its own: a disk that takes seconds must not stop the receiving."""

    def __init__(self, fd: int) -> None:
        self.error: OSError | None = None
        self._fd = os.dup(fd)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="log-sync", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread.  Safe twice."""
        if not self._stop.is_set():
            self._stop.set()
            self._thread.join()
            os.close(self._fd)

    def _run(self) -> None:
        while not self._stop.wait(SYNC_S):
            try:
                os.fdatasync(self._fd)
            except OSError as error:
                self.error = error
                return


def free_bytes(where: Path | int) -> int:
    """Left on the disk of a folder or an open file."""
    found = os.statvfs(where)
    return found.f_bavail * found.f_frsize


def has_a_name(fd: int, path: Path) -> bool:
    """Whether the open file that was at `path` is still somewhere, there or where it was moved."""
    return os.fstat(fd).st_nlink > 0 or os.path.lexists(path)  # some file systems count no names


def require_a_name(fd: int, path: Path) -> None:
    """Raise FileNotFoundError where the open file that was at `path` has been removed; one that was moved is there."""
    if not has_a_name(fd, path):
        raise FileNotFoundError(errno.ENOENT, "somebody has removed it")


def sync_directory(directory: Path) -> None:
    """Have the names in it on the disk."""
    fd = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
