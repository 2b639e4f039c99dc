"""The agent's end of the connection to the plant; every wait has a bound, and one for a state is over when asked."""

from __future__ import annotations

import os
import select
import socket
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from drivers.interface import BusCounters, ConnectError, DriverError, StaleStateError, WaitEnded
from sim_backend.served.protocol import HEADER, KINDS, MAX_MESSAGE_BYTES, MessageKind, read_words, refusal_parts

CONNECT_TIMEOUT_S = 5.0
LOOK_S = 0.05  # while it waits for a state, from one look whether it is asked for something else to the next
INFO_KEYS = {"lockstep", "rate_hz", "utc_offset_ns", "tau_largest_Nm", "torque_lsb_Nm", "description"}
_NO_SIGNAL = int(socket.MSG_NOSIGNAL)  # combining flags of the enumeration takes 1 µs
_STATES = (MessageKind.STATE, MessageKind.REPLY)


class PlantLink:
    """A connection of `arm` to the plant at `path`.

    After `receive` has returned STATE or REPLY, `number`, `stamp_ns` and the views q, dq, tau (n,) hold what came,
    until the next call.
    """

    def __init__(
        self, path: Path, arm: str, joint_count: int, counters: BusCounters, *, fd: int | None = None, arrays: int = 3
    ) -> None:
        """fd: a connection that there is already, which is then this link's.

        arrays: of a state; a guest's has the torques of its grasp as a fourth, `grasp`.
        """
        self._path = path
        self._arm = arm
        self._counters = counters
        self._in = bytearray(MAX_MESSAGE_BYTES)
        parts = np.frombuffer(self._in, np.float64, arrays * joint_count, HEADER.size).reshape(arrays, -1)
        self.q, self.dq, self.tau, self.grasp = parts[0], parts[1], parts[2], parts[-1]
        self._state_size = HEADER.size + 8 * parts.size
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET, fileno=fd)
        self._ended: tuple[str, dict[str, str]] | None = None  # why no state will come any more
        self._timeout_s = 0.0
        self.asked: Callable[[], bool] = lambda: False  # for something else than to wait for a state
        self.number = 0
        self.stamp_ns = 0

    def introduce(self, hello: bytes, timeout_s: float) -> dict[str, object]:
        """Connect and say who this is; what the plant says of itself.  Raises ConnectError."""
        self._bound(timeout_s, timeout_s)
        try:
            self._socket.connect(os.fspath(self._path))
            self._socket.send(hello, socket.MSG_NOSIGNAL)
            answer = self._socket.recv(MAX_MESSAGE_BYTES)
        except OSError as e:
            raise ConnectError(
                f"plant at {self._path}",
                found="no answer" if isinstance(e, BlockingIOError) else e.strerror or str(e),
                expected=f"an answer within {timeout_s:g} s",
                remedy="start the plant of this cell first",
            ) from e
        kind = HEADER.unpack_from(answer)[0] if len(answer) >= HEADER.size else None
        if kind == MessageKind.REFUSED:
            what, parts = refusal_parts(answer)
            raise ConnectError(f"plant at {self._path} refuses: {what}", **parts)
        info = read_words(answer)
        if kind != MessageKind.INFO or not set(info) >= INFO_KEYS:
            raise ConnectError(
                f"plant at {self._path}",
                found=f"an answer of {len(answer)} bytes",
                expected="an introduction",
                remedy="check what serves that socket",
            )
        return info

    def fileno(self) -> int:
        """Descriptor of the connection."""
        return self._socket.fileno()

    def wait_at_most(self, timeout_s: float) -> None:
        """Bound every send and receive from now on."""
        self._timeout_s = timeout_s
        self._bound(timeout_s, min(timeout_s, LOOK_S))

    def _bound(self, send_s: float, receive_s: float) -> None:
        """Of one system call."""
        for option, bound_s in ((socket.SO_SNDTIMEO, send_s), (socket.SO_RCVTIMEO, receive_s)):
            timeval = struct.pack("@ll", int(bound_s), int(bound_s % 1 * 1e6))
            self._socket.setsockopt(socket.SOL_SOCKET, option, timeval)

    @property
    def gone(self) -> bool:
        """Whether the plant has closed its end; what it said before can still be received."""
        asked = select.poll()
        asked.register(self._socket, 0)
        return bool(asked.poll(0))

    def send(self, message: bytes | bytearray, flags: int = 0) -> None:
        """Send one message, with MSG_DONTWAIT only where that can be done at once.

        Raises DriverError when the plant is not there any more, or has no room because it reads nothing.
        """
        try:
            self._socket.send(message, _NO_SIGNAL | flags)
        except OSError as e:
            try:
                while self.receive(socket.MSG_DONTWAIT) is not None:
                    pass  # the last thing the plant said may be why
            except StaleStateError as why:
                raise DriverError(why.what, found=why.found, expected=why.expected, remedy=why.remedy) from e
            raise DriverError(
                f"plant at {self._path}, arm {self._arm}",
                found="one that reads nothing any more" if isinstance(e, BlockingIOError) else e.strerror,
                expected="a plant that listens",
                remedy="see the log of the plant",
            ) from e

    def receive(self, flags: int = 0) -> MessageKind | None:
        """Next message; None only with MSG_DONTWAIT when there is none.

        Raises StaleStateError when none came in time, or none will come any more, with the plant's own reason;
        WaitEnded where this arm is `asked` for something before one comes.
        """
        waited_s = 0.0
        while (size := self._recv(flags)) is None:
            if flags & socket.MSG_DONTWAIT:
                return None
            waited_s += min(self._timeout_s, LOOK_S)
            if waited_s >= self._timeout_s:
                self._counters.timeouts += 1
                raise self._stale(
                    f"no state within {self._timeout_s:g} s", "see what the plant or another arm waits for"
                )
            if self.asked():
                raise WaitEnded(
                    f"plant at {self._path}, arm {self._arm}", found="no state yet", expected="a fresh state",
                    remedy="none: this arm was asked for something else while it waited",
                )  # fmt: skip
        if size < HEADER.size:
            raise self._stale("its end", "see the log of the plant")
        kind, self.number, self.stamp_ns = HEADER.unpack_from(self._in)
        if kind == MessageKind.NOTICE:
            self._ended = refusal_parts(bytes(self._in[:size]))
            raise self._stale("", "")
        known = KINDS.get(kind)
        if known is None or (known in _STATES and size != self._state_size):
            self._counters.corrupt += 1
            raise self._stale(
                f"a message of kind {kind} and {size} bytes", "start plant and agents from the same installation"
            )
        return known

    def _recv(self, flags: int) -> int | None:
        """Size of the next message; None where there is none yet."""
        try:
            return self._socket.recv_into(self._in, 0, flags)
        except BlockingIOError:
            return None
        except ConnectionResetError:  # it closed with a torque unread; what it said before is still there
            try:
                return self._socket.recv_into(self._in, 0, flags)
            except ConnectionResetError:
                return 0

    def _stale(self, found: str, remedy: str) -> StaleStateError:
        if self._ended is not None:
            what, parts = self._ended
            return StaleStateError(f"plant at {self._path}, arm {self._arm}: {what}", **parts)
        return StaleStateError(
            f"plant at {self._path}, arm {self._arm}", found=found, expected="a fresh state", remedy=remedy
        )

    def say_and_forget(self, message: bytes | bytearray) -> None:
        """Send if that can be done at once; nothing happens otherwise."""
        try:
            self._socket.send(message, _NO_SIGNAL | socket.MSG_DONTWAIT)
        except OSError:
            return  # nobody is there to hear it

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()
