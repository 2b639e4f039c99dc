"""Readiness and life signs to the service manager (sd_notify), lost rather than waited for or stumbled over."""

from __future__ import annotations

import array
import contextlib
import os
import socket
from collections.abc import MutableMapping

FIRST_FD = 3  # of those that a service manager hands over
LOADING_US = 60_000_000  # in place of the watchdog's interval, while a process that is `loading` strokes nothing
BUSY_US = 1_000_000  # likewise while it is `busy`


def stored_fds(environment: MutableMapping[str, str] = os.environ) -> dict[str, int]:
    """Descriptors that the service manager kept for this process, by name; asked once, for they are then its own."""
    count, pid = environment.pop("LISTEN_FDS", "0"), environment.pop("LISTEN_PID", "")
    names = environment.pop("LISTEN_FDNAMES", "").split(":")
    if pid != str(os.getpid()) or not count.isdigit():
        return {}
    found = {}
    for fd, name in zip(range(FIRST_FD, FIRST_FD + int(count)), names, strict=False):
        os.set_inheritable(fd, False)
        found[name] = fd
    return found


class Notifier:
    """Datagrams to $NOTIFY_SOCKET; silent outside systemd."""

    def __init__(self, address: str | None = None) -> None:
        path = address if address is not None else os.environ.get("NOTIFY_SOCKET", "")
        self._is_longer = False  # the watchdog's interval than the unit's
        self._watchdog_us = os.environ.get("WATCHDOG_USEC", "")  # the unit's interval; empty without one
        self._socket: socket.socket | None = None  # not connected: who comes back under that name is told again
        self._address = "\0" + path[1:] if path.startswith("@") else path
        if path:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as probe:
                probe.connect(self._address)
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)

    def send(self, state: str) -> None:
        """Send one state line, e.g. "READY=1"; a full queue loses it, which the watchdog interval allows for.

        So does a service manager that is gone: whoever holds an arm goes on.
        """
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(state.encode(), self._address)

    def keep(self, name: str, fd: int) -> None:
        """Let the service manager keep a descriptor for this service's next process, in the place of an older one."""
        if self._socket is not None:
            self.send(f"FDSTOREREMOVE=1\nFDNAME={name}")
            rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", [fd]))]
            with contextlib.suppress(OSError):
                self._socket.sendmsg([f"FDSTORE=1\nFDNAME={name}".encode()], rights, 0, self._address)

    def loading(self, status: str) -> None:
        """Tell that units ordered behind this one may start; `ready`, or the first stroke, begins the watchdog."""
        self.send(f"READY=1\nSTATUS={status}{self._watched_every(str(LOADING_US))}")
        self._is_longer = True

    def ready(self, status: str) -> None:
        """Tell that start-up is over, with a line for `systemctl status`."""
        self.send(f"READY=1\nSTATUS={status}{self._watched_every(self._watchdog_us)}")
        self._is_longer = False

    def alive(self) -> None:
        """Stroke the watchdog."""
        self.send("WATCHDOG=1" + (self._watched_every(self._watchdog_us) if self._is_longer else ""))
        self._is_longer = False

    def busy(self) -> None:
        """Stroke the watchdog before what may take some tenths of a second; the next stroke comes after it."""
        self.send("WATCHDOG=1" + self._watched_every(str(BUSY_US)))
        self._is_longer = True

    def _watched_every(self, microseconds: str) -> str:
        """The line that sets the watchdog's interval, where the unit has one."""
        return f"\nWATCHDOG_USEC={microseconds}" if self._watchdog_us else ""

    def stopping(self, status: str) -> None:
        """Tell that the process is on its way out."""
        self.send(f"STOPPING=1\nSTATUS={status}")

    def close(self) -> None:
        """Give the socket back; twice is fine, and what is sent afterwards is lost."""
        if self._socket is not None:
            self._socket.close()
