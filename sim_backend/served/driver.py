"""SimDriver: one arm of the simulated cell behind the same seam as a real one."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from enum import Enum, auto
from pathlib import Path
from typing import Any, Final

import numpy as np

from drivers.interface import (
    ArmInfo,
    BusCounters,
    ConnectError,
    DriverError,
    JointState,
    ServoHealth,
    Vector,
)
from sim_backend.physics.actuator import TorqueCommand
from sim_backend.served.link import CONNECT_TIMEOUT_S, PlantLink
from sim_backend.served.protocol import VERSION, FixedMessage, MessageKind, header_only, words

LOCKSTEP_READ_TIMEOUT_S: Final = 30.0
REAL_TIME_READ_PERIODS: Final = 5.0
REAL_TIME_READ_TIMEOUT_S: Final = 0.05  # at least


class PlantClock:
    """The plant's time.  In lockstep it stands at the last state read; in real time it is CLOCK_MONOTONIC."""

    def __init__(self) -> None:
        self.utc_offset_ns = 0  # as the plant says: the same for all its arms
        self._lockstep = True
        self._now_ns = 0

    def now_ns(self) -> int:
        """Stamp of the last state (lockstep; 0 before the first), or CLOCK_MONOTONIC."""
        return self._now_ns if self._lockstep else time.monotonic_ns()

    def sleep_until(self, deadline_ns: int) -> None:
        """Real time: sleep.  Lockstep: return at once, for time passes in `SimDriver.read` and nowhere else."""
        if not self._lockstep and (remaining_ns := deadline_ns - time.monotonic_ns()) > 0:
            time.sleep(remaining_ns * 1e-9)

    def follow(self, stamp_ns: int, *, lockstep: bool) -> None:
        """Set by the driver at each state."""
        self._now_ns, self._lockstep = stamp_ns, lockstep


class _Phase(Enum):
    CLOSED = auto()
    OFF = auto()
    ON = auto()


class SimDriver:
    """Driver of one arm of a plant served by `sim_backend.served.server`.

    In lockstep, time passes in `read`: one `write` per `read`; a second `read` without a `write` keeps the last
    torque, as a servo does.  While the torque is off, `read` asks for the state of the moment.
    """

    def __init__(
        self,
        socket_path: Path,
        arm: str,
        joints: tuple[str, ...],
        config_id: int,
        *,
        lockstep: bool | None = None,  # how the arm's loop goes; None: as the plant does
        connect_timeout_s: float = CONNECT_TIMEOUT_S,
        start_timeout_s: float = 60.0,  # for the first state: the other arms may still be starting
        read_timeout_s: float | None = None,  # None: 30 s in lockstep, five periods in real time
    ) -> None:
        self.counters = BusCounters()
        self.clock = PlantClock()
        self._path = socket_path
        self._arm = arm
        self._joints = joints
        self._config_id = config_id
        self._wanted_lockstep = lockstep
        self._connect_timeout_s = connect_timeout_s
        self._start_timeout_s = start_timeout_s
        self._given_read_timeout_s = read_timeout_s
        self._read_timeout_s = LOCKSTEP_READ_TIMEOUT_S
        self._out = FixedMessage(len(joints))
        self._out.head(MessageKind.COMMAND, 0, 0)
        self._command = TorqueCommand(np.zeros(len(joints)), np.zeros(len(joints)))
        self._link: PlantLink | None = None
        self._phase = _Phase.CLOSED
        self._lockstep = True
        self._answer_due = False
        self._running = False  # a state has come since the torque went on
        self._serial = 0
        self._info: dict[str, Any] = {}

    def connect(self) -> ArmInfo:
        """Introduce this arm; the plant refuses another cell, an unknown or an occupied arm.  Raises ConnectError."""
        if self._link is not None:
            raise ConnectError(
                f"arm {self._arm}", found="an open connection", expected="a closed driver", remedy="close() it first"
            )
        joints = list(self._joints)
        paced = {} if self._wanted_lockstep is None else {"lockstep": self._wanted_lockstep}
        known = {"arm": self._arm, "config_id": self._config_id, "joints": joints}
        hello = words(MessageKind.HELLO, version=VERSION, **known, **paced)
        link = self._new_link()
        try:
            info: dict[str, Any] = link.introduce(hello, self._connect_timeout_s)
            tau_largest = self._introduced(info, link)
        except BaseException:
            link.close()
            raise
        return ArmInfo(self._arm, self._joints, tau_largest, str(info["description"]))

    def _new_link(self, fd: int | None = None) -> PlantLink:
        return PlantLink(self._path, self._arm, len(self._joints), self.counters, fd=fd)

    def _introduced(self, info: dict[str, Any], link: PlantLink) -> Vector:
        """Take over what the plant says of itself; the largest torques (n,) N·m."""
        self._lockstep = bool(info["lockstep"])
        period_s = 1.0 / float(info["rate_hz"])
        self.clock.utc_offset_ns = int(info["utc_offset_ns"])
        tau_largest = np.array(info["tau_largest_Nm"], dtype=np.float64)
        self._command = TorqueCommand(tau_largest, np.array(info["torque_lsb_Nm"], dtype=np.float64))
        real_time_s = max(REAL_TIME_READ_PERIODS * period_s, REAL_TIME_READ_TIMEOUT_S)
        default_s = LOCKSTEP_READ_TIMEOUT_S if self._lockstep else real_time_s
        self._read_timeout_s = default_s if self._given_read_timeout_s is None else self._given_read_timeout_s
        self._link, self._phase, self._info = link, _Phase.OFF, info
        self.clock.follow(0, lockstep=self._lockstep)
        return tau_largest

    def passed_on(self) -> tuple[int, dict[str, Any]]:
        """The connection and what the plant said, for a process that may have to go on with this arm."""
        return self._open_link().fileno(), self._info

    def heed(self, asked: Callable[[], bool]) -> None:
        """Look meanwhile whether this arm is asked for something else: a `read` that waits raises WaitEnded then."""
        self._open_link().asked = asked

    @property
    def gone(self) -> bool:
        """Whether the plant has ended, or was never there."""
        return self._link is None or self._link.gone

    def _goes_on(self) -> None:
        """Torque is on, and states come."""
        self._open_link().wait_at_most(self._read_timeout_s)
        self._phase, self._answer_due, self._running = _Phase.ON, False, True

    def enable(self) -> None:
        """Torque on, at zero.  The plant's time starts when every arm has done so.  Raises DriverError."""
        link = self._open_link()
        if self._phase is _Phase.ON:
            return
        link.wait_at_most(self._connect_timeout_s)
        link.send(header_only(MessageKind.ENABLE))
        while link.receive() is not MessageKind.ENABLED:
            pass  # states of the time before
        link.wait_at_most(self._start_timeout_s)
        self._out.values[:] = 0.0
        self._phase, self._answer_due, self._running = _Phase.ON, False, False

    def read(self) -> JointState:
        """Next state of the plant (lockstep), the newest not yet read (real time), or the present one (torque off).

        Raises StaleStateError, naming the plant, when none comes in time or none will come any more.
        """
        link = self._open_link()
        if self._phase is _Phase.OFF:
            self._ask(link)
        else:
            if self._answer_due:
                link.say_and_forget(self._out.buffer)  # whether it arrived, the next state tells
                self._answer_due = False
            while link.receive() is not MessageKind.STATE:
                pass  # the answer to a question given up
            if self._lockstep:
                self._answer_due = True
                self._out.head(MessageKind.COMMAND, link.number, 0)
            else:
                while link.receive(socket.MSG_DONTWAIT) is not None:
                    pass
            if not self._running:
                self._running = True
                link.wait_at_most(self._read_timeout_s)
        self.clock.follow(link.stamp_ns, lockstep=self._lockstep)
        return JointState(link.stamp_ns, link.q.copy(), link.dq.copy(), link.tau.copy())

    def _ask(self, link: PlantLink) -> None:
        link.wait_at_most(self._read_timeout_s)
        self._serial += 1
        link.send(header_only(MessageKind.POLL, self._serial))
        while link.receive() is not MessageKind.REPLY or link.number != self._serial:
            pass  # pushed before the torque went off, or the answer to a question given up

    def write(self, tau_Nm: Vector) -> Vector:
        """Command torques (n,) N·m; return them as the servos are told: on their grid, within their limits.

        Raises TorqueCommandError on what is not finite; DriverError when the torque is off, the plant has gone, or
        (lockstep) no state has been read since the last torque.
        """
        link = self._open_link()
        if self._phase is not _Phase.ON or (self._lockstep and not self._answer_due):
            raise DriverError(
                f"torque of arm {self._arm}",
                found="torque off" if self._phase is not _Phase.ON else "no state read since the last torque",
                expected="enable(), then one write per read",
                remedy="keep the order of calls of drivers.interface.Driver",
            )
        sent = self._command(tau_Nm)
        self._out.values[:] = sent
        link.send(self._out.buffer)
        self._answer_due = False
        return sent

    def health(self) -> ServoHealth:
        """Of no servo: what is simulated here are joints, which have no temperature and no supply."""
        return ServoHealth.none(self.clock.now_ns())

    def disable(self) -> None:
        """Torque off; in lockstep the plant does not wait for this arm any more.  Safe in any state and twice."""
        if self._link is not None and self._phase is _Phase.ON:
            self._link.say_and_forget(header_only(MessageKind.DISABLE))
            self._phase, self._answer_due = _Phase.OFF, False

    def close(self) -> None:
        """Say goodbye: the run is over for this arm.  Safe in any state and twice."""
        if self._link is not None:
            self._link.say_and_forget(header_only(MessageKind.BYE))
            self._link.close()
        self._closed()

    def _closed(self) -> None:
        self._link, self._phase, self._answer_due = None, _Phase.CLOSED, False

    def _open_link(self) -> PlantLink:
        if self._link is None:
            raise DriverError(
                f"arm {self._arm}", found="a closed driver", expected="an open one", remedy="call connect() first"
            )
        return self._link
