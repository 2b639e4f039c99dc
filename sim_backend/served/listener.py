"""The plant's address: a Unix socket that only this user can reach; a live server keeps it."""

from __future__ import annotations

import contextlib
import os
import socket
import stat
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from sim_backend.physics.spec import PlantError

LONGEST_PATH_BYTES: Final = 107  # sun_path without its terminating zero
BACKLOG: Final = 16


class ListenError(PlantError):
    """The plant cannot listen where it was told to; nothing was begun."""

    exit_code = 2


class Listener:
    """A listening SOCK_SEQPACKET socket, mode 0600; gone from the file system on the way out.

    Raises ListenError when the path is too long, not a socket, or another plant answers there.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if len(os.fsencode(path)) > LONGEST_PATH_BYTES:
            raise ListenError(
                "socket of the plant",
                found=f"{path} ({len(os.fsencode(path))} bytes)",
                expected=f"at most {LONGEST_PATH_BYTES} bytes",
                remedy="choose a shorter directory",
            )
        _clear(path)
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            os.fchmod(self.socket.fileno(), 0o600)  # before bind: the path is never there with another mode
            self.socket.bind(os.fspath(path))
            self.socket.listen(BACKLOG)
            self.socket.setblocking(False)
            self._inode = path.stat().st_ino
        except OSError as e:
            self.socket.close()
            raise ListenError(
                "socket of the plant",
                found=f"{path}: {e}",
                expected="a path to listen on",
                remedy="check the directory",
            ) from e

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.socket.close()
        with contextlib.suppress(FileNotFoundError):
            if self.path.stat().st_ino == self._inode:  # not the one of a successor
                self.path.unlink()


def _clear(path: Path) -> None:
    """Remove a socket that nobody serves any more.  Raises ListenError when it must not be removed."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(mode):
        raise ListenError(
            "socket of the plant", found=f"{path} is not a socket", expected="a free path", remedy="choose another path"
        )
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as probe:
        probe.setblocking(False)
        try:
            probe.connect(os.fspath(path))
        except ConnectionRefusedError:
            path.unlink(missing_ok=True)
            return
        except BlockingIOError:
            pass  # its queue is full, so it is alive
        except OSError as e:
            raise ListenError(
                "socket of the plant", found=f"{path}: {e}", expected="a free path", remedy="choose another path"
            ) from e
    raise ListenError(
        "socket of the plant",
        found=f"another plant answers at {path}",
        expected="a free path",
        remedy="stop that run, or give this one another socket",
    )
