"""The only way to command an agent: a Unix datagram socket on its own host, for its own user and root.

An operator's words are start, stop and release.  There is none that moves an arm, and none over the network.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import struct
import tempfile
import time
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from drivers.interface import Refusal

_CREDENTIALS = struct.Struct("3i")  # pid, uid, gid
_MAX_BYTES = 2048
REPLY_TIMEOUT_S = 2.0


class ControlError(Refusal):
    """An operator's request was not accepted."""

    exit_code = 7


class Verb(StrEnum):
    """What an operator can ask for."""

    START = "start"  # follow the trajectory from a common instant on
    STOP = "stop"  # hold the object where it is
    RELEASE = "release"  # the object is supported: torque off
    STATUS = "status"


@dataclass
class Requests:
    """What has been asked for so far."""

    start_utc_ns: int | None = None
    stopped: bool = False
    released: bool = False


class ControlSocket:
    """The agent's end; `poll` is one system call when nobody asks."""

    def __init__(self, path: Path, fingerprint: str) -> None:
        """Bind `path` (mode 0600), replacing one that nobody serves.  Raises ControlError."""
        self._path = path
        self._fingerprint = fingerprint
        self.requests = Requests()
        self.status: dict[str, Any] = {}
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
        self._socket.setblocking(False)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.unlink(missing_ok=True)  # the ring's lock has already refused a second agent
            self._socket.bind(str(path))
            path.chmod(0o600)
        except OSError as error:
            self._socket.close()
            raise ControlError(
                f"control socket {path}", found=error.strerror, expected="a folder that can be written",
                remedy="create it, or name another with --control",
            ) from error  # fmt: skip

    def poll(self) -> None:
        """Take what operators have asked for since the last call; never blocks."""
        while True:
            try:
                data, ancillary, _, sender = self._socket.recvmsg(_MAX_BYTES, socket.CMSG_SPACE(_CREDENTIALS.size))
            except BlockingIOError:
                return
            answer = self._answer(data, _uid(ancillary))
            if sender:
                with contextlib.suppress(OSError):  # who asked is gone
                    self._socket.sendto(json.dumps(answer).encode(), sender)

    def _answer(self, data: bytes, uid: int | None) -> dict[str, Any]:
        if uid not in (0, os.getuid()):
            return _refused(f"user {uid}", f"user {os.getuid()} or root", "ask as the agent's user or root")
        try:
            request = json.loads(data)
            verb = Verb(request["verb"])
            fingerprint = str(request.get("fingerprint", ""))
            start_utc_ns = int(request["start_utc_ns"]) if verb is Verb.START else 0
        except (ValueError, KeyError, TypeError):
            return _refused(repr(data[:80]), f"one of {', '.join(Verb)}", "use the `coop` command of the same version")
        if verb is Verb.START:
            if fingerprint != self._fingerprint:
                return _refused(f"cell {fingerprint[:12]}", f"cell {self._fingerprint[:12]}", "give both the same file")
            if start_utc_ns <= time.time_ns():
                return _refused("a start that has passed", "a start in the future", "start all arms again, later")
            self.requests.start_utc_ns = start_utc_ns
        elif verb is Verb.STOP:
            self.requests.stopped = True
        elif verb is Verb.RELEASE:
            self.requests.released = True
        return {"ok": True, **self.status}

    def close(self) -> None:
        """Remove the socket; twice is fine."""
        self._socket.close()
        self._path.unlink(missing_ok=True)


def ask(path: Path, verb: Verb, **content: Any) -> dict[str, Any]:
    """Send one request to the agent at `path` and return its answer.  Raises ControlError."""
    with (
        tempfile.TemporaryDirectory(prefix="coop-ask-") as folder,
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as own,
    ):
        own.settimeout(REPLY_TIMEOUT_S)
        own.bind(f"{folder}/reply")
        try:
            own.sendto(json.dumps({"verb": verb.value, **content}).encode(), str(path))
            answer = json.loads(own.recv(_MAX_BYTES))
        except OSError as error:
            raise ControlError(
                f"agent at {path}", found=error.strerror or "no answer", expected="an agent that answers",
                remedy="start it first, or look into its log",
            ) from error  # fmt: skip
    if not answer.pop("ok", False):
        raise ControlError(f"agent at {path} refuses to {verb.value}", **answer)
    return dict(answer)


def _uid(ancillary: list[tuple[int, int, bytes]]) -> int | None:
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == socket.SCM_CREDENTIALS:
            return int(_CREDENTIALS.unpack(data[: _CREDENTIALS.size])[1])
    return None


def _refused(found: str, expected: str, remedy: str) -> dict[str, Any]:
    return {"ok": False, "found": found, "expected": expected, "remedy": remedy}
