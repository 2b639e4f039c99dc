"""The bridge's end of the connection to the plant: the newest state of a twin without waiting, and its torque."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Protocol

import numpy as np

from drivers.interface import BusCounters, DriverError, Refusal, StaleStateError, Vector
from sim_backend.hil.coupling import TwinState
from sim_backend.served.link import CONNECT_TIMEOUT_S, PlantLink
from sim_backend.served.protocol import VERSION, FixedMessage, MessageKind, header_only, words


class Twin(Protocol):
    """One arm of the simulated cell that follows a real one.  No call but `connect` waits."""

    def connect(self) -> str:
        """Introduce the real arm; a line about the plant.  Raises ConnectError."""
        ...

    def enable(self) -> None:
        """Torque on, at zero; the plant's time starts when every arm has done so."""
        ...

    def newest(self) -> TwinState | None:
        """The newest state that has not been seen yet; None without one."""
        ...

    @property
    def ended(self) -> Refusal | None:
        """Why no state will come any more."""
        ...

    def command(self, tau_Nm: Vector, lasting_Nm: Vector) -> None:
        """Torque (n,) from now on, and what stays of it when this process is gone; without a plant nothing happens."""
        ...

    def limp(self) -> None:
        """Torque off for good."""
        ...

    def close(self) -> None:
        """Take leave.  Safe in any state and twice."""
        ...


class ServedTwin:
    """A twin in a plant that `sim_backend.served.server` serves at the wall clock's pace."""

    def __init__(
        self,
        socket_path: Path,
        arm: str,
        joints: tuple[str, ...],
        config_id: int,
        watchdog_s: float,
    ) -> None:
        """watchdog_s: after which the real arm's servos let go of it when nobody asks them."""
        self.utc_offset_ns = 0
        self.ended: Refusal | None = None
        self._path, self._arm, self._n = socket_path, arm, len(joints)
        self._hello = words(
            MessageKind.HELLO, version=VERSION, arm=arm, config_id=config_id, joints=list(joints),
            watchdog_s=float(watchdog_s),
        )  # fmt: skip
        self._out = FixedMessage(2 * self._n)
        self._out.head(MessageKind.COMMAND, 0, 0)
        self._link: PlantLink | None = None
        self._on = False

    def connect(self) -> str:
        """Introduce the real arm; the plant refuses another cell, an occupied arm, and a guest in lockstep."""
        self.close()
        link = PlantLink(self._path, self._arm, self._n, BusCounters(), arrays=4)
        try:
            info = link.introduce(self._hello, CONNECT_TIMEOUT_S)
        except BaseException:
            link.close()
            raise
        self._link, self.ended = link, None
        return str(info["description"])

    def enable(self) -> None:
        """Torque on, at zero; the plant's word that it is so comes among its states.  One that hangs has ended."""
        if self._link is None:
            return
        try:
            self._link.send(header_only(MessageKind.ENABLE), socket.MSG_DONTWAIT)
            self._on = True
        except DriverError as why:
            self.ended = why

    def newest(self) -> TwinState | None:
        """The newest state that has come since the last call; older ones are dropped."""
        link = self._link
        if link is None or self.ended is not None:
            return None
        pulled: list[Vector] = []
        try:
            while (kind := link.receive(socket.MSG_DONTWAIT)) is not None:
                if kind is MessageKind.STATE:
                    pulled.append(link.grasp.copy())
                    stamp_ns, q, dq = link.stamp_ns, link.q.copy(), link.dq.copy()
        except StaleStateError as why:
            self.ended = why
        return TwinState(stamp_ns, q, dq, pulled[-1], np.mean(pulled, axis=0)) if pulled else None

    def command(self, tau_Nm: Vector, lasting_Nm: Vector) -> None:
        """Torque (n,) from now on, and what stays of it when this process is gone.  A plant that hangs has ended."""
        if self._link is None or not self._on or self.ended is not None:
            return
        self._out.values[: self._n], self._out.values[self._n :] = tau_Nm, lasting_Nm
        try:
            self._link.send(self._out.buffer, socket.MSG_DONTWAIT)
        except DriverError as why:
            self.ended = why

    def limp(self) -> None:
        """Torque off for good, as a real arm's after its servos' watchdog."""
        if self._link is not None and self._on:
            self._link.say_and_forget(header_only(MessageKind.DISABLE))
        self._on = False

    def close(self) -> None:
        """Say goodbye: the run is over for this arm."""
        if self._link is not None:
            self._link.say_and_forget(header_only(MessageKind.BYE))
            self._link.close()
        self._link, self._on = None, False
