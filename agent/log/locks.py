"""Who has a log: who writes it, and who mends or removes it.  Somebody who may only read it takes none of it away.

A `flock` needs no right to write, and a lock for reading keeps one for writing off.  So a log is locked before anybody
else can open it, who asks takes no lock, and whoever else must be alone locks a file that is closed to others.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from agent.atomic import umask
from agent.host.flock import lock
from agent.telemetry.ring import file as ring_file

SUFFIX: Final = ".repairing"


def create_written(path: Path) -> int:
    """Descriptor of a new file that this process writes, until it closes it.  Raises OSError."""
    fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    if not ring_file.lock(fd):
        raise AssertionError("nobody else can open this file")
    with suppress(PermissionError):  # of a file system that has no modes
        os.fchmod(fd, 0o644 & ~umask())
    return fd


def is_written(fd: int) -> bool:
    """Whether a process writes this file, as `create_written` has begun it; asks without taking a lock."""
    return ring_file.is_locked(fd)


def open_closed(path: Path) -> int:
    """Descriptor of a file that is made where it is missing, and that only this user can open.  Raises OSError."""
    fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    with suppress(PermissionError):
        os.fchmod(fd, 0o600)  # an earlier version has left it open to readers
    return fd


def lock_path(folder: Path, cell: str) -> Path:
    """What a recorder of the cell locks while it records into the folder; closed to others, who could lock it too."""
    return folder / f".{cell}.recording"


def note_path(folder: Path, cell: str) -> Path:
    """What such a recorder notes, for whoever reads the logs."""
    return folder / f".{cell}.noted"


@contextmanager
def alone_with(log: Path) -> Iterator[int | None]:
    """Mend or remove a log for the time of the block, and nobody else does.  Raises OSError.

    Gives an empty file beside it, which can take its place and else is gone afterwards; None where another has it.
    """
    beside = log.with_name(log.name + SUFFIX)
    fd = open_closed(beside)
    try:
        if not lock(fd) or not is_named(beside, fd):  # by now it may be the log that another one has mended
            yield None
            return
        try:
            os.ftruncate(fd, 0)
            yield fd
        finally:
            if is_named(beside, fd):
                beside.unlink()
    finally:
        os.close(fd)


def is_named(path: Path, fd: int) -> bool:
    """Whether the open file still has this name."""
    try:
        return os.path.samestat(path.stat(), os.fstat(fd))
    except FileNotFoundError:
        return False
