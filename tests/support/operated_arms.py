"""Agents as an operator finds them, on real control sockets: in a mode, or not there in one of several ways."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from agent.modes import Mode
from agent.operator import ask
from agent.operator.socket import ControlSocket, Standing
from agent.operator.table import MODES, Verb

OWN, OTHER = "ab" * 32, "cd" * 32
QUICK_S = 0.04  # how long an agent that hangs is waited for, by the clock of `Turns`
PATIENT_S = 20.0  # nobody hangs: never waited for
ABSENT, DEAD, HUNG, FOREIGN = "absent", "dead", "hung", "of another cell"
SILENT = (ABSENT, DEAD, HUNG)
Condition = Mode | str
EVERY: tuple[Condition, ...] = (*MODES, *SILENT, FOREIGN)


@dataclass
class Arm:
    """One agent as the test wants it: in a mode, or not there in one of several ways."""

    path: Path
    condition: Condition
    fingerprint: str = OWN
    control: ControlSocket | None = None
    listener: socket.socket | None = None
    wakes: Callable[[ControlSocket], None] | None = None  # is told before each poll
    session: bool = False  # goes from its rest to the object and back

    def open(self) -> None:
        if self.condition == ABSENT:
            return
        if self.condition in (DEAD, HUNG):
            self.listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            self.listener.bind(str(self.path))
            if self.condition == HUNG:
                self.listener.listen()  # takes clients and says nothing
            return
        mode = self.condition if isinstance(self.condition, Mode) else Mode.READY
        fingerprint = OTHER if self.condition == FOREIGN else self.fingerprint
        standing = Standing(self.path.stem, mode, session=(lambda _: "") if self.session else None)
        if self.session:
            standing.details = lambda: {"session": True}
        self.control = ControlSocket(self.path, fingerprint, standing)

    def close(self) -> None:
        for one in (self.control, self.listener):
            if one is not None:
                one.close()

    @property
    def heard(self) -> tuple[bool, list[Verb]]:
        """Whether it starts, and the words it has taken."""
        assert self.control is not None
        return self.control.requests.start is not None, self.control.requests.words


class Turns:
    """The clock of who asks: it goes on once all who live have polled, so that no machine makes them too late."""

    def __init__(self) -> None:
        self._turned = threading.Condition()
        self._turns, self._now_s = 0, 0.0

    def turned(self) -> None:
        with self._turned:
            self._turns += 1
            self._turned.notify_all()

    def monotonic(self) -> float:
        with self._turned:
            whole = self._turns + 2  # the one that is under way may have passed an arm before it was asked
            assert self._turned.wait_for(lambda: self._turns >= whole, PATIENT_S)
            self._now_s += 0.5 * QUICK_S
            return self._now_s


@contextmanager
def serving(arms: Sequence[Arm], *, in_turns: bool = False) -> Iterator[None]:
    """Poll those who live, as their loops would.

    in_turns: the time of who asks goes with their polls, as it does where somebody hangs.
    """
    over, turns = threading.Event(), Turns()

    def loop() -> None:
        while not over.is_set():
            for arm in arms:
                if arm.control is not None and arm.wakes is not None:
                    arm.wakes(arm.control)
                if arm.control is not None:
                    arm.control.poll()
            turns.turned()
            over.wait(0.0005)

    with ExitStack() as stack:
        if in_turns or any(arm.condition == HUNG for arm in arms):
            stack.enter_context(pytest.MonkeyPatch.context()).setattr(ask, "time", turns)
        for arm in arms:
            arm.open()
            stack.callback(arm.close)
        thread = threading.Thread(target=loop)
        thread.start()
        stack.callback(thread.join)
        stack.callback(over.set)
        yield


def cell_of(folder: Path, conditions: Sequence[Condition]) -> list[Arm]:
    folder.mkdir()
    return [Arm(folder / f"{name}.control", condition) for name, condition in zip("abc", conditions, strict=False)]
