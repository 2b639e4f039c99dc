"""The agent's end of what an operator says: a Unix socket on the agent's own host, for its own user and root.

The words are those of agent.operator.table; stop and release can be said by signals too (agent.host.signals), and the
network carries none of them.  A socket that somebody serves is left alone, whoever else wants its name.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from agent.host.unix_socket import WAIT_S, listen_alone, remove, said_of
from agent.modes import Event, Mode
from agent.operator.error import ControlPlaceError
from agent.operator.message import MAX_BYTES, Reply, Request
from agent.operator.promise import Promise
from agent.operator.session_table import SESSION
from agent.operator.table import EVENT_OF, Verb, effect
from drivers.clock import utc_offset_ns
from drivers.peer import peer_uid

_CLIENTS_MAX = 8
_FORWARD = (Verb.START, Verb.APPROACH, Verb.GRASP)  # not on the way back
_MOVES = (*_FORWARD, Verb.LOWER, Verb.PARK)  # by what the cell file says
_SAFE_LATE = (Verb.STOP, Verb.CANCEL)  # an arm that stood still obeys them afterwards too


@dataclass
class Requests:
    """What has been asked for and accepted so far."""

    start: Request | None = None  # the last one; None too once it has been taken back
    lower: Request | None = None  # at an instant; None too once it has been taken back
    words: list[Verb] = field(default_factory=list)  # others, until whoever acts on them has taken them away

    def take(self) -> list[Verb]:
        """The words since the last call."""
        taken, self.words = self.words, []
        return taken


@dataclass
class Standing:
    """How the agent is, as it answers; the agent keeps it up to date."""

    arm: str
    mode: Mode = Mode.OFF
    reason: str = ""  # of a hold or a fault
    # found, expected, remedy: why this agent starts nothing in any mode, nor goes to a grasp
    no_start: Mapping[str, str] | None = None
    rest_s: float = 0.0  # of READY before a start, in which the torque at rest is looked at
    ready_ns: int = 0  # since when it is READY, on CLOCK_MONOTONIC: nobody sets that
    session: Callable[[Event], str] | None = None  # why such an event counts for nothing now; None: there is no session
    alone: Callable[[], str] = str  # why nobody goes on when this agent cannot; empty: somebody does, or none is to
    details: Callable[[], Mapping[str, Any]] = dict  # asked for with each answer

    def enter(self, mode: Mode) -> None:
        """It is in that mode from now on."""
        if mode is Mode.READY:
            self.ready_ns = time.monotonic_ns()
        self.mode = mode


class ControlSocket:
    """The agent's end; `poll` is one system call when nobody asks."""

    def __init__(self, path: Path, fingerprint: str, standing: Standing, wait_s: float = WAIT_S) -> None:
        """Listen at `path` (mode 0600), in the place of a socket that nobody serves.  Raises ControlPlaceError.

        wait_s: for another process that begins in the same folder.
        """
        self.standing = standing
        self.requests = Requests()
        self._path = path
        self._fingerprint = fingerprint
        self._clients: list[socket.socket] = []
        self._promise = Promise()
        try:
            taken = listen_alone(path, _CLIENTS_MAX, wait_s)
        except OSError as error:
            raise ControlPlaceError(
                f"control socket {path}", found=said_of(error), expected="a free name in a folder that can be written",
                remedy="name another with --control",
            ) from error  # fmt: skip
        if taken is None:
            raise ControlPlaceError(
                f"control socket {path}", found="an agent that listens there", expected="none",
                remedy="end that agent first, or name another with --control",
            )  # fmt: skip
        self._socket, self._made = taken
        self._asked = select.poll()  # twenty times as quick as an `accept` that finds nobody
        self._asked.register(self._socket, select.POLLIN)

    def poll(self) -> None:
        """Take what operators have asked for since the last call; never blocks."""
        if self._asked.poll(0):
            self._accept()
        if self._clients:
            silent = [client for client in self._clients if not self._served(client)]
            for client in silent[:-_CLIENTS_MAX]:
                client.close()
            self._clients = silent[-_CLIENTS_MAX:]

    def _accept(self) -> None:
        """Take in everybody who has come."""
        with contextlib.suppress(OSError):  # nobody is left, or this process has no descriptor to spare
            while True:
                client, _ = self._socket.accept()
                client.setblocking(False)
                self._clients.append(client)

    def _served(self, client: socket.socket) -> bool:
        """Answer one client; False while it has not said anything yet."""
        try:
            data = client.recv(MAX_BYTES)
        except BlockingIOError:
            return False
        except OSError:
            data = b""
        with contextlib.suppress(OSError):  # who asked is gone
            if data:
                client.send(self._answer(data, peer_uid(client), waits=_waits(client)).encode())
        client.close()
        return True

    def _answer(self, data: bytes, uid: int, *, waits: bool = True) -> Reply:
        """Take a word, or not; waits: for the answer.  Who has given up was told that this arm did not hear it."""
        if uid not in (0, os.getuid()):
            return self._refused(f"user {uid}", f"user {os.getuid()} or root", "ask as the agent's user or root")
        try:
            request = Request.decode(data)
        except ValueError:
            return self._refused(
                repr(data[:80]), f"one of {', '.join(Verb)}", "use the `coop` command of the same version"
            )
        if not waits and request.verb not in _SAFE_LATE:
            return self._refused("nobody who waits for an answer", "somebody who does", "say it again")
        mode = self.standing.mode
        ask = self.standing.session
        does = effect(request.verb, mode) if ask is None else SESSION[request.verb][mode]
        if not does.accepted:
            return self._refused(f"arm {self.standing.arm} in {mode.name}: {does.does}", "another mode", does.remedy)
        if request.verb is Verb.RELEASE and Verb.STOP in self.requests.words:  # which wins, also where the arm stands
            return self._refused(
                f"arm {self.standing.arm} in {mode.name}: a stop that it has yet to act on", "one that it has acted on",
                "see that the object is supported, and say it again",
            )  # fmt: skip
        alone = self.standing.alone() if request.verb in _FORWARD else ""
        if alone:
            return self._refused(
                f"arm {self.standing.arm} in {mode.name}: {alone}", "a guard that watches it",
                "see the guard's log and have it watch again, or `coop release` and start both anew",
            )  # fmt: skip
        if request.verb is Verb.APPROACH and self.standing.no_start is not None:  # it would grip, and then not carry
            return self._refused(**self.standing.no_start)
        event = Event.STARTED if request.verb is Verb.START else EVENT_OF.get(request.verb)
        not_yet = ask(event) if ask is not None and event is not None else ""
        if not_yet:
            return self._refused(
                f"arm {self.standing.arm} in {mode.name}: {not_yet}", "one that is done", "say it again"
            )
        if request.verb in _MOVES and request.fingerprint != self._fingerprint:
            return self._refused(
                f"cell {request.fingerprint[:12]}", f"cell {self._fingerprint[:12]}",
                "give the file that its agent was started with; stop and release need none",
            )  # fmt: skip
        if request.verb is Verb.START:
            refused = self._no_start(request)
            if refused is not None:
                return refused
        if _has_instant(request):
            refused = self._not_agreed(request)
            if refused is not None:
                return refused
        self._take(request)
        return self._reply(ok=True)

    def _no_start(self, request: Request) -> Reply | None:
        """Why a start is refused in a mode that allows it."""
        start_ns = request.start_utc_ns - utc_offset_ns()
        if start_ns <= time.monotonic_ns():
            return self._refused("a start that has passed", "a start in the future", "start all arms again, later")
        if self.standing.no_start is not None:
            return self._refused(**self.standing.no_start)
        rest_s, least_s = 1e-9 * (start_ns - self.standing.ready_ns), self.standing.rest_s
        if rest_s < least_s:
            return self._refused(
                f"a start {rest_s:.1f} s after READY", f"{least_s:g} s, in which the torque at rest is seen",
                "start all arms again, later",
            )  # fmt: skip
        return None

    def _not_agreed(self, request: Request) -> Reply | None:
        """Why an instant is not taken, or not agreed to, beside another operator's; of a free arm it is agreed to."""
        now_ns = time.monotonic_ns()
        if request.prepare:
            if not self._promise.agree(request.token, request.asked_ns, now_ns):
                return self._refused(
                    "another instant that is just being given", "one operator at a time", "say it again"
                )
        elif not self._promise.covers(request.token, now_ns):
            return self._refused("an instant that it was not asked for", "the one it agreed to last", "say it again")
        return None

    def _take(self, request: Request) -> None:
        """Keep what was accepted for whoever acts on it; of what is only prepared nothing is kept."""
        if request.prepare:
            if request.verb is Verb.CANCEL:
                self._promise.forget(request.token)
            return
        if _has_instant(request):
            self._promise.give()
        if request.verb is Verb.START:
            self.requests.start = request
        elif request.verb is Verb.CANCEL:
            if not self._promise.concerns(request.token):  # what counts here is another operator's
                return
            self._promise.forget(request.token)
            self.requests.start = self.requests.lower = None
            if self.standing.mode in (Mode.TRACK, Mode.LOWER):  # it has come true: what is left is to stop it
                self.requests.words.append(Verb.STOP)
        elif request.verb is Verb.LOWER and request.start_utc_ns:
            self.requests.lower = request
        elif request.verb is not Verb.STATUS:
            if request.verb in (Verb.STOP, Verb.RELEASE):  # who says so wants nothing to move at an instant of before
                self.requests.lower = None
                self._promise.forget()
            self.requests.words.append(request.verb)

    def _reply(self, *, ok: bool, refusal: Mapping[str, str] | None = None) -> Reply:
        own = self.standing
        return Reply(ok, own.arm, own.mode.name, own.reason, self._fingerprint, refusal or {}, own.details())

    def _refused(self, found: str, expected: str, remedy: str) -> Reply:
        return self._reply(ok=False, refusal={"found": found, "expected": expected, "remedy": remedy})

    def close(self) -> None:
        """Remove the socket, if its name is still this one's; twice is fine."""
        for client in self._clients:
            client.close()
        self._socket.close()
        remove(self._path, self._made)


def _has_instant(request: Request) -> bool:
    """Whether it is for all arms at one instant."""
    return request.verb is Verb.START or (request.verb is Verb.LOWER and request.start_utc_ns > 0)


def _waits(client: socket.socket) -> bool:
    """Whether who has asked has not hung up."""
    try:
        return bool(client.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT))
    except BlockingIOError:
        return True
    except OSError:
        return False
