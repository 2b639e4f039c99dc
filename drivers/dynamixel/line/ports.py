"""Which serial ports this machine has, who uses one, how one is kept, and why one cannot be opened.  Linux only."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import grp
import os
import stat
import termios
from pathlib import Path

from drivers.dynamixel.errors import PortError

CANDIDATES = ("coop/*", "serial/by-id/*", "ttyDXL*", "ttyUSB*", "ttyACM*")
_GROUP_MAY = stat.S_IRGRP | stat.S_IWGRP
_PTMX, _PTY_MAJORS = os.makedev(5, 2), range(136, 144)


def candidates() -> list[str]:
    """Serial ports of this machine that a servo bus may hang on."""
    return [str(path) for pattern in CANDIDATES for path in sorted(Path("/dev").glob(pattern))]


def require_usable(path: str) -> None:
    """Refuse what a tool cannot use: not there, closed to the user, no serial port, or open elsewhere, locked or not.

    Raises PortError.
    """
    try:
        fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise open_error(path, error) from error
    try:
        require_serial(fd, path)  # before its users: everybody has /dev/null
    finally:
        os.close(fd)
    if holders(path):
        raise busy_error(path)


def require_serial(fd: int, path: str) -> None:
    """Raise PortError where the open file is no terminal device."""
    if not os.isatty(fd):
        raise PortError(
            f"port {path}",
            found="not a terminal device",
            expected="a serial port",
            remedy=f"ports here: {', '.join(candidates()) or 'none'}",
        )


def claim(fd: int, path: str) -> None:
    """Keep an open port from other programs.  Raises PortError where one has it, OSError of a device that is gone."""
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise busy_error(path) from None
    # On a pty the flag would outlive a killed owner while the emulator keeps the other end open.
    if os.major(os.fstat(fd).st_rdev) not in _PTY_MAJORS:
        fcntl.ioctl(fd, termios.TIOCEXCL)


def open_error(path: str, error: OSError) -> PortError:
    """What to say when a port cannot be opened."""
    if error.errno in (errno.EACCES, errno.EPERM):
        return permission_error(path)
    if error.errno == errno.EBUSY:
        return busy_error(path)
    found = "nothing of that name" if error.errno == errno.ENOENT else os.strerror(error.errno or 0)
    return PortError(
        f"port {path}",
        found=found,
        expected="a serial port",
        remedy=f"plug in the adapter; ports here: {', '.join(candidates()) or 'none'}",
    )


def permission_error(path: str) -> PortError:
    """What to say when the user may not open a port: mode, group, and how to join it."""
    info = Path(path).stat()
    try:
        group = grp.getgrgid(info.st_gid).gr_name
    except KeyError:
        group = str(info.st_gid)
    return PortError(
        f"port {path}",
        found=f"no permission (mode {stat.filemode(info.st_mode)}, group {group})",
        expected="read and write",
        remedy=way_in(info.st_mode, group),
    )


def way_in(mode: int, group: str) -> str:
    """How a user comes to a port: by its group where that may use it and is not root's, else by the udev rule."""
    if mode & _GROUP_MAY == _GROUP_MAY and group != "root":
        return f"add the user to group {group} (`sudo usermod -aG {group} $USER`) and log in again"
    return "install the udev rule shipped in systemd/udev, then unplug and plug the adapter"


def busy_error(path: str) -> PortError:
    """What to say when somebody else has a port: who."""
    return PortError(
        f"port {path}",
        found=f"in use by {', '.join(holders(path)) or 'this process, or one that cannot be seen'}",
        expected="nobody else on the bus",
        remedy="stop that process first",
    )


def holders(path: str) -> list[str]:
    """Processes that have this device open, as "name (pid)"; those of other users may be invisible."""
    try:
        device = Path(path).stat().st_rdev
    except OSError:
        return []
    found = []
    for process in Path("/proc").iterdir():
        if process.name.isdigit() and int(process.name) != os.getpid() and _has_open(process, device):
            with contextlib.suppress(OSError):
                found.append(f"{(process / 'comm').read_text().strip()} ({process.name})")
    return found


def _has_open(process: Path, device: int) -> bool:
    """True for a user of the device; who holds a pty's other end, as an emulator does, is none."""
    found = False
    with contextlib.suppress(OSError):
        for link in (process / "fd").iterdir():
            with contextlib.suppress(OSError):
                info = link.stat()
                if not stat.S_ISCHR(info.st_mode):
                    continue
                found = found or info.st_rdev == device
                if info.st_rdev == _PTMX and _pty_of(process / "fdinfo" / link.name) == device:
                    return False
    return found


def _pty_of(info: Path) -> int | None:
    """Device number of the pty whose master this open file is."""
    for line in info.read_text().splitlines():
        if line.startswith("tty-index:"):
            index = int(line.split()[1])
            return os.makedev(_PTY_MAJORS.start + (index >> 8), index & 0xFF)
    return None
