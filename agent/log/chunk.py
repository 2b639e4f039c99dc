"""A chunk of an MCAP file while it is filled: message records as arrays, and where each message is.

Messages of constant size become records by array copies, many at a time.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

_WHICH: Final[list[tuple[str, str]]] = [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2")]
_WHEN: Final[list[tuple[str, str]]] = [("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8")]
HEAD: Final = np.dtype(_WHICH + _WHEN)  # of a message record; the message follows
WHICH: Final = np.dtype(_WHICH)  # the part of it that messages of a channel share
WHEN: Final = np.dtype(_WHEN)
RECORD_HEAD_BYTES: Final = 9  # opcode and length, which counts what is behind it
LIBRARY: Final = "widowx-coop"  # who wrote a log, by its head
LOG_TIME_AT: Final = RECORD_HEAD_BYTES + 6  # behind channel and sequence


class Message(NamedTuple):
    """One kind of message of constant size."""

    channel: int
    dtype: np.dtype[Any]
    template: bytes = b""  # encoded message whose numbers the caller fills in; empty: the caller gives every byte


class Group:
    """Messages that are written together, one of each kind at a time."""

    def __init__(self, messages: Sequence[Message]) -> None:
        """`messages`: at least one; all with a template, or a single one without."""
        fields: list[Any] = []
        template = b""
        for i, m in enumerate(messages):
            fields += [(f"which{i}", WHICH), (f"when{i}", WHEN), (f"message{i}", m.dtype)]
            length = HEAD.itemsize - RECORD_HEAD_BYTES + m.dtype.itemsize
            head = struct.pack("<BQH", Opcode.MESSAGE, length, m.channel)
            template += head.ljust(HEAD.itemsize, b"\0") + m.template
        self.channels = tuple(m.channel for m in messages)
        self.dtype: np.dtype[np.void] = np.dtype(fields)
        self.template = np.frombuffer(template, np.uint8)  # the beginning of each record
        self.whens = tuple(f"when{i}" for i in range(len(messages)))
        self.names = tuple(f"message{i}" for i in range(len(messages)))
        assert self.dtype.fields is not None
        self.offsets = tuple(self.dtype.fields[f"which{i}"][1] for i in range(len(messages)))


@dataclass(frozen=True, slots=True)
class RecordCopy:
    """Message records one behind the other, as another file has them: channel, time and place (k,) of each."""

    content: bytes
    channels: NDArray[np.int64]
    times: NDArray[np.uint64]
    offsets: NDArray[np.uint64]


@dataclass(frozen=True, slots=True)
class Part:
    """Where messages written together lie in a chunk: the first of each channel, and the distance to the next."""

    times: NDArray[np.uint64]
    first: tuple[tuple[int, int], ...]  # channel and place
    stride: int


class Chunk:
    """The chunk in progress."""

    def __init__(self, chunk_bytes: int) -> None:
        self.buffer = np.empty(chunk_bytes, np.uint8)
        self.clear()

    def clear(self) -> None:
        """Forget everything: the next chunk begins."""
        self.size = 0
        self.parts: list[Part] = []
        self.copies: list[RecordCopy] = []

    def reserve(self, size: int) -> NDArray[np.uint8]:
        """The next so many bytes; those before stay where they are."""
        if self.size + size > len(self.buffer):
            larger = np.empty(self.size + size, np.uint8)
            larger[: self.size] = self.buffer[: self.size]
            self.buffer = larger
        begin, self.size = self.size, self.size + size
        return self.buffer[begin : self.size]

    def index(self) -> dict[int, NDArray[np.uint64]]:
        """The entries (k, 2) of the message index by channel: time and place."""
        pieces: dict[int, list[NDArray[np.uint64]]] = {}
        for part in self.parts:
            distance = np.arange(0, part.stride * len(part.times), part.stride, dtype=np.uint64)
            for channel, first in part.first:
                own = np.empty((len(distance), 2), np.uint64)
                own[:, 0] = part.times
                np.add(distance, np.uint64(first), out=own[:, 1])
                pieces.setdefault(channel, []).append(own)
        for copy in self.copies:
            entries = np.stack([copy.times, copy.offsets], axis=1)
            for channel in np.unique(copy.channels).tolist():
                pieces.setdefault(channel, []).append(entries[copy.channels == channel])
        return {channel: np.concatenate(some) for channel, some in pieces.items()}
