"""A pseudo terminal at a stable path that any serial client can open, close and open again.

Linux only: the client's speed is read from the terminal itself.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import re
import struct
import termios
import tty
from pathlib import Path

from drivers.interface import Refusal

_CHUNK = 4096
_TCGETS2 = 0x802C542A  # the only request that tells speeds outside the standard constants (4.5 Mbit/s)
_TERMIOS2 = struct.Struct("<4IB19s2I")
_PTY = re.compile(r"/dev/pts/[0-9]+")


class PortTakenError(Refusal):
    """What has the name of an emulated port is somebody else's."""


class PtyPort:
    """One emulated serial port.  The link points to a terminal from `appear` until `vanish`."""

    def __init__(self, link: Path) -> None:
        self.link = link
        self.overrun_bytes = 0  # a client that does not read loses what does not fit its terminal's buffer
        self._master = -1
        self._slave = -1

    @property
    def present(self) -> bool:
        """True while the port exists."""
        return self._master >= 0

    def fileno(self) -> int:
        """File to wait on; -1 while the port is gone."""
        return self._master

    def appear(self) -> None:
        """Create the terminal and point the link to it, in the place of an earlier one's.  Nothing when already there.

        Raises PortTakenError where something else has that name, OSError.
        """
        if self.present:
            return
        self._require_free()
        # our own hold on the client's side keeps the master readable between clients
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.link.parent.mkdir(parents=True, exist_ok=True)
        fresh = self.link.with_name(f".{self.link.name}.{os.getpid()}")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(os.ttyname(self._slave))
        fresh.replace(self.link)

    def _require_free(self) -> None:
        """Refuse a name that may be a real port's; a link to a pseudo terminal is what a killed emulator leaves.

        Raises PortTakenError.
        """
        if self.link.is_symlink():
            target = str(self.link.readlink())
            found = "" if _PTY.fullmatch(target) else f"a link to {target}"
        else:
            found = "something that is no link" if self.link.exists() else ""
        if found:
            raise PortTakenError(
                f"emulated port {self.link}", found=found, expected="a free name, or what an earlier emulator has left",
                remedy="remove it, or name another folder with --ports",
            )  # fmt: skip

    def vanish(self) -> None:
        """Remove link and terminal; clients that have it open get an I/O error.  Safe twice."""
        if not self.present:
            return
        with contextlib.suppress(FileNotFoundError):
            if self.link.readlink() == Path(os.ttyname(self._slave)):
                self.link.unlink()
        os.close(self._slave)
        os.close(self._master)
        self._master = self._slave = -1

    def baud(self) -> int:
        """Speed the client set, bit/s."""
        return int(_TERMIOS2.unpack(fcntl.ioctl(self._slave, _TCGETS2, bytes(_TERMIOS2.size)))[7])

    def forget_exclusive(self) -> None:
        """Clear the client's TIOCEXCL, which our hold would keep alive after the client has died."""
        fcntl.ioctl(self._slave, termios.TIOCNXCL)

    def read(self) -> bytes:
        """Return what clients wrote; b"" when nothing."""
        try:
            return os.read(self._master, _CHUNK)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        """Give bytes to the client; what its buffer cannot take is lost and counted, as on a real port."""
        try:
            written = os.write(self._master, data)
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.EIO):
                raise
            written = 0
        self.overrun_bytes += len(data) - written
