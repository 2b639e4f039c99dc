"""A serial port with bounded waits: exclusive, raw, non-blocking.

Knows bytes and deadlines, nothing of packets.  Linux only.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import struct
import termios
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from drivers.dynamixel.errors import PortError, PortLostError, WriteTimeoutError
from drivers.dynamixel.line.ports import claim, open_error, require_serial

CHUNK = 256  # largest single read, bytes
DISCARD_LIMIT = 4096

_TCGETS2, _TCSETS2, _BOTHER = 0x802C542A, 0x402C542B, 0o010000
_TERMIOS2 = struct.Struct("<4IB19s2I")
_SERIAL_FLAGS_AT, _ASYNC_LOW_LATENCY = 16, 0x2000
_BAUD_TOLERANCE = 0.02  # an FTDI chip makes 4.571 Mbit/s of 4.5, which the servos accept


class Now(Protocol):
    """A monotonic clock."""

    def now_ns(self) -> int:
        """Nanoseconds; never goes back."""
        ...


class Port(Protocol):
    """What a bus needs of a serial port; `SerialPort` is the real one."""

    baud: int

    @property
    def is_open(self) -> bool:
        """True between `open` and `close`."""
        ...

    @property
    def latency_timer_ms(self) -> int | None:
        """USB latency timer; None when there is none to know."""
        ...

    def open(self) -> None:
        """Open, lock and configure.  Raises PortError."""
        ...

    def close(self) -> None:
        """Give the port back.  Safe twice."""
        ...

    def set_baud(self, baud: int) -> None:
        """Change the speed.  Raises PortError."""
        ...

    def read_now(self) -> bytes:
        """Return what has arrived; b"" when nothing has.  Raises PortLostError."""
        ...

    def read_until(self, deadline_ns: int) -> bytes:
        """Wait for bytes; b"" when none came by the deadline.  Raises PortLostError."""
        ...

    def discard_input(self) -> int:
        """Throw away what has arrived, bounded even on a babbling bus; returns how many bytes."""
        ...

    def write(self, data: bytes, deadline_ns: int) -> None:
        """Write all bytes.  Raises PortLostError, WriteTimeoutError."""
        ...


class SerialPort:
    """One open serial port.

    borrow: gives a descriptor of the port that another process has opened and locked; then `open` takes that one, and
    `close` leaves the port as exclusive as it is.  in_use: that one was made ready before, and somebody may be in the
    middle of an exchange on it: `open` changes nothing there and throws nothing away.
    Raises PortError from `open`, PortLostError when the device goes away, WriteTimeoutError when
    it takes no more bytes.
    """

    def __init__(
        self, path: str, baud: int, clock: Now, borrow: Callable[[], int] | None = None, *, in_use: bool = False
    ) -> None:
        self.path = path
        self.baud = baud
        self.low_latency = False
        self._clock = clock
        self._borrow = borrow
        self._in_use = in_use
        self._fd = -1

    def fileno(self) -> int:
        """Descriptor of the open port, for a process that shall use it too.  Raises PortLostError when it is closed."""
        return self._need_fd()

    @property
    def is_open(self) -> bool:
        """True between `open` and `close`."""
        return self._fd >= 0

    @property
    def latency_timer_ms(self) -> int | None:
        """USB latency timer as the kernel has it; None when this is no FTDI port."""
        try:
            device = (os.fstat(self._fd) if self.is_open else Path(self.path).stat()).st_rdev
            at = f"{os.major(device)}:{os.minor(device)}"  # of a borrowed port the path may not be there
            return int(Path(f"/sys/dev/char/{at}/device/latency_timer").read_text())
        except (OSError, ValueError):
            return None

    def open(self) -> None:
        """Open, lock and configure what is not in use.  Raises PortError; does nothing when already open."""
        if self.is_open:
            return
        fd = self._open_path() if self._borrow is None else self._borrow()
        with contextlib.ExitStack() as undo:
            undo.callback(os.close, fd)
            try:
                self._claim(fd)
                if not self._in_use:
                    self._configure(fd)
            except (OSError, termios.error) as error:  # of a plug that makes and breaks contact
                raise open_error(self.path, OSError(*error.args)) from error
            undo.pop_all()
        self._fd = fd

    def _open_path(self) -> int:
        try:
            return os.open(self.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            raise open_error(self.path, error) from error

    def close(self) -> None:
        """Give the port back.  Safe twice and on a dead device."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            if self._borrow is None:
                with contextlib.suppress(OSError):
                    fcntl.ioctl(fd, termios.TIOCNXCL)
            with contextlib.suppress(OSError):
                os.close(fd)

    def set_baud(self, baud: int) -> None:
        """Change the speed of an open port.  Raises PortError when the device cannot."""
        self._set_speed(self._need_fd(), baud)
        self.baud = baud

    def read_now(self) -> bytes:
        """Return what has arrived, at most CHUNK bytes; b"" when nothing has."""
        fd = self._need_fd()
        try:
            data = os.read(fd, CHUNK)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise self._lost(error) from error
        if not data:
            raise self._lost(None)  # a terminal that hung up reads as end of file
        return data

    def read_until(self, deadline_ns: int) -> bytes:
        """Wait for bytes; b"" when none came by the deadline."""
        fd = self._need_fd()
        remaining_ns = deadline_ns - self._clock.now_ns()
        if remaining_ns > 0:
            select.select((fd,), (), (), remaining_ns * 1e-9)
        return self.read_now()

    def discard_input(self) -> int:
        """Throw away what has arrived, bounded even on a babbling bus; returns how many bytes."""
        count = 0
        while count < DISCARD_LIMIT and (data := self.read_now()):
            count += len(data)
        return count

    def write(self, data: bytes, deadline_ns: int) -> None:
        """Write all bytes.  Raises WriteTimeoutError at the deadline; what was written by then is written."""
        fd = self._need_fd()
        try:
            done = os.write(fd, data)
        except BlockingIOError:
            done = 0
        except OSError as error:
            raise self._lost(error) from error
        while done < len(data):
            remaining_ns = deadline_ns - self._clock.now_ns()
            if remaining_ns <= 0:
                raise WriteTimeoutError(
                    f"port {self.path}",
                    found=f"{done} of {len(data)} bytes taken",
                    expected="all of them before the deadline",
                    remedy="the adapter is stuck: unplug and plug it",
                )
            select.select((), (fd,), (), remaining_ns * 1e-9)
            try:
                done += os.write(fd, data[done:])
            except BlockingIOError:
                continue
            except OSError as error:
                raise self._lost(error) from error

    def _need_fd(self) -> int:
        if self._fd < 0:
            raise self._lost(None)
        return self._fd

    def _lost(self, error: OSError | None) -> PortLostError:
        return PortLostError(
            f"port {self.path}",
            found=os.strerror(error.errno or 0) if error else "closed or hung up",
            expected="an open serial port",
            remedy="check the USB plug; the arm keeps its last goals until the servos' bus watchdog fires",
        )

    def _claim(self, fd: int) -> None:
        require_serial(fd, self.path)
        if fd >= 1024:
            raise PortError(
                f"port {self.path}",
                found=f"file descriptor {fd}",
                expected="below 1024, the limit of select()",
                remedy="open the port before other files",
            )
        claim(fd, self.path)

    def _configure(self, fd: int) -> None:
        attributes = termios.tcgetattr(fd)
        attributes[0] = attributes[1] = attributes[3] = 0
        attributes[2] = termios.CS8 | termios.CREAD | termios.CLOCAL
        attributes[6][termios.VMIN], attributes[6][termios.VTIME] = (
            1,
            0,
        )  # with VMIN 0 nothing would read like a hang-up
        termios.tcsetattr(fd, termios.TCSANOW, attributes)
        self._set_speed(fd, self.baud)
        self._ask_low_latency(fd)
        termios.tcflush(fd, termios.TCIOFLUSH)

    def _set_speed(self, fd: int, baud: int) -> None:
        """Any speed, 4.5 Mbit/s included, which the standard constants lack."""
        raw = bytearray(_TERMIOS2.size)
        try:
            fcntl.ioctl(fd, _TCGETS2, raw)
            fields = list(_TERMIOS2.unpack(raw))
            fields[2] = fields[2] & ~(termios.CBAUD | termios.CBAUD << 16) | _BOTHER
            fields[6] = fields[7] = baud
            fcntl.ioctl(fd, _TCSETS2, _TERMIOS2.pack(*fields))
            fcntl.ioctl(fd, _TCGETS2, raw)
        except OSError as error:
            raise self._baud_error(baud, os.strerror(error.errno or 0)) from error
        actual = _TERMIOS2.unpack(raw)[7]
        if abs(actual - baud) > _BAUD_TOLERANCE * baud:
            raise self._baud_error(baud, f"{actual} bit/s")

    def _baud_error(self, baud: int, found: str) -> PortError:
        return PortError(
            f"port {self.path}: speed",
            found=found,
            expected=f"{baud} bit/s",
            remedy="use an adapter that reaches it (U2D2) or lower the servos' Baud Rate",
        )

    def _ask_low_latency(self, fd: int) -> None:
        """1 ms instead of 16 on an FTDI adapter; other devices do not know the request."""
        settings = bytearray(128)  # struct serial_struct, larger than any
        try:
            fcntl.ioctl(fd, termios.TIOCGSERIAL, settings)
            flags = struct.unpack_from("=i", settings, _SERIAL_FLAGS_AT)[0]
            struct.pack_into("=i", settings, _SERIAL_FLAGS_AT, flags | _ASYNC_LOW_LATENCY)
            fcntl.ioctl(fd, termios.TIOCSSERIAL, settings)
        except OSError:
            self.low_latency = False  # the cycle's budget is checked against what is measured
        else:
            self.low_latency = True
