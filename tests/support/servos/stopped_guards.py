"""Guards that hold in the place of their agents: `Successor.hold` itself, on emulated servos in virtual time.

Steps are those of `phase_rig`; once an agent is killed, words reach its guard over the guard's real control socket, and
signals its flag.  The run ends when every guard has ended by itself; one that does not is ended, and `ended` says so.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agent.around import RunSummary
from agent.config.cell import Arm, Cell
from agent.config.schema.driver import DriverKind
from agent.host.notify import Notifier
from agent.modes import Mode
from agent.operator.message import MAX_BYTES, Reply, Request
from agent.operator.table import Verb
from agent.process import successor
from agent.process.build import build_agent
from agent.process.commands import GuardOptions
from agent.process.successor import Successor
from agent.telemetry.row.fill import AgentRow
from agent.telemetry.row.sample import AGENT_STATE
from drivers.dynamixel.standby import Handover, StandbyDriver
from tests.support.servos.guarded_rig import HOST_NS
from tests.support.servos.phase_rig import At, PhaseArm, PhaseRun, Step

KEPT_ROWS = 64


class TooLong(Exception):
    """A guard has not ended by itself."""


class GuardClock:
    """The shared clock for one guard, beside which a person looks at the arms once a cycle."""

    utc_offset_ns = 0

    def __init__(self, rig: StoppedGuards, name: str) -> None:
        self._rig, self._name = rig, name

    def now_ns(self) -> int:
        return self._rig.clock.now_ns()

    def sleep_until(self, deadline_ns: int) -> None:
        self._rig.clock.sleep_until(deadline_ns)
        self._rig.looked_at(self._name)


class StoppedGuards(PhaseRun):
    """A run whose killed agents are succeeded by the guards of the product, started with or without `--hold`."""

    def __init__(
        self, cell: Cell, at: At, steps: Sequence[Step], folder: Path, patch: pytest.MonkeyPatch, *,
        hold: bool = False, session: bool = True, limit_s: float = 20.0,
    ) -> None:  # fmt: skip
        """session: what the agents have told their guards of themselves."""
        self._folder, self._patch, self._hold, self._session = folder, patch, hold, session
        self._asked: list[tuple[str, Verb, socket.socket]] = []
        self.replies: list[tuple[str, Verb, Reply]] = []
        self.ended: dict[str, bool] = {}
        super().__init__(cell, at, steps, limit_s=limit_s)
        self._hear()

    def looked_at(self, name: str) -> None:
        """Once a cycle of this arm's guard: its mode is that of its last row."""
        run = self.arms[name]
        mode = Mode(int(run.log.rows[-1]["mode"]))
        if mode is not self.mode[name]:
            self.mode[name] = mode
            run.modes.append((self.now_ns * 1e-9, mode))
        self._hear()
        self._person()
        if self.now_ns > self._limit_ns:
            raise TooLong(f"the guard of {name} goes on in {mode.name}")

    def _run(self, arm: Arm, index: int) -> None:
        try:
            super()._run(arm, index)
            self.ended[arm.name] = True
        except TooLong:
            self.ended[arm.name] = False

    def _guarded(self, run: PhaseArm, arm: Arm, driver: StandbyDriver, handover: Handover, row: AgentRow) -> RunSummary:
        del row
        driver.prepare(handover)
        self.clock.sleep_until(self.clock.now_ns() + HOST_NS)
        run.guarded = True
        run.signals = SimpleNamespace(stopped=False, stops=0, released=False, why="")
        agent = run.agent = build_agent(self.cell, arm)
        options = GuardOptions(
            cell=Path(), arm=arm.name, driver=DriverKind.DYNAMIXEL, emulated=True, hold=self._hold,
            socket=self._folder / f"{arm.name}.guard", control=self._control(arm.name), post_mortem=self._folder,
        )  # fmt: skip
        texts = SimpleNamespace(
            finish=lambda: None, event=lambda event: run.told.append(event.text), health=lambda *_: None
        )  # fmt: skip
        writer: Any = run.log
        writer.row, writer.written, writer.finish = run.log.message, len(run.log.rows), lambda: None
        watched: Any = SimpleNamespace(
            last_rows=lambda: np.array(run.log.rows[-KEPT_ROWS:], dtype=AGENT_STATE.dtype), texts=texts, writer=writer,
            inherit=lambda _: None, process=SimpleNamespace(ended=True), ring=self._folder / f"{arm.name}.ring",
            handed_over=False,
        )  # fmt: skip
        box = SimpleNamespace(beat=lambda: None, finish=lambda *_: None)
        self._patch.setattr(successor, "BlackBox", lambda *_, **__: box)
        self._patch.setattr(successor, "clock_of", lambda _: GuardClock(self, arm.name))
        guard = Successor(self.cell, arm, agent, options, run.signals, Notifier(""))
        driver.close = lambda: None  # type: ignore[method-assign]  # of the line, which the test looks at afterwards
        return guard.hold(watched, driver, "the agent has died", session=self._session)

    def _control(self, name: str) -> Path:
        return self._folder / f"{name}.control"

    def _take(self, step: Step, arms: Sequence[str], *, again: bool) -> None:
        if not isinstance(step.say, Verb) or not any(self.arms[name].guarded for name in arms):
            super()._take(step, arms, again=again)
            return
        for name in arms:
            if again and self.mode[name] is not step.mode:
                continue
            person = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            person.connect(os.fspath(self._control(name)))
            person.send(Request(step.say, self.cell.fingerprint).encode())
            person.setblocking(False)
            self._asked.append((name, step.say, person))

    def _hear(self) -> None:
        for asked in list(self._asked):
            name, verb, person = asked
            try:
                data = person.recv(MAX_BYTES)
            except BlockingIOError:
                continue
            self.replies.append((name, verb, Reply.decode(data)))
            person.close()
            self._asked.remove(asked)
