"""Who takes part in a simulated cell: connections, introductions, torque on and off between ticks."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import time
from collections.abc import Callable, Sequence
from typing import Final

from drivers.interface import ConnectError, Refusal
from drivers.peer import peer_uid
from sim_backend.served.listener import Listener
from sim_backend.served.protocol import (
    HEADER,
    MAX_MESSAGE_BYTES,
    VERSION,
    MessageKind,
    read_words,
    refusal_words,
    words,
)
from sim_backend.served.seat import Attendance, Seat, Vanished

INTRODUCTION_S: Final = 5.0  # a connection that says nothing for so long is closed


class Lobby:
    """Serves everyone for whom time does not wait.

    info: what an arm is told about the plant; reply: sends a seat the present state; lost: called with a seat
    whose other side has vanished.
    """

    def __init__(
        self,
        listener: Listener,
        seats: Sequence[Seat],
        config_id: int,
        info: dict[str, object],
        reply: Callable[[Seat], None],
        lost: Callable[[Seat, str], None],
    ) -> None:
        self._listener = listener
        self._seats = seats
        self._config_id = config_id
        self._info = info
        self._reply = reply
        self._lost = lost
        self._newcomers: dict[int, tuple[socket.socket, float]] = {}
        self.started = False

    def attend(self, timeout_s: float) -> None:
        """Serve whoever has something to say; wait for the first at most `timeout_s`."""
        waiting = {
            s.fileno: s
            for s in self._seats
            if s.phase is Attendance.OFF or (s.phase is Attendance.ON and not self.started)
        }
        poll = select.poll()
        for fd in (self._listener.socket.fileno(), *self._newcomers, *waiting):
            poll.register(fd, select.POLLIN)
        for fd, _ in poll.poll(timeout_s * 1e3):
            if fd in waiting:
                self._hear(waiting[fd])
            elif fd in self._newcomers:
                self._introduce(self._newcomers.pop(fd)[0])
            else:
                self._accept()
        for fd, (connection, deadline) in list(self._newcomers.items()):
            if time.monotonic() > deadline:
                del self._newcomers[fd]
                connection.close()

    def close(self) -> None:
        """Close connections that have not introduced themselves."""
        for connection, _ in self._newcomers.values():
            connection.close()
        self._newcomers.clear()

    def _accept(self) -> None:
        try:
            connection, _ = self._listener.socket.accept()
        except BlockingIOError:
            return
        self._newcomers[connection.fileno()] = (connection, time.monotonic() + INTRODUCTION_S)

    def _introduce(self, connection: socket.socket) -> None:
        try:
            message = connection.recv(MAX_MESSAGE_BYTES, socket.MSG_DONTWAIT)
            if not message:
                connection.close()  # somebody only looked whether a plant is here
                return
            if (uid := peer_uid(connection)) != os.geteuid():
                raise ConnectError(
                    "user", found=f"uid {uid}", expected=os.geteuid(), remedy="run plant and agents as the same user"
                )
            seat, watchdog_s = self._seat_for(message)
            connection.send(words(MessageKind.INFO, **self._info, **_limits(seat)), socket.MSG_NOSIGNAL)
        except Refusal as refusal:
            with contextlib.suppress(OSError):  # it left before it was told
                connection.send(refusal_words(MessageKind.REFUSED, refusal), socket.MSG_NOSIGNAL)
            connection.close()
        except OSError:
            connection.close()  # it left before it said its name
        else:
            seat.seat(connection, watchdog_s)

    def _seat_for(self, message: bytes) -> tuple[Seat, float | None]:
        """Seat that a HELLO asks for, and a guest's watchdog.  Raises ConnectError, which the agent is told."""
        hello = read_words(message)
        kind = HEADER.unpack_from(message)[0] if len(message) >= HEADER.size else None
        if kind != MessageKind.HELLO or hello.get("version") != VERSION:
            found = f"version {hello.get('version')}"
            raise ConnectError(
                "plant protocol",
                found=found,
                expected=VERSION,
                remedy="run plant and agents from the same installation",
            )
        arms = {s.arm.name: s for s in self._seats}
        seat = arms.get(str(hello.get("arm")))
        if seat is None:
            raise ConnectError(
                "arm",
                found=hello.get("arm"),
                expected=f"one of {sorted(arms)}",
                remedy="use an arm of the plant's cell",
            )
        self._check(seat, hello)
        return seat, self._watchdog_s(seat, hello.get("watchdog_s"))

    def _watchdog_s(self, seat: Seat, told: object) -> float | None:
        """None of an arm that is no guest.  Raises ConnectError for a guest where time waits for answers."""
        if told is None:
            return None
        if self._info["lockstep"] or not isinstance(told, float):
            raise ConnectError(
                f"arm {seat.arm.name}",
                found="a real arm in the loop of a plant in lockstep",
                expected="a plant at the wall clock's pace",
                remedy="start the plant with --real-time",
            )
        return told

    def _check(self, seat: Seat, hello: dict[str, object]) -> None:
        name = seat.arm.name
        if hello.get("lockstep") not in (None, self._info["lockstep"]):
            raise ConnectError(
                f"pace of arm {name}", found="an agent in " + ("lockstep" if hello["lockstep"] else "real time"),
                expected="one in " + ("lockstep" if self._info["lockstep"] else "real time") + ", as the plant",
                remedy="give --real-time to plant and agents, or to none of them",
            )  # fmt: skip
        if hello.get("config_id") != self._config_id:
            raise ConnectError(
                f"cell of arm {name}",
                found=_hex(hello.get("config_id")),
                expected=f"{self._config_id:08x}",
                remedy="start plant and agents with the same cell file",
            )
        if hello.get("joints") != list(seat.arm.controlled):
            raise ConnectError(
                f"joints of arm {name}",
                found=hello.get("joints"),
                expected=list(seat.arm.controlled),
                remedy="start plant and agents with the same cell file",
            )
        if seat.phase is not Attendance.ABSENT:
            over = seat.phase is Attendance.GONE
            raise ConnectError(
                f"arm {name}",
                found="an arm whose run is over" if over else "an arm that is already connected",
                expected="a free arm",
                remedy="start a new run" if over else f"stop the other agent of {name}",
            )

    def _hear(self, seat: Seat) -> None:
        try:
            kind = seat.receive(socket.MSG_DONTWAIT)
            if kind is MessageKind.POLL:
                self._reply(seat)
            elif kind is MessageKind.ENABLE:
                seat.switch_on()
            elif kind is MessageKind.DISABLE:
                seat.switch_off()
            elif kind is MessageKind.BYE:
                seat.leave(Attendance.GONE if self.started else Attendance.ABSENT)
            elif (
                kind is not None and kind is not MessageKind.COMMAND
            ):  # a command may still have been on its way at the DISABLE
                raise Vanished(f"it said {kind.name} out of turn")
        except Vanished as e:
            self._lost(seat, e.reason)


def _limits(seat: Seat) -> dict[str, object]:
    actuator = seat.arm.actuator
    return {"tau_largest_Nm": actuator.tau_largest_Nm.tolist(), "torque_lsb_Nm": actuator.torque_lsb_Nm.tolist()}


def _hex(config_id: object) -> str:
    return f"{config_id:08x}" if isinstance(config_id, int) else repr(config_id)
