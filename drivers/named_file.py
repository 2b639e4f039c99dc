"""What is in a file that somebody names; the one home of it, for configuration and for faults of emulated servos.

Only a regular file is opened: of a pipe one would wait for a writer, and of a device there may be no end.
"""

from __future__ import annotations

import stat
from pathlib import Path
from typing import Final

from drivers.interface import Refusal

LARGEST_BYTES: Final = 16_000_000


class UnfitFile(Refusal):
    """A device, a pipe, a folder, or a file that is larger than any that is meant."""

    def __init__(self, path: Path, found: str) -> None:
        expected = f"a file of at most {LARGEST_BYTES / 1e6:.0f} MB"
        super().__init__(f"file {path}", found=found, expected=expected, remedy="name the file itself")


def size_of(path: Path) -> int:
    """Bytes of a regular file.  Raises UnfitFile, OSError, and ValueError for a name with a zero byte."""
    found = path.stat()
    if not stat.S_ISREG(found.st_mode):
        raise UnfitFile(path, "no regular file")
    return found.st_size


def read(path: Path) -> bytes:
    """The whole file.  Raises UnfitFile, OSError, and ValueError for a name with a zero byte."""
    size = size_of(path)
    if size > LARGEST_BYTES:
        raise UnfitFile(path, f"{size / 1e6:.0f} MB")
    return path.read_bytes()
