"""The line between an agent and its guard: a Unix socket that carries words and descriptors, on one host.

The agent says: give me the port; watch me; I am busy for a moment; I leave; go on without me.  `busy` and
`take` have no answer, every other word has one.
"""

from __future__ import annotations

import array
import contextlib
import json
import os
import socket
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Self

from drivers.interface import Refusal

MAX_BYTES = 1 << 16
MAX_FDS = 4
REFUSED_MAX = 4
REPLY_S = 2.0
_CREDENTIALS = struct.Struct("3i")  # pid, uid, gid


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


class AgentEnd:
    """The agent's end."""

    def __init__(self, path: Path, fingerprint: str, patience_s: float = REPLY_S) -> None:
        """Connect; patience_s: 0 never blocks.  Raises GuardError when nobody listens."""
        self._path = path
        self._fingerprint = fingerprint
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_CLOEXEC)
        self._socket.settimeout(patience_s)
        try:
            self._socket.connect(str(path))
            self._socket.setblocking(False)
        except OSError as error:
            self._socket.close()
            raise GuardError(
                f"guard at {path}", found=error.strerror, expected="the guard of this arm",
                remedy="start it first (`coop guard`), or leave out --guard",
            ) from error  # fmt: skip

    def ask(self, word: Word, fds: Sequence[int] = (), **content: Any) -> tuple[int, ...]:
        """Say a word and wait for the answer; the descriptors that came with it.  Raises GuardError."""
        with contextlib.suppress(GuardError):  # who is refused at the door is told so, and then cannot say it
            self.say(word, fds, **content)
        self._socket.settimeout(REPLY_S)
        try:
            data, got = _received(self._socket)
            answer = json.loads(data)
        except (OSError, ValueError) as error:
            raise self._silent(word) from error
        finally:
            self._socket.setblocking(False)
        if not answer.pop("ok", False):
            close_all(got)
            raise GuardError(f"the guard at {self._path} refuses {word.value!r}", **answer)
        return got

    def say(self, word: Word, fds: Sequence[int] = (), **content: Any) -> None:
        """Say a word and go on; its answer is for `heard`.  Raises GuardError when it cannot be said."""
        message = json.dumps({"word": word.value, "fingerprint": self._fingerprint, **content}).encode()
        try:
            socket.send_fds(self._socket, [message], list(fds))
        except OSError as error:
            raise self._silent(word) from error

    def heard(self) -> Mapping[str, Any] | None:
        """An answer that has come, {} when none has; None when the guard is gone.  Never blocks."""
        try:
            data = self._socket.recv(MAX_BYTES, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return {}
        except OSError:
            return None
        if not data:
            return None
        try:
            answer = json.loads(data)
        except ValueError:
            return None
        return answer if isinstance(answer, dict) else None

    def close(self) -> None:
        """Hang up.  Safe twice."""
        self._socket.close()

    def _silent(self, word: Word) -> GuardError:
        return GuardError(
            f"guard at {self._path}", found=f"no answer to {word.value!r}", expected="an answer",
            remedy="see the guard's log",
        )  # fmt: skip


class GuardEnd:
    """The guard's end: one agent at a time, of the guard's own user, with the same cell file."""

    def __init__(self, path: Path, fingerprint: str) -> None:
        """Listen at `path` (mode 0600), in the place of a socket that nobody serves.  Raises GuardError."""
        self._path = path
        self._fingerprint = fingerprint
        self._agent: socket.socket | None = None
        self._refused: list[socket.socket] = []
        self._listening = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_CLOEXEC)
        self._listening.setblocking(False)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.is_socket():
                _refuse_served(path)
                path.unlink(missing_ok=True)
            self._listening.bind(str(path))
            path.chmod(0o600)
            self._listening.listen(2)
        except GuardError:
            self._listening.close()
            raise
        except OSError as error:
            self._listening.close()
            raise GuardError(
                f"guard socket {path}", found=error.strerror, expected="a free name in a folder that can be written",
                remedy="name another with --guard",
            ) from error  # fmt: skip

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def connected(self) -> bool:
        """Whether an agent is there."""
        return self._agent is not None

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
            data, fds = _received(agent)
        except BlockingIOError:
            return None
        except OSError:
            data, fds = b"", ()
        if not data:
            self.hang_up()
            return None
        said = _understood(data, fds, self._fingerprint)
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
        self._reply({"ok": False, "found": str(error.found), "expected": str(error.expected), "remedy": error.remedy})

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
        if self._listening.fileno() >= 0:
            self._listening.close()
            self._path.unlink(missing_ok=True)

    def _accept(self) -> None:
        try:
            caller, _ = self._listening.accept()
        except OSError:
            return
        uid = _CREDENTIALS.unpack(caller.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size))[1]
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
        try:
            socket.send_fds(self._agent, [json.dumps(answer).encode()], list(fds), socket.MSG_DONTWAIT)
        except OSError:  # it does not listen: its process or its rows will tell
            return


def _received(end: socket.socket) -> tuple[bytes, tuple[int, ...]]:
    """One message and its descriptors, none of them for a program that is started later (`recv_fds` forgets that)."""
    fds = array.array("i")
    data, others, _, _ = end.recvmsg(MAX_BYTES, socket.CMSG_LEN(MAX_FDS * fds.itemsize), socket.MSG_CMSG_CLOEXEC)
    for level, kind, content in others:
        if (level, kind) == (socket.SOL_SOCKET, socket.SCM_RIGHTS):
            fds.frombytes(content[: len(content) - len(content) % fds.itemsize])
    return data, tuple(fds)


def _understood(data: bytes, fds: tuple[int, ...], fingerprint: str) -> Said | dict[str, Any]:
    """The message, or what to answer."""
    try:
        content = json.loads(data)
        word, theirs = Word(content["word"]), str(content["fingerprint"])
    except (ValueError, KeyError, TypeError):
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


def _refuse_served(path: Path) -> None:
    """Raise GuardError when somebody listens there."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_CLOEXEC) as probe:
        try:
            probe.connect(str(path))
        except OSError:
            return
    raise GuardError(f"guard socket {path}", found="another guard", expected="one per arm", remedy="stop it first")
