"""What an arm that moves while others float is told over its control socket: when to begin, and to stop.

It listens until it is stopped; from then on it does as the arms that float, which are told nothing.
"""

from __future__ import annotations

from pathlib import Path

from agent.config.cell import Cell
from agent.host.realtime import granted
from agent.host.signals import StopFlag
from agent.modes import Event, Mode
from agent.monitors.gravity import REST_S
from agent.operator.socket import ControlSocket, Standing
from agent.process.commands import AgentOptions
from agent.process.operated import Operator, no_real_time
from agent.process.tellers import Teller
from drivers.interface import Clock


class Words:
    """Of one arm."""

    def __init__(
        self, path: Path, cell: Cell, options: AgentOptions, stop: StopFlag, clock: Clock, tell: Teller
    ) -> None:
        """Listen at `path`; stop: the signals of this process.  Raises ControlError."""
        self._standing = Standing(options.arm)
        self.control = ControlSocket(path, cell.fingerprint, self._standing)
        self._operator = Operator(stop, self.control, clock, tell.event, drops_on_stop=False)
        self._real = not options.emulated
        self._accepts_late = options.allow_no_realtime

    def stops(self) -> bool:
        """Whether it is to stop, asked in every cycle until it does."""
        return Event.STOP in self._operator.events()

    def start_ns(self) -> int | None:
        """The common start on the clock of the arm, once it has been given."""
        return self._operator.start_ns()

    def ready(self) -> None:
        """It has torque, and may be given a start."""
        real = granted()
        if self._real and not (real.real or self._accepts_late):
            self._standing.no_start = no_real_time(real.text)
        self._standing.rest_s = REST_S if self._real else 0.0
        self._standing.enter(Mode.READY)

    def entered(self, mode: Mode) -> None:
        """Its mode has changed."""
        if mode is Mode.TRACK:
            self._standing.enter(mode)
        else:
            self.close()

    def close(self) -> None:
        """Listen no more; twice is fine."""
        self.control.close()
