"""The guard's end of the line: it listens for one agent of its own user, and tells everybody else why not."""

from __future__ import annotations

import contextlib
import json
import os
import socket
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from agent.guard.line import MAX_BYTES, GuardError, Said, Word, close_all, received, understood
from agent.host.unix_socket import listen_alone, remove, said_of
from drivers.interface import Refusal
from drivers.peer import peer_uid

REFUSED_MAX = 4
BACKLOG = 2


class GuardEnd:
    """The guard's end: one agent at a time, of the guard's own user, with the same cell file."""

    def __init__(self, path: Path, fingerprint: str) -> None:
        """Listen at `path` (mode 0600), in the place of a socket that nobody serves.  Raises GuardError."""
        self._path = path
        self._fingerprint = fingerprint
        self._agent: socket.socket | None = None
        self._refused: list[socket.socket] = []
        self._heard: Word | None = None  # to which the next answer is
        try:
            taken = listen_alone(path, BACKLOG)
        except OSError as error:
            raise GuardError(
                f"guard socket {path}", found=said_of(error), expected="a free name in a folder that can be written",
                remedy="name another with --socket",
            ) from error  # fmt: skip
        if taken is None:
            raise GuardError(
                f"guard socket {path}", found="another guard", expected="one per arm", remedy="stop it first"
            )
        self._listening, self._made = taken

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def filenos(self) -> list[int]:
        """Descriptors to wait on."""
        return [end.fileno() for end in (self._listening, self._agent) if end is not None]

    def hear(self) -> Said | None:
        """The next word of the agent, None while there is none.  Never blocks; strangers are told why not."""
        self._accept()
        if self._refused:
            self._drop_refused()
        agent = self._agent
        if agent is None:
            return None
        try:
            data, fds = received(agent)
        except BlockingIOError:
            return None
        except OSError:
            data, fds = b"", ()
        if not data:
            self.hang_up()
            return None
        said = understood(data, fds, self._fingerprint)
        self._heard = said.word if isinstance(said, Said) else None
        if isinstance(said, Said):
            return said
        close_all(fds)
        self._reply(said)
        return None

    def answer(self, fds: Sequence[int] = ()) -> None:
        """Say yes."""
        self._reply({"ok": True}, fds)

    def refuse(self, error: Refusal) -> None:
        """Say no, and why."""
        why = {"found": str(error.found), "expected": str(error.expected), "remedy": error.remedy}
        self._reply({"ok": False, "what": error.what, **why})

    def hang_up(self) -> None:
        """Let the agent go."""
        if self._agent is not None:
            self._agent.close()
            self._agent = None

    def close(self) -> None:
        """Remove the socket.  Safe twice."""
        self.hang_up()
        for caller in self._refused:
            caller.close()
        self._listening.close()
        remove(self._path, self._made)

    def _accept(self) -> None:
        try:
            caller, _ = self._listening.accept()
        except OSError:
            return
        uid = peer_uid(caller)
        if self._agent is None and uid in (0, os.getuid()):
            caller.setblocking(False)
            self._agent = caller
            return
        found = f"user {uid}" if uid not in (0, os.getuid()) else "a second agent"
        refused = {"ok": False, "found": found, "expected": f"one agent, of user {os.getuid()}", "remedy": "stop one"}
        with contextlib.suppress(OSError):
            caller.send(json.dumps(refused).encode(), socket.MSG_DONTWAIT)
        caller.setblocking(False)
        self._refused.append(caller)

    def _drop_refused(self) -> None:
        """Close who was refused once it hangs up: earlier, what it still says would hide from it why."""
        for caller in list(self._refused):
            data = b""
            with contextlib.suppress(ConnectionError):
                try:
                    data = caller.recv(MAX_BYTES)
                except BlockingIOError:
                    data = b"silent"
            if not data or len(self._refused) > REFUSED_MAX:
                caller.close()
                self._refused.remove(caller)

    def _reply(self, answer: Mapping[str, Any], fds: Sequence[int] = ()) -> None:
        if self._agent is None:
            return
        to = {} if self._heard is None else {"to": self._heard.value}
        try:
            socket.send_fds(self._agent, [json.dumps({**answer, **to}).encode()], list(fds), socket.MSG_DONTWAIT)
        except OSError:  # it does not listen: its process or its rows will tell
            return
