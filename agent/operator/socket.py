"""How an operator commands an agent: a Unix socket on the agent's own host, for its own user and root.

There are three words: start (follow the trajectory from an instant on), stop (hold the object) and release.  The last
two can be said by signals too (agent.host.signals); the network carries none of them.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import struct
import time
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from drivers.interface import Refusal

_CREDENTIALS = struct.Struct("3i")  # pid, uid, gid
_MAX_BYTES = 2048
_CLIENTS_MAX = 8
REPLY_TIMEOUT_S = 2.0


class ControlError(Refusal):
    """An operator's request was not accepted."""

    exit_code = 7


class Verb(StrEnum):
    """What an operator can ask for."""

    START = "start"  # follow the trajectory from a common instant on
    STOP = "stop"  # hold the object where it is
    RELEASE = "release"  # the object is supported: torque off


@dataclass
class Requests:
    """What has been asked for so far."""

    start_utc_ns: int | None = None
    stopped: bool = False
    released: bool = False


class ControlSocket:
    """The agent's end; `poll` is one system call when nobody asks."""

    def __init__(self, path: Path, fingerprint: str) -> None:
        """Listen at `path` (mode 0600), in the place of a socket that nobody serves.  Raises ControlError."""
        self._path = path
        self._fingerprint = fingerprint
        self.requests = Requests()
        self._clients: list[socket.socket] = []
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_CLOEXEC)
        self._socket.setblocking(False)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.is_socket():  # of an agent that has ended: the ring's lock has already refused a second one
                path.unlink(missing_ok=True)
            self._socket.bind(str(path))
            path.chmod(0o600)
            self._socket.listen(_CLIENTS_MAX)
        except OSError as error:
            self._socket.close()
            raise ControlError(
                f"control socket {path}", found=error.strerror, expected="a free name in a folder that can be written",
                remedy="name another with --control",
            ) from error  # fmt: skip

    def poll(self) -> None:
        """Take what operators have asked for since the last call; never blocks."""
        with contextlib.suppress(BlockingIOError):
            while True:
                client, _ = self._socket.accept()
                client.setblocking(False)
                self._clients.append(client)
        if self._clients:
            self._clients = [client for client in self._clients[-_CLIENTS_MAX:] if not self._served(client)]

    def _served(self, client: socket.socket) -> bool:
        """Answer one client; False while it has not said anything yet."""
        try:
            data = client.recv(_MAX_BYTES)
        except BlockingIOError:
            return False
        except OSError:
            data = b""
        with contextlib.suppress(OSError):  # who asked is gone
            if data:
                credentials = client.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
                client.send(json.dumps(self._answer(data, _CREDENTIALS.unpack(credentials)[1])).encode())
        client.close()
        return True

    def _answer(self, data: bytes, uid: int) -> dict[str, Any]:
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
        return {"ok": True}

    def close(self) -> None:
        """Remove the socket; twice is fine."""
        for client in self._clients:
            client.close()
        self._socket.close()
        self._path.unlink(missing_ok=True)


def ask(path: Path, verb: Verb, **content: Any) -> None:
    """Send one request to the agent at `path` and wait for its answer.  Raises ControlError."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as own:
        own.settimeout(REPLY_TIMEOUT_S)
        try:
            own.connect(str(path))
            own.send(json.dumps({"verb": verb.value, **content}).encode())
            answer = json.loads(own.recv(_MAX_BYTES))
        except (OSError, ValueError) as error:
            found = getattr(error, "strerror", None) or "no answer"
            raise ControlError(
                f"agent at {path}", found=found, expected="an agent that answers", remedy="start it, or see its log"
            ) from error
    if not answer.pop("ok", False):
        raise ControlError(f"agent at {path} refuses to {verb.value}", **answer)


def _refused(found: str, expected: str, remedy: str) -> dict[str, Any]:
    return {"ok": False, "found": found, "expected": expected, "remedy": remedy}
