"""`coop float`: arms of a cell that a hand guides, as processes of one machine, with a log; none of them outlives it.

Arms that move while others float do so from one instant on, and end as they do: at a stop, and where the motion ends.
A stop, one arm that stops by itself and one that fails let all of them stand and sink; nobody kills one that sinks.
Each arm has a guard: where its process is killed or hangs, that lets it stand and sink.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

from agent.config.cell import Cell
from agent.config.schema.driver import DriverKind
from agent.host.child import Child, wait_all
from agent.modes import Mode
from agent.operator.words import start_patiently
from agent.process.children import READY_TIMEOUT_S, STOP_TIMEOUT_S
from agent.process.commands import (
    AgentCommand,
    ChildCommand,
    EmulateCommand,
    GuardCommand,
    RecordCommand,
    TelemetryCommand,
)
from agent.process.describe import run_info
from agent.process.float_loop import SINK_MAX_S, STAND_S
from agent.process.floating_cell import FloatOptions, moving, names_of, port_for
from agent.process.folder import LOG_NAME, output_folder
from agent.process.glance import Glance, Window
from agent.process.run_folder import run_folder
from agent.telemetry.link.session import FREE_PORT
from drivers.clock import utc_offset_ns

END_TIMEOUT_S = STAND_S + SINK_MAX_S + 10.0
START_IN_NS = 3_000_000_000  # grippers have closed by then, and the torque at rest has been looked at
LOOK_EVERY_S = 0.1
_STOPPED = frozenset({Mode.STAND, Mode.SINK, Mode.FAULT})


class Screen(Protocol):
    """Somebody who watches."""

    def phase(self, what: str) -> None:
        """What is being done."""
        ...

    def note(self, text: str) -> None:
        """Something that stays to be read."""
        ...

    def show(self, glances: Sequence[Glance]) -> None:
        """How the arms are."""
        ...


def float_arms(cell: Cell, options: FloatOptions, stop: Callable[[], bool], screen: Screen) -> Path:
    """Let the arms float until a stop, or until one of them stops; returns the log.

    Raises Refusal; every torque is off and the log is closed by then.
    """
    with (
        output_folder(options.out, f"{cell.file.name}-float", has_force=False) as out,
        run_folder() as runtime,
    ):
        arms = FloatingArms(cell, options, out, runtime)
        try:
            arms.start(screen)
            arms.watch(stop, screen)
            arms.end(screen)
        finally:
            arms.abandon()
    return out / LOG_NAME


class FloatingArms:
    """The processes; what they share lies in `runtime`, their words in a folder `logs` beside the log."""

    def __init__(self, cell: Cell, options: FloatOptions, out: Path, runtime: Path) -> None:
        self._cell, self._options, self._out, self._runtime = cell, options, out, runtime
        self._words = out / "logs"
        self._words.mkdir(exist_ok=True)
        self._cell_path, self._run_info_path = runtime / "cell.toml", runtime / "run.json"
        self._cell_path.write_bytes(cell.toml)
        self._run_info_path.write_bytes(run_info(cell, DriverKind.DYNAMIXEL, seed=0))
        self._utc_offset_ns = utc_offset_ns()  # one for all arms: the wall clock may be set between starts
        self._recorder: Child | None = None
        self._servos: Child | None = None
        self._agents: dict[str, Child] = {}
        self._guards: dict[str, Child] = {}
        self._killed_s: dict[str, float] = {}
        self._telemetry: dict[str, Child] = {}

    def start(self, screen: Screen) -> None:
        """Start everything, recorder first; returns once every arm floats, or is told when to move.

        Raises ChildFailed, ControlError.
        """
        screen.phase("starting")
        self._recorder = self._child("recorder", self._record_command())
        if self._options.emulate:
            self._servos = self._child("servos", self._emulate_command())
            self._servos.wait_ready(READY_TIMEOUT_S)
        for name in names_of(self._cell):
            self._guards[name] = self._child(f"guard-{name}", self._guard_command(name))
        for name, guard in self._guards.items():
            guard.wait_ready(READY_TIMEOUT_S)
            self._agents[name] = self._child(f"arm-{name}", self._agent_command(name))
        endpoint = self._recorder.wait_ready(READY_TIMEOUT_S)["endpoint"]
        for name, child in self._agents.items():
            child.wait_ready(READY_TIMEOUT_S)
            self._telemetry[name] = self._child(f"telemetry-{name}", self._telemetry_command(name, endpoint))
        screen.phase("torque on")
        for child in (*self._telemetry.values(), *self._agents.values()):
            child.wait_ready(READY_TIMEOUT_S)
        moved = {arm.name: [self._control(arm.name)] for arm in moving(self._cell)}
        if moved:
            start_patiently(moved, self._cell.fingerprint, START_IN_NS, lambda: None)

    def watch(self, stop: Callable[[], bool], screen: Screen) -> None:
        """Show the arms until every one of them has ended.  Raises ChildFailed for one that failed."""
        assert self._recorder is not None
        windows = [Window(self._cell, self._cell.arm(name), self._ring(name)) for name in self._agents]
        try:
            told = False
            while self._alive():
                glances = [window.look() for window in windows]
                screen.show(glances)
                for text in self._recorder.told():
                    screen.note(text)
                if not told and (stop() or self._one_stopped(glances)):
                    told = True
                    self._stop_all()
                time.sleep(LOOK_EVERY_S)
        finally:
            for window in windows:
                window.close()
        for name, child in self._agents.items():
            if child.process.poll() != 0:
                raise child.failed(self._ended(name))

    def end(self, screen: Screen) -> None:
        """End the rest in the order in which nothing is lost.  Raises ChildFailed."""
        screen.phase("closing the log")
        assert self._recorder is not None
        wait_all(self._telemetry.values(), STOP_TIMEOUT_S)
        self._recorder.terminate()
        if self._recorder.wait(STOP_TIMEOUT_S) != 0:
            raise self._recorder.failed("did not close the log")

    def abandon(self) -> None:
        """Make sure that everything has ended: arms first, which take their time to sink, then the rest."""
        self._stop_all()
        wait_all(self._agents.values(), END_TIMEOUT_S)
        self._note_deaths()
        wait_all([guard for name, guard in self._guards.items() if self._in_its_place(name)], END_TIMEOUT_S)
        for guard in self._guards.values():
            guard.terminate()
        wait_all(self._guards.values(), STOP_TIMEOUT_S)
        others = [c for c in (*self._telemetry.values(), self._servos, self._recorder) if c is not None]
        wait_all(self._telemetry.values(), STOP_TIMEOUT_S if self._agents else 0.0)
        for child in others:
            child.terminate()
        wait_all(others, STOP_TIMEOUT_S)
        for child in (*self._agents.values(), *self._guards.values(), *others):
            child.kill()

    def _alive(self) -> bool:
        return any(code is None or self._in_its_place(name) for name, code in self._note_deaths().items())

    def _note_deaths(self) -> dict[str, int | None]:
        """How each arm's process has ended, None: not yet; keeps since when it is known to be killed."""
        codes = {name: child.process.poll() for name, child in self._agents.items()}
        for name, code in codes.items():
            if code is not None and code < 0:
                self._killed_s.setdefault(name, time.monotonic())
        return codes

    def _in_its_place(self, name: str) -> bool:
        """Whether the arm's process was killed, and its guard may still be letting the arm down."""
        if name not in self._killed_s or self._guards[name].process.poll() is not None:
            return False
        return time.monotonic() - self._killed_s[name] < END_TIMEOUT_S  # longer: it has nothing to let down

    def _ended(self, name: str) -> str:
        let_down = self._guards[name].process.poll() == 0
        how = "its guard has let the arm down" if let_down else "the arm has no torque any more"
        return f"ended while it floated; {how}"

    def _one_stopped(self, glances: Sequence[Glance]) -> bool:
        """Whether an arm has stopped by itself, or is gone: the others must not go on floating with the object."""
        ended = any(child.process.poll() is not None for child in self._agents.values())
        lost = any(c is not None and c.process.poll() is not None for c in (self._recorder, self._servos))
        return ended or lost or any(glance.mode in _STOPPED for glance in glances)

    def _stop_all(self) -> None:
        for child in self._agents.values():
            child.terminate()

    def _record_command(self) -> RecordCommand:
        return RecordCommand(
            cell=self._cell_path, out=self._out / LOG_NAME, listen=FREE_PORT, driver=DriverKind.DYNAMIXEL,
            truth=False, seed=0, run_info=self._run_info_path,
        )  # fmt: skip

    def _emulate_command(self) -> EmulateCommand:
        return EmulateCommand(
            cell=self._cell_path, ports=self._runtime, ring=self._runtime / "plant.ring", faults=None, seed=0,
            utc_offset_ns=self._utc_offset_ns,
        )  # fmt: skip

    def _agent_command(self, name: str) -> AgentCommand:
        return AgentCommand(
            cell=self._cell_path, arm=name, ring=self._ring(name), control=self._control(name),
            driver=DriverKind.DYNAMIXEL, port=self._port(name), emulated=self._options.emulate,
            priority=self._options.priority, guard=self._runtime / f"{name}.guard",
            allow_no_realtime=self._options.no_realtime, utc_offset_ns=self._utc_offset_ns,
        )  # fmt: skip

    def _guard_command(self, name: str) -> GuardCommand:
        return GuardCommand(
            cell=self._cell_path, arm=name, socket=self._runtime / f"{name}.guard",
            control=self._control(name), post_mortem=self._out, driver=DriverKind.DYNAMIXEL,
            port=self._port(name), emulated=self._options.emulate, priority=self._options.priority,
        )  # fmt: skip

    def _port(self, name: str) -> str:
        return str(self._runtime / name) if self._options.emulate else port_for(self._cell, self._options, name)

    def _telemetry_command(self, name: str, endpoint: str) -> TelemetryCommand:
        return TelemetryCommand(
            cell=self._cell_path, member=name, ring=self._ring(name), connect=endpoint, lockstep=False,
            cell_name=self._cell.file.name, fingerprint=self._cell.fingerprint,
        )  # fmt: skip

    def _child(self, name: str, command: ChildCommand) -> Child:
        return Child(name, command.argv(), self._words)

    def _control(self, name: str) -> Path:
        return self._runtime / f"{name}.control"

    def _ring(self, name: str) -> Path:
        return self._runtime / f"{name}.ring"
