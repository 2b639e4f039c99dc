"""A lockstep run whose telemetry and recorder are killed, stopped or deceived, at instants at which the world waits.

Real processes, sockets and signals; none of them, and nothing that they share, outlives it.
"""

from __future__ import annotations

import signal
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.config.cell import Cell
from agent.faults.plan import Injection
from agent.faults.stranger import Message, forged_messages, last_rows, random_messages, send
from agent.faults.strikes import Deed, Strike, placed_at, strikes
from agent.host.child import Child, wait_all
from agent.log.parts import next_path
from agent.process.children import READY_TIMEOUT_S, STOP_TIMEOUT_S, Children
from agent.process.commands import EmulateCommand, PlantCommand, RecordCommand, TelemetryCommand
from agent.process.progress import Progress
from agent.process.run_folder import rings_bytes, run_folder
from agent.process.run_kind import RunKind
from agent.telemetry.link.endpoint import FREE_PORT
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE
from agent.telemetry.row.topics import PLANT, RECORDER
from agent.verify.check import examine

UNHEARD_TIMEOUT_S: Final = 3.0  # for telemetry without a recorder, to see that it is over


@dataclass(frozen=True)
class Rehearsed:
    """What a run with struck listeners left behind."""

    cell: Cell
    faults: tuple[Injection, ...]
    rows: Mapping[str, NDArray[np.void]]  # by arm and of the plant: all that their rings have
    logs: tuple[Path, ...]  # in order of time
    sent: int  # messages of strangers


def rehearse_listeners(
    cell: Cell, faults: Sequence[Injection], seed: int, log: Path, progress: Progress, listen: str = FREE_PORT
) -> Rehearsed:
    """Run the cell in lockstep and let these happen; its log and the processes' words are left beside `log`.

    listen: endpoint of the recorder.  Raises FaultPlanError before anything starts; ChildFailed where a process
    ends that was not struck.
    """
    chosen = placed_at(cell, faults)
    progress.phase("checking")
    examine(cell).require()
    with run_folder(rings_bytes(len(cell.arms)), progress.note) as runtime:
        children = Struck(cell, seed, log, runtime, strikes(cell, chosen), listen)
        try:
            children.start(lambda: False, progress)
            children.watch(lambda: False, progress)
            children.end(progress)
            return Rehearsed(cell, chosen, children.rows(), tuple(children.logs), children.sent)
        finally:
            children.abandon()


def logs_left(cell: Cell, faults: Sequence[Injection]) -> int:
    """How many logs such a run leaves: one, and one of each recorder that is started anew.  Raises FaultPlanError."""
    deeds = [strike for group in strikes(cell, placed_at(cell, faults)) for strike in group]
    return 1 + sum(strike.deed is Deed.BEGIN and strike.whom == RECORDER for strike in deeds)


class Struck(Children):
    """The processes of one lockstep run, and what is done to those that listen."""

    def __init__(
        self, cell: Cell, seed: int, log: Path, runtime: Path, planned: Sequence[tuple[Strike, ...]], listen: str
    ) -> None:
        """planned: the deeds of each instant, in order of time."""
        super().__init__(cell, RunKind.LOCKSTEP, seed, None, log, runtime, listen)
        self.logs = [log]
        self.sent = 0  # messages of strangers
        self._due = deque(planned)
        self._standing: set[Child] = set()
        self._killed: set[Child] = set()
        self._replaced: list[Child] = []

    def rows(self) -> dict[str, NDArray[np.void]]:
        """All rows that the rings still have, by arm and of the plant."""
        layouts = {PLANT: PLANT_STATE, **dict.fromkeys(self._agents, AGENT_STATE)}
        found = {}
        for member, layout in layouts.items():
            with RingReader(self._ring(member), layout) as ring:
                found[member] = layout.decode(ring.read_at(0, ring.written).payload)
        return found

    def end(self, progress: Progress) -> None:
        """End everything in the order in which no more is lost than the faults cost.  Raises ChildFailed."""
        assert self._plant is not None
        wait_all(self._agents.values(), STOP_TIMEOUT_S)
        self._plant.wait(STOP_TIMEOUT_S)
        if self._due:
            raise self._plant.failed(f"ended with {len(self._due)} instants of faults to come")
        for child in self._standing:
            child.process.kill()  # what stands still for good ends as it stands
        self._killed |= self._standing
        self._standing = set()
        if self._recorder in self._killed:
            for child in self._telemetry.values():  # nobody will have its last row
                child.terminate()
            wait_all(self._telemetry.values(), UNHEARD_TIMEOUT_S)
        super().end(progress)

    def abandon(self) -> None:
        """Make sure that everything has ended: what stands still hears no request, so it is killed first."""
        for child in (*self._standing, *self._replaced):
            child.kill()
        super().abandon()

    def _close_log(self, recorder: Child, progress: Progress) -> None:
        if recorder not in self._killed:
            super()._close_log(recorder, progress)

    def _listening(self) -> list[Child]:
        return [child for child in super()._listening() if child not in self._killed]

    def _pass_on(self, progress: Progress) -> None:
        super()._pass_on(progress)
        assert self._plant is not None
        for _ in self._plant.told():  # the plant tells of nothing but its pauses
            for strike in self._due.popleft():
                progress.phase(f"t = {strike.at_s:g} s: {strike.deed.name.lower().replace('_', ' ')} {strike.whom}")
                self._carry_out(strike)
            self._plant.process.send_signal(signal.SIGUSR1)

    def _carry_out(self, strike: Strike) -> None:
        child = self._recorder if strike.whom == RECORDER else self._telemetry[strike.whom]
        assert child is not None
        match strike.deed:
            case Deed.KILL:
                child.process.kill()
                child.process.wait()
                self._killed.add(child)
            case Deed.STOP:
                self._standing.add(child)
                child.process.send_signal(signal.SIGSTOP)
                _await_standing(child)
            case Deed.GO_ON:
                child.process.send_signal(signal.SIGCONT)
                self._standing.discard(child)
            case Deed.BEGIN:
                self._replaced.append(child)
                self._begin_anew(strike.whom)
            case Deed.BABBLE:
                self._send(random_messages(self._cell.file.name, strike.whom, self._seed))
            case Deed.FORGE:
                self._send(forged_messages(self._cell, strike.whom, last_rows(self._ring(strike.whom))))

    def _begin_anew(self, whom: str) -> None:
        """A process in the place of one that was killed, as a service manager starts it."""
        if whom != RECORDER:
            again = self._telemetry[whom] = self._child(
                f"telemetry-{whom}-again", self._telemetry_command(whom, self._endpoint)
            )
        else:
            self.logs.append(next_path(self._log))
            command = replace(self._record_command(), out=self.logs[-1], listen=self._endpoint)
            again = self._recorder = self._child("recorder-again", command)
        again.wait_ready(READY_TIMEOUT_S)

    def _send(self, messages: Iterator[Message]) -> None:
        self.sent += send(self._endpoint, self._cell.file.name, messages)

    def _plant_command(self) -> PlantCommand | EmulateCommand:
        command = super()._plant_command()
        assert isinstance(command, PlantCommand)
        return replace(command, pauses=",".join(repr(group[0].at_s) for group in self._due))

    def _record_command(self) -> RecordCommand:
        return replace(super()._record_command(), at_once=True)

    def _telemetry_command(self, member: str, endpoint: str) -> TelemetryCommand:
        return replace(super()._telemetry_command(member, endpoint), at_once=True)


def _await_standing(child: Child) -> None:
    """Wait until every thread of the process stands.  Raises ChildFailed where it does not."""
    deadline = time.monotonic() + STOP_TIMEOUT_S
    while time.monotonic() < deadline:
        states = [_state(path) for path in Path(f"/proc/{child.process.pid}/task").glob("*/stat")]
        if states and all(state in ("T", "") for state in states):
            return
        time.sleep(0.001)
    raise child.failed(f"did not stand still after {STOP_TIMEOUT_S:g} s")


def _state(stat: Path) -> str:
    """State of a thread; empty where it has just ended."""
    try:
        return stat.read_text().rpartition(")")[2].split()[0]
    except OSError:
        return ""
