"""Where the words to a hold are heard that a guard has in its agent's place; an arm is held without, too."""

from __future__ import annotations

import os
from contextlib import ExitStack
from pathlib import Path
from typing import Final

from agent.host.process_handle import ProcessHandle
from agent.operator.error import ControlError
from agent.operator.socket import ControlSocket, Standing
from agent.process.tellers import Every, Teller
from agent.telemetry.row.event import Level

FOLDER_WAIT_S: Final = 0.02  # for who begins beside it: a cell's guards may take over at once, servos wait for 0.2 s
FIRST_CYCLES: Final = 20  # likewise, of a hold that has begun
AGAIN_S: Final = 1.0  # from one attempt to the next after that


class Hearing:
    """The socket of a hold's words: made as soon as the dead agent has given its own back, and tried again and again.

    It is closed with the stack.
    """

    def __init__(
        self, path: Path | None, fingerprint: str, standing: Standing, agent: ProcessHandle, tell: Teller,
        stack: ExitStack, rate_hz: float,
    ) -> None:  # fmt: skip
        """path: None where no words are to be heard."""
        self._path, self._fingerprint, self._standing = path, fingerprint, standing
        self._agent, self._tell, self._stack = agent, tell, stack
        self._left = FIRST_CYCLES  # in which nothing is said of an attempt that fails
        self._again = Every(AGAIN_S, rate_hz)

    def begin(self) -> ControlSocket | None:
        """Before the first cycle; None, too, while the agent's process still has its socket."""
        if self._path is None or not self._agent.ended:
            return None
        self._left = 0
        return self._first(self._path, FOLDER_WAIT_S)

    def look(self) -> ControlSocket | None:
        """Once a cycle of a hold that hears no words."""
        if self._path is None or not self._agent.ended:
            return None
        if self._left:
            self._left -= 1
            return self._first(self._path, 0.0)
        if not self._again():
            return None
        try:
            heard = self._listen(self._path, 0.0)
        except ControlError:
            return None
        self._tell.event(Level.INFO, "words reach this hold from here on")
        return heard

    def _first(self, path: Path, wait_s: float) -> ControlSocket | None:
        try:
            return self._listen(path, wait_s)
        except ControlError as error:
            if not self._left:
                self._tell.event(
                    Level.ERROR, f"no word reaches this hold, SIGUSR1 to process {os.getpid()} releases it: {error}"
                )
            return None

    def _listen(self, path: Path, wait_s: float) -> ControlSocket:
        control = ControlSocket(path, self._fingerprint, self._standing, wait_s)
        self._stack.callback(control.close)
        return control
