"""The plant's side of one arm: its connection, its torque on the way."""

from __future__ import annotations

import contextlib
import socket
import struct
from enum import Enum, auto

import numpy as np

from drivers.interface import Refusal, Vector
from sim_backend.physics.actuator import TorqueCommand, TorqueCommandError
from sim_backend.physics.delay import DelayLine
from sim_backend.physics.spec import ArmSpec
from sim_backend.served.protocol import (
    HEADER,
    KINDS,
    MAX_MESSAGE_BYTES,
    MessageKind,
    header_only,
    refusal_words,
    state_layout,
)

_NO_SIGNAL = int(socket.MSG_NOSIGNAL)  # combining flags of the enumeration takes 1 µs
WAIT_S = 0.1  # longest wait inside one blocking receive, after which the caller looks around


class Attendance(Enum):
    """Where an arm is."""

    ABSENT = auto()  # nobody connected
    OFF = auto()  # connected, torque off
    ON = auto()  # torque on: in lockstep, time waits for its command
    GONE = auto()  # has said BYE after the start


class Vanished(Exception):
    """The other side is not there any more, or speaks nonsense: `reason`."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


class Seat:
    """One arm's place at the plant."""

    def __init__(self, arm: ArmSpec, joints: slice, delay: DelayLine) -> None:
        n = len(arm.controlled)
        self.arm = arm
        self.joints = joints
        self.phase = Attendance.ABSENT
        self.told = -1  # tick of the last state it was sent since its torque went on
        self.dropped_states = 0  # real time only: the agent's queue was full
        self.delay = delay
        self._skew_ns = round(arm.skew_s * 1e9)
        self._command = TorqueCommand.of(arm.actuator)
        self._connection: socket.socket | None = None
        self.watchdog_s: float | None = None  # of a guest: a real arm's twin, which goes limp so long after its loss
        self.limp_at_tick: int | None = None  # of a guest that has vanished
        self._use_layout(3)
        self._in = bytearray(MAX_MESSAGE_BYTES)
        self._in_tau = np.frombuffer(self._in, np.float64, 2 * n, HEADER.size).reshape(2, n)
        self.number = 0  # of the last message received
        self.tau = np.zeros(n)  # last command, as the servos were told
        self._lasting = np.zeros(n)  # what stays of it when a guest has vanished

    @property
    def fileno(self) -> int:
        """Descriptor for poll; -1 without a connection."""
        return -1 if self._connection is None else self._connection.fileno()

    @property
    def guest(self) -> bool:
        """Whether it is the twin of a real arm."""
        return self.watchdog_s is not None

    def _use_layout(self, arrays: int) -> None:
        self._state = state_layout(arrays, len(self.arm.controlled))
        self._out = bytearray(self._state.size)
        self._command_bytes = HEADER.size + 8 * len(self.arm.controlled) * (2 if self.guest else 1)

    def seat(self, connection: socket.socket, watchdog_s: float | None = None) -> None:
        """Take over a connection that has introduced itself; watchdog_s: of a guest."""
        self.watchdog_s, self.limp_at_tick = watchdog_s, None
        self._use_layout(4 if self.guest else 3)
        connection.setblocking(True)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("@ll", 0, int(WAIT_S * 1e6)))
        self._connection = connection
        self.phase = Attendance.OFF

    def leave(self, phase: Attendance) -> None:
        """Close the connection; torque is off."""
        self.switch_off(phase)
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def orphan(self, limp_at_tick: int) -> None:
        """Close the connection of a guest; what lasts of its torque stays until a tick, as on servos nobody asks."""
        self.limp_at_tick, self.tau = limp_at_tick, self._lasting
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def switch_on(self) -> None:
        """Torque on, at zero."""
        self.switch_off(Attendance.ON)
        self.say(header_only(MessageKind.ENABLED))

    def switch_off(self, phase: Attendance = Attendance.OFF) -> None:
        """Torque off; commands on their way are lost, and so are states: the arm looks for none."""
        self.phase = phase
        self.told = -1
        self.tau[:] = self._lasting[:] = 0.0
        self.delay.clear()

    def say(self, message: bytes | bytearray, flags: int = 0) -> None:
        """Send one message; BlockingIOError passes through.

        A closed connection is no error here: its BYE may wait to be received, and `receive` tells.
        """
        if self._connection is not None:
            try:
                self._connection.send(message, flags | _NO_SIGNAL)
            except (BrokenPipeError, ConnectionResetError):
                return

    def tell(self, refusal: Refusal) -> None:
        """Say why no state will come any more; a peer that is not there need not know."""
        with contextlib.suppress(BlockingIOError):
            self.say(refusal_words(MessageKind.NOTICE, refusal), socket.MSG_DONTWAIT)

    def send_state(self, kind: MessageKind, number: int, stamp_ns: int, state: Vector, flags: int) -> None:
        """Send this arm's part of `state`, whose rows (J,) are positions, velocities, torques, a guest's grasp torques.

        Stamped by this arm's clock.
        """
        part = state[:, self.joints].tobytes()
        self._state.pack_into(self._out, 0, kind, number, stamp_ns + self._skew_ns, part)
        try:
            self.say(self._out, flags)
        except BlockingIOError:
            self.dropped_states += 1

    def receive(self, flags: int = 0) -> MessageKind | None:
        """Next message of the arm, a COMMAND already in `tau`; None when none came in time.  Raises Vanished."""
        if self._connection is None:
            return None
        try:
            size = self._connection.recv_into(self._in, 0, flags)
        except BlockingIOError:
            return None
        except ConnectionResetError:  # it closed with a state unread; what it said before is still there
            size = self._connection.recv_into(self._in, 0, flags)
        if size == 0:
            raise Vanished("it ended without saying so")
        if size < HEADER.size:
            raise Vanished(f"it sent {size} bytes that mean nothing")
        kind, self.number, _ = HEADER.unpack_from(self._in)
        known = KINDS.get(kind)
        if known is None:
            raise Vanished(f"it sent an unknown message, kind {kind}")
        if known is MessageKind.COMMAND:
            self._take_command(size)
        return known

    def _take_command(self, size: int) -> None:
        if size != self._command_bytes:
            raise Vanished(f"it sent a command of {size} bytes instead of {self._command_bytes}")
        try:
            self.tau = self._command(self._in_tau[0])
            if self.guest:
                self._lasting = self._command(self._in_tau[1])
        except TorqueCommandError as e:
            raise Vanished(f"it commanded {e.found}") from e
