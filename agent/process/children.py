"""The processes of one simulated run: started, watched, and ended in the order in which no row is lost."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

from agent.config.cell import Cell
from agent.config.schema.driver import DriverKind
from agent.host.child import Child, wait_all
from agent.host.info import CELL_FILE, RUN_FILE
from agent.host.paths import control_in, emulated_port_in, plant_socket_in, ring_in
from agent.host.share import keep_to, share_out
from agent.operator.words import start_patiently
from agent.process.befallen import stop_in
from agent.process.commands import (
    AgentCommand,
    ChildCommand,
    EmulateCommand,
    PlantCommand,
    RecordCommand,
    TelemetryCommand,
)
from agent.process.common_start import say
from agent.process.describe import run_info
from agent.process.entry import load, main
from agent.process.folder import words_folder
from agent.process.person import Person
from agent.process.progress import HowFar, Progress
from agent.process.rehearse import in_the_loop
from agent.process.run_kind import RunKind
from agent.process.unbegun import StoppedEarly
from agent.telemetry.link.endpoint import FREE_PORT
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.row.sample import AGENT_STATE
from agent.telemetry.row.topics import PLANT
from drivers.clock import utc_offset_ns

READY_TIMEOUT_S = 30.0
STOP_TIMEOUT_S = 20.0
START_IN_NS = 500_000_000
START_LOOP_IN_NS = 2_500_000_000  # arms in the loop come to rest, have their grippers looked at, and are coupled
ABANDON_TIMEOUT_S = 5.0
LOOK_EVERY_S = 0.05


class Children:
    """The processes of one run.  What they share lies in `runtime`, their words beside `log` in a folder `logs`."""

    _copied = True  # from this process, which has loaded what they need

    def __init__(
        self,
        cell: Cell,
        kind: RunKind,
        seed: int,
        faults: Path | None,
        log: Path,
        runtime: Path,
        listen: str = FREE_PORT,
        *,
        whole: bool = False,
    ) -> None:
        """`listen`: endpoint of the recorder, where viewers may connect; `whole`: emulated arms, from rest to rest."""
        self._cell = cell
        self._kind = kind
        self._seed = seed
        self._faults = faults
        self._log = log
        self._runtime = runtime
        self._listen = listen
        self._whole = whole
        self.person: Person | None = None  # who stands beside the arms of a whole session
        self._words = words_folder(log.parent)
        self._cell_path, self._run_info_path = runtime / CELL_FILE, runtime / RUN_FILE
        self._cell_path.write_bytes(cell.toml)
        self._run_info_path.write_bytes(run_info(cell, kind.driver, seed))
        self._recorder: Child | None = None
        self._plant: Child | None = None
        self._servos: Child | None = None  # of arms in the loop
        self._agents: dict[str, Child] = {}
        self._telemetry: dict[str, Child] = {}
        self._cores = share_out(len(cell.arms), os.sched_getaffinity(0))
        self._endpoint = ""  # of the recorder, once it is ready
        self._start = runtime / "common_start"  # to say it in
        # one for plant, servos and agents: the wall clock may be set between their starts
        self._utc_offset_ns = None if self._lockstep else utc_offset_ns()
        self._stop: Callable[[], bool] = lambda: False  # told to `start`
        self._interrupted = False

    def start(self, stop: Callable[[], bool], progress: Progress) -> None:
        """Start all, recorder first.  Raises ChildFailed, ControlError, StoppedEarly; arms may have torque then."""
        self._stop = stop
        progress.phase("starting", still=self._copied)
        if self._copied:
            load(servos=self._kind.has_servos)
        self._recorder = self._kept("recorder", self._record_command(), self._cores.listeners)
        self._plant = self._kept("plant", self._plant_command(), self._cores.plant)
        self._wait_ready(self._plant)
        if self._kind is RunKind.HIL:
            self._start_servos()
        self._start_agents()
        self._endpoint = self._wait_ready(self._recorder)["endpoint"]
        for name in (PLANT, *self._agents):
            command = self._telemetry_command(name, self._endpoint)
            self._telemetry[name] = self._kept(f"telemetry-{name}", command, self._cores.listeners)
        for child in (*self._agents.values(), *self._telemetry.values()):
            self._wait_ready(child)
        if self._whole:
            arms = {arm: [self._control(arm)] for arm in self._agents}
            self.person = Person(arms, self._cell.fingerprint, lambda word: progress.phase(f"coop {word}"), self._start)
        elif not self._lockstep:
            self._start_together(progress)

    def _start_servos(self) -> None:
        self._servos = self._child("servos", self._emulate_command(None))
        self._wait_ready(self._servos)

    def _start_agents(self) -> None:
        self._heed()
        for arm, own in zip(self._cell.arms, self._cores.arms, strict=True):
            self._agents[arm.name] = self._kept(f"arm-{arm.name}", self._agent_command(arm.name), own)

    def _kept(self, name: str, command: ChildCommand, cores: frozenset[int]) -> Child:
        """Start a process; in lockstep, where all wait for each other, it keeps to these cores."""
        child = self._child(name, command)
        if self._lockstep:
            keep_to(child.process.pid, cores)
        return child

    def _start_together(self, progress: Progress) -> None:
        """Give all arms one start instant once each of them holds its start pose."""
        progress.phase("torque on")
        for child in self._agents.values():
            self._wait_ready(child)
        places = {arm: [self._control(arm)] for arm in self._agents}
        start_in_ns = START_LOOP_IN_NS if self._kind is RunKind.HIL else START_IN_NS
        say(self._start, start_patiently(places, self._cell.fingerprint, start_in_ns, self._heed))

    def _wait_ready(self, child: Child) -> dict[str, str]:
        """Key-value pairs of its next ready line.  Raises ChildFailed, StoppedEarly."""
        return child.wait_ready(READY_TIMEOUT_S, self._heed)

    def _heed(self) -> None:
        """Raise StoppedEarly where somebody has asked for an end."""
        if self._stop():
            raise StoppedEarly.of(f"run of cell {self._cell.file.name}")

    def _record_command(self) -> RecordCommand:
        return RecordCommand(
            cell=self._cell_path,
            out=self._log,
            listen=self._listen,
            driver=self._kind.driver,
            truth=True,
            seed=self._seed,
            run_info=self._run_info_path,
        )

    def _plant_command(self) -> PlantCommand | EmulateCommand:
        ring = self._ring(PLANT)
        if self._kind is RunKind.WIRE:
            return self._emulate_command(ring)
        return PlantCommand(
            cell=self._cell_path, socket=self._socket, ring=ring, real_time=not self._lockstep, stops=True,
            common_start=None if self._lockstep else self._start, utc_offset_ns=self._utc_offset_ns,
        )  # fmt: skip

    def _emulate_command(self, ring: Path | None) -> EmulateCommand:
        return EmulateCommand(
            cell=self._cell_path, ports=self._runtime, ring=ring, faults=self._faults, seed=self._seed,
            whole=self._whole, stops=True, common_start=self._start, utc_offset_ns=self._utc_offset_ns,
        )  # fmt: skip

    def _agent_command(self, arm: str) -> AgentCommand:
        looped = self._kind is RunKind.HIL and in_the_loop(self._cell, arm)
        wire = self._kind is RunKind.WIRE or looped
        return AgentCommand(
            cell=self._cell_path,
            arm=arm,
            ring=self._ring(arm),
            control=self._control(arm),
            driver=DriverKind.DYNAMIXEL if wire else DriverKind.SIM,
            plant_socket=None if self._kind is RunKind.WIRE else self._socket,
            port=str(emulated_port_in(self._runtime, arm)) if wire else None,
            emulated=wire or self._kind is RunKind.HIL,
            real_time=self._kind in (RunKind.REAL_TIME, RunKind.HIL), whole=self._whole,
            stop_in=stop_in(self._cell, arm), utc_offset_ns=self._utc_offset_ns,
        )  # fmt: skip

    def _telemetry_command(self, member: str, endpoint: str) -> TelemetryCommand:
        return TelemetryCommand(
            cell=self._cell_path, member=member, ring=self._ring(member), connect=endpoint, lockstep=self._lockstep,
            cell_name=self._cell.file.name, fingerprint=self._cell.fingerprint,
        )  # fmt: skip

    def watch(self, stop: Callable[[], bool], progress: Progress) -> bool:
        """Watch until every agent has ended; True when a stop was requested.  Raises ChildFailed."""
        progress.phase("running")
        first, duration_s = self._cell.arms[0].name, self._cell.file.duration_s
        with RingReader(self._ring(first), AGENT_STATE) as rows:
            how_far = HowFar(rows, progress, duration_s)
            while any(child.process.poll() is None for child in self._agents.values()):
                self._require_alive()
                self._pass_on(progress)
                if self.person is not None:
                    self.person.look()
                if stop() and not self._interrupted:
                    self._interrupted = True
                    if self._stop_agents():
                        return True
                how_far.look()
                time.sleep(LOOK_EVERY_S)
            how_far.look()
        self._require_alive()
        return self._interrupted

    def _pass_on(self, progress: Progress) -> None:
        assert self._recorder is not None
        for text in self._recorder.told():  # that the log has ended, which ends nothing else
            progress.note(text)

    def _stop_agents(self) -> bool:
        """Ask for the end of the run; whether nobody watches it any more."""
        for child in self._agents.values():
            child.terminate()
        return True

    def end(self, progress: Progress) -> None:
        """End everything in the order in which nothing is lost."""
        progress.phase("closing the log")
        wait_all(self._agents.values(), STOP_TIMEOUT_S)
        assert self._plant is not None
        assert self._recorder is not None
        if self._kind is RunKind.WIRE:  # emulated servos serve until they are told to stop
            self._plant.terminate()
        if self._servos is not None:
            self._servos.terminate()
        if self._plant.wait(STOP_TIMEOUT_S) is None:
            self._plant.terminate()
        wait_all(self._telemetry.values(), STOP_TIMEOUT_S)  # each ends when the recorder has its last row
        self._close_log(self._recorder, progress)

    def _close_log(self, recorder: Child, progress: Progress) -> None:
        """Have the recorder write what it has.  Raises ChildFailed."""
        recorder.terminate()
        code = recorder.wait(STOP_TIMEOUT_S)
        self._pass_on(progress)
        if code != 0:
            raise recorder.failed("did not close the log")

    def abandon(self) -> None:
        """Make sure that everything has ended: ask all, give the recorder time to close the log, then kill."""
        every = (*self._agents.values(), self._plant, self._servos, *self._telemetry.values(), self._recorder)
        children = [child for child in every if child]
        for child in children:
            child.terminate()
        wait_all(children, ABANDON_TIMEOUT_S)
        for child in children:
            child.kill()

    def _child(self, name: str, command: ChildCommand) -> Child:
        return Child(name, command.argv(), self._words, main if self._copied else None)

    @property
    def _lockstep(self) -> bool:
        return self._kind is RunKind.LOCKSTEP

    @property
    def _socket(self) -> Path:
        return plant_socket_in(self._runtime)

    def _control(self, arm: str) -> Path:
        return control_in(self._runtime, arm)

    def _ring(self, name: str) -> Path:
        return ring_in(self._runtime, name)

    def _require_alive(self) -> None:
        """Raise ChildFailed when a process that should run has ended, or one that has ended did so with an error."""
        for listening in self._listening():
            if listening.process.poll() not in (None, 0):
                raise listening.failed("ended during the run")
        for child in (*self._agents.values(), self._plant, self._servos):
            if child is not None and child.process.poll() not in (None, 0):
                self._blame(child)

    def _listening(self) -> list[Child]:
        """Recorder and telemetry, as far as they must live."""
        return [child for child in (self._recorder, *self._telemetry.values()) if child is not None]

    def _blame(self, child: Child) -> None:
        """Name the arm that failed first: the others fail because of it."""
        time.sleep(0.3)
        killed = [c for c in self._agents.values() if (c.process.poll() or 0) < 0]
        raise (killed[0] if killed else child).failed("ended during the run")
