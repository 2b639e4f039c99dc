"""A Unix socket that one process serves: taken over where nobody serves it, and removed while the name is its own."""

from __future__ import annotations

import contextlib
import os
import socket
import time
from collections.abc import Iterator
from errno import ETIMEDOUT
from pathlib import Path

from agent.host.flock import holder, lock

_NO_SERVER = ConnectionRefusedError, FileNotFoundError
WAIT_S = 5.0  # for others that begin in the same folder, which takes each of them some milliseconds
_LOOK_S = 0.01

Identity = tuple[int, int]


def listen_alone(path: Path, backlog: int, wait_s: float = WAIT_S) -> tuple[socket.socket, Identity] | None:
    """A SOCK_SEQPACKET socket that listens at `path` (mode 0600) and never blocks, and which file that is.

    None when somebody serves that name: it is left alone.  Raises OSError, also where somebody keeps the folder locked
    for wait_s.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as undo, _alone_in(path.parent, wait_s):
        if not _remove_unserved(path):
            return None
        own = undo.enter_context(_unconnected())
        own.bind(str(path))
        path.chmod(0o600)
        own.listen(backlog)
        undo.pop_all()
        return own, _identity(path)


def remove(path: Path, made: Identity) -> None:
    """Remove the socket, if its name is still this one's."""
    with contextlib.suppress(OSError):  # gone already
        if _identity(path) == made:
            path.unlink()


def said_of(error: OSError) -> str:
    """What is wrong, in words; a path that is too long for a socket has no strerror."""
    return error.strerror or str(error)


def _identity(path: Path) -> Identity:
    """Which file has this name."""
    status = path.lstat()
    return status.st_dev, status.st_ino


@contextlib.contextmanager
def _alone_in(folder: Path, wait_s: float) -> Iterator[None]:
    """Two processes that begin at once take this folder one after the other; whoever may read it can keep it, too."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        deadline = time.monotonic() + wait_s
        while not lock(descriptor):
            if time.monotonic() >= deadline:
                raise TimeoutError(ETIMEDOUT, f"for {wait_s:g} s a lock{holder(descriptor)} on its folder")
            time.sleep(min(_LOOK_S, wait_s))
        yield
    finally:
        os.close(descriptor)


def _unconnected() -> socket.socket:
    own = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_CLOEXEC)
    own.setblocking(False)
    return own


def _remove_unserved(path: Path) -> bool:
    """Remove what a process that has ended has left; False when one serves it.  Raises OSError."""
    if not path.is_socket():
        return True
    with _unconnected() as probe:
        try:
            probe.connect(str(path))
        except _NO_SERVER:
            path.unlink(missing_ok=True)
            return True
        except BlockingIOError:
            pass  # with a full queue of clients it is served as well
    return False
