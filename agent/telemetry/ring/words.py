"""The words in a ring's file, by calls and not by a map: of a file that is cut they are missing, and that is all."""

from __future__ import annotations

import os
import sys

from agent.telemetry.ring.file import RingHeader


def word_at(fd: int, offset: int) -> int:
    """The native 64-bit word there; 0 behind the end of the file."""
    return int.from_bytes(os.pread(fd, 8, offset), sys.byteorder)


def put_word(fd: int, word: int, value: int) -> None:
    """Write one of the words of the file's head.  Raises OSError."""
    os.pwrite(fd, value.to_bytes(8, sys.byteorder), 8 * word)


def cut(fd: int, header: RingHeader) -> str:
    """What is left of the file, where it has been cut; empty otherwise."""
    size = os.fstat(fd).st_size
    return "" if size >= header.file_bytes else f"{size} of {header.file_bytes} bytes"
