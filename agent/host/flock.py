"""Locks of files and folders by `flock`: taking one, and who has it, as the kernel says, for which none is taken.

Who may read a file can lock it.  So a lock says that somebody has it, and not what he does with it.
"""

from __future__ import annotations

import fcntl
import os
from contextlib import suppress
from pathlib import Path
from typing import Final

_LOCKS: Final = Path("/proc/locks")

File = tuple[int, int, int]  # device (major, minor) and inode


def lock(fd: int) -> bool:
    """Take the lock of an open file or folder; False while another process has it."""
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def file_of(status: os.stat_result) -> File:
    """Which file that is."""
    return os.major(status.st_dev), os.minor(status.st_dev), status.st_ino


def flocks() -> dict[File, int]:
    """Every file that somebody has locked, and the process that did, 0 where it is not seen from here."""
    found = dict[File, int]()
    with suppress(OSError):
        for line in _LOCKS.read_text().splitlines():
            words = line.split()
            if "FLOCK" in words and len(words) > 5 and "->" not in words:
                major, minor, inode = words[5].split(":")
                found[int(major, 16), int(minor, 16), int(inode)] = max(0, int(words[4]))
    return found


def holder(fd: int) -> str:
    """` of process 12 (name)`: who has an open file or folder locked; empty where the kernel does not say."""
    pid = flocks().get(file_of(os.fstat(fd)), 0)
    if not pid:
        return ""
    name = ""
    with suppress(OSError):
        name = f" ({Path(f'/proc/{pid}/comm').read_text().strip()})"
    return f" of process {pid}{name}"
