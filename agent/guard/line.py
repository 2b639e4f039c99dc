"""The line between an agent and its guard: a Unix socket that carries words and descriptors, on one host.

The agent says: give me the port; watch me; I am busy for a moment; I leave; go on without me.  `busy` has no answer,
every other word has one; an agent waits for that of `take` while it holds.
"""

from __future__ import annotations

import array
import contextlib
import json
import os
import socket
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from drivers.interface import Refusal

MAX_BYTES = 1 << 16
MAX_FDS = 5


class GuardError(Refusal):
    """Agent and guard do not come together."""

    exit_code = 7


class Word(StrEnum):
    """What an agent can say."""

    PORT = "port"  # lend me the port; `again`: the one I had is gone
    WATCH = "watch"  # torque is on: from now on go on when I cannot
    BUSY = "busy"  # no row for so long
    LEAVE = "leave"  # torque is off: let go of my ring
    TAKE = "take"  # I end, and the object is held: go on


@dataclass(frozen=True, slots=True)
class Said:
    """One message, with the descriptors that came with it; who takes it closes them."""

    word: Word
    content: Mapping[str, Any]
    fds: tuple[int, ...]

    def drop(self) -> None:
        """Close the descriptors."""
        close_all(self.fds)


def close_all(fds: Sequence[int]) -> None:
    """Close descriptors that nobody wants."""
    for fd in fds:
        with contextlib.suppress(OSError):
            os.close(fd)


def received(end: socket.socket) -> tuple[bytes, tuple[int, ...]]:
    """One message and its descriptors, none of them for a program that is started later (`recv_fds` forgets that)."""
    fds = array.array("i")
    data, others, _, _ = end.recvmsg(MAX_BYTES, socket.CMSG_LEN(MAX_FDS * fds.itemsize), socket.MSG_CMSG_CLOEXEC)
    for level, kind, content in others:
        if (level, kind) == (socket.SOL_SOCKET, socket.SCM_RIGHTS):
            fds.frombytes(content[: len(content) - len(content) % fds.itemsize])
    return data, tuple(fds)


def understood(data: bytes, fds: tuple[int, ...], fingerprint: str) -> Said | dict[str, Any]:
    """The message, or what to answer."""
    try:
        content = json.loads(data)
        word, theirs = Word(content["word"]), str(content["fingerprint"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return {
            "ok": False, "found": repr(data[:80]), "expected": f"one of {', '.join(Word)}",
            "remedy": "start agent and guard from one release",
        }  # fmt: skip
    if theirs != fingerprint:
        return {
            "ok": False, "found": f"cell {theirs[:12]}", "expected": f"cell {fingerprint[:12]}",
            "remedy": "give both the same file",
        }  # fmt: skip
    return Said(word, content, fds)
