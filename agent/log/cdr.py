"""Builds one little-endian CDR message as a template and remembers where its numbers are.

With fixed strings and counts a message has a constant layout: one encoded template, numbers filled in many at a time.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Final

import numpy as np

from agent.telemetry.row.sample import CDR_LITTLE_ENDIAN

_STRING_HEAD: Final = struct.Struct("<II")  # encapsulation, length with the closing zero


class CdrTemplate:
    """Builds one little-endian CDR message and remembers where the numbers are."""

    def __init__(self) -> None:
        self._data = bytearray(b"\0\1\0\0")
        self._names: list[str] = []
        self._formats: list[object] = []
        self._offsets: list[int] = []

    def number(self, name: str, code: str, count: int = 0, start: Sequence[float] = ()) -> CdrTemplate:
        """A number, or a fixed array of `count`; `code` is numpy's, such as `<f8`; start: values until it is filled."""
        size = np.dtype(code).itemsize
        self._align(size)
        self._names.append(name)
        self._formats.append((code, (count,)) if count else code)
        self._offsets.append(len(self._data))
        self._data += np.array(start, code).tobytes() if start else bytes(size * max(count, 1))
        return self

    def given(self, code: str, values: Sequence[float]) -> CdrTemplate:
        """Numbers that never change."""
        numbers = np.array(values, code)
        self._align(numbers.itemsize)
        self._data += numbers.tobytes()
        return self

    def length(self, count: int) -> CdrTemplate:
        """Number of elements of a sequence, which the caller adds."""
        self._align(4)
        self._data += struct.pack("<I", count)
        return self

    def string(self, text: str) -> CdrTemplate:
        """A string that never changes."""
        encoded = text.encode() + b"\0"
        self.length(len(encoded))
        self._data += encoded
        return self

    def header(self, prefix: str, frame: str) -> CdrTemplate:
        """std_msgs/Header whose stamp is filled in."""
        return self.number(f"{prefix}stamp", "<u4", 2).string(frame)

    @property
    def message(self) -> bytes:
        """The encoded message as it starts."""
        return bytes(self._data)

    @property
    def dtype(self) -> np.dtype[np.void]:
        """The message as a numpy record."""
        return np.dtype(
            {
                "names": self._names,
                "formats": self._formats,
                "offsets": self._offsets,
                "itemsize": len(self._data),
            }
        )

    def _align(self, size: int) -> None:
        self._data += bytes((4 - len(self._data)) % size)


def stamp_of(utc_ns: int) -> tuple[int, int]:
    """A time as ROS has it: seconds and nanoseconds."""
    return divmod(utc_ns, 1_000_000_000)


def text_message(text: bytes) -> bytes:
    """std_msgs/String of a UTF-8 text.  (JSON channels would be simpler, but ROS tools refuse a file that has one.)"""
    return _STRING_HEAD.pack(CDR_LITTLE_ENDIAN, len(text) + 1) + text + b"\0"


def text_of(message: bytes) -> bytes:
    """The text of a std_msgs/String.  Raises ValueError when it is none."""
    if len(message) <= _STRING_HEAD.size or message[-1]:
        raise ValueError("not a string message")
    head, length = _STRING_HEAD.unpack_from(message)
    if head != CDR_LITTLE_ENDIAN or _STRING_HEAD.size + length != len(message):
        raise ValueError("not a string message")
    return message[_STRING_HEAD.size : -1]
