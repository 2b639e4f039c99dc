"""A simulated arm taken over from the process that connected it: the same connection, with torque on all the time."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Mapping
from typing import Any

import numpy as np

from drivers.interface import JointState, StaleStateError, Vector
from sim_backend.served.driver import SimDriver


class SimStandby(SimDriver):
    """A driver that never connects: `prepare` while another process commands, then `adopt`.  In real time only."""

    resumed = limp = False  # a plant has no watchdog

    def prepare(self, told: Mapping[str, Any], fd: int) -> None:
        """told: what the plant said to the process that connected; fd: its connection, which is then this driver's."""
        self.drop()
        self._introduced(dict(told), self._new_link(os.dup(fd)))

    def adopt(self, last: JointState | None, *, brings_back: bool = True) -> Vector:
        """Take the arm over; NaN (n,), for a plant does not say which torque it was told last."""
        del last, brings_back  # it has not gone, and its encoders are right
        link = self._open_link()
        with contextlib.suppress(StaleStateError):  # a plant that has ended: the next read says so
            while link.receive(socket.MSG_DONTWAIT) is not None:
                pass  # states that nobody answered
        self._goes_on()
        return np.full(len(self._joints), np.nan)

    def drop(self) -> None:
        """Let go of the connection without a word: it is the other process's.  Safe twice."""
        if self._link is not None:
            self._link.close()
        self._closed()
