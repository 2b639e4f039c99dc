"""Asks any number of agents at once and waits for all of them until one common time-out."""

from __future__ import annotations

import contextlib
import errno
import selectors
import socket
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from agent.host.paths import held_by_others
from agent.operator.message import MAX_BYTES, Reply, Request

REPLY_TIMEOUT_S = 2.0
_AGAIN_S = 0.005  # how soon an agent is tried again whose queue of clients is full
_LOOK_EVERY_S = 0.05


@dataclass(frozen=True)
class Silence:
    """An agent that gave no answer, and what was found instead of one."""

    found: str
    hung: bool = False  # somebody has the socket open
    nowhere: bool = False  # there is no socket at any of the places of the arm


Heard = Reply | Silence


def ask_arms(
    arms: Mapping[str, Iterable[Path]],
    request: Request,
    timeout_s: float = REPLY_TIMEOUT_S,
    look: Callable[[], None] | None = None,
) -> dict[str, Heard]:
    """Send one request to the agent of every arm, by each of the places where it may listen; what each arm answers.

    Of several places the gravest of those counts where somebody is: who hangs before who refuses, then who says yes.
    Where nobody is at any, the places are named.
    look: as of `ask_sockets`.
    """
    places = {arm: list(paths) for arm, paths in arms.items()}
    heard = ask_sockets([path for paths in places.values() for path in paths], request, timeout_s, look)
    return {arm: _telling({path: heard[path] for path in paths}) for arm, paths in places.items()}


def _telling(heard: Mapping[Path, Heard]) -> Heard:
    """The gravest of what was heard of one arm where somebody is, or what was found where nobody is."""
    gravest = min(heard.values(), key=_rank, default=Silence("no socket"))
    if isinstance(gravest, Silence) and gravest.nowhere:
        return Silence(f"nothing at {' or '.join(map(str, heard))}", nowhere=True)
    return gravest


def _rank(heard: Heard) -> int:
    if isinstance(heard, Reply):
        return 2 if heard.ok else 1
    if heard.hung:
        return 0
    return 4 if heard.nowhere else 3


def ask_sockets(
    paths: Iterable[Path],
    request: Request,
    timeout_s: float = REPLY_TIMEOUT_S,
    look: Callable[[], None] | None = None,
) -> dict[Path, Heard]:
    """Send one request to every socket; replies and silences, none of which delays another.

    look: is called before anything is sent, and while answers are waited for; what it raises ends the asking.
    """
    deadline = time.monotonic() + timeout_s
    heard: dict[Path, Heard] = {}
    waiting: dict[Path, socket.socket] = {}
    todo = list(dict.fromkeys(paths))
    with contextlib.ExitStack() as stack, selectors.DefaultSelector() as selector:
        while True:
            if look is not None:
                look()
            todo = [path for path in todo if not _sent(path, request, stack, selector, waiting, heard)]
            left = deadline - time.monotonic()
            if left <= 0.0 or not (todo or waiting):
                break
            within = _AGAIN_S if todo else left if look is None else _LOOK_EVERY_S
            for key, _ in selector.select(min(left, within)):
                heard[key.data] = _received(waiting.pop(key.data))
                selector.unregister(key.fileobj)
        for path in (*todo, *waiting):
            heard[path] = Silence(f"no answer within {timeout_s:.3g} s", hung=True)
    return heard


def _sent(
    path: Path,
    request: Request,
    stack: contextlib.ExitStack,
    selector: selectors.BaseSelector,
    waiting: dict[Path, socket.socket],
    heard: dict[Path, Heard],
) -> bool:
    """Connect and send without waiting; False when the agent's queue of clients is full."""
    try:
        foreign = held_by_others(path)
    except OSError as error:
        heard[path] = _found_nobody(error)
        return True
    if foreign:
        heard[path] = Silence(foreign)
        return True
    own = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_CLOEXEC))
    own.setblocking(False)
    try:
        own.connect(str(path))
        own.send(request.encode())
    except BlockingIOError:
        own.close()
        return False
    except OSError as error:
        heard[path] = _found_nobody(error)
        return True
    waiting[path] = own
    selector.register(own, selectors.EVENT_READ, path)
    return True


def _found_nobody(error: OSError) -> Silence:
    """What is told of a place where nobody can be asked; a path that is too long has no strerror."""
    return Silence(error.strerror or str(error), nowhere=error.errno == errno.ENOENT)


def _received(own: socket.socket) -> Heard:
    try:
        data = own.recv(MAX_BYTES)
        return Reply.decode(data) if data else Silence("closed without an answer", hung=True)
    except OSError as error:
        return Silence(error.strerror or str(error), hung=True)
    except ValueError:
        return Silence("an answer that makes no sense", hung=True)
