"""`coop float`: arms of a cell that a hand guides, as processes of one machine, with a log; none of them outlives it.

A stop, one arm that stops by itself and one that fails let all of them stand and sink; nobody kills one that sinks.
Each arm has a guard: where its process is killed or hangs, that lets it stand and sink.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from agent.config.cell import Cell, cell_from_toml, load_cell
from agent.config.schema.cell import DriverKind
from agent.host.child import Child, ChildFailed
from agent.modes import Mode
from agent.process.build import Connection, port_of
from agent.process.commands import (
    AgentCommand,
    ChildCommand,
    EmulateCommand,
    GuardCommand,
    RecordCommand,
    TelemetryCommand,
)
from agent.process.describe import run_info
from agent.process.float_loop import SINK_MAX_S, STAND_S, FloatError
from agent.process.folder import LOG_NAME, output_folder
from agent.process.glance import Glance, Window
from agent.telemetry.link.session import FREE_PORT
from drivers.dynamixel.line.ports import busy_error, holders, open_error

READY_TIMEOUT_S = 30.0
END_TIMEOUT_S = STAND_S + SINK_MAX_S + 10.0
STOP_TIMEOUT_S = 20.0
LOOK_EVERY_S = 0.1
_STOPPED = frozenset({Mode.STAND, Mode.SINK, Mode.FAULT})


@dataclass(frozen=True)
class FloatOptions:
    """How arms are let float."""

    cell: Path
    arms: tuple[str, ...]
    overrides: tuple[str, ...] = ()
    holding: bool = False
    ports: Path | None = None  # folder with a port per arm; None: the cell's
    emulate: bool = False  # on emulated servos of this command's own
    out: Path | None = None
    priority: int | None = None


class Screen(Protocol):
    """Somebody who watches."""

    def phase(self, what: str) -> None:
        """What is being done."""
        ...

    def show(self, glances: Sequence[Glance]) -> None:
        """How the arms are."""
        ...


def floating_cell(options: FloatOptions) -> Cell:
    """The cell, told which arms float.  Raises ConfigError, FloatError."""
    own = [change for change in options.overrides if change.strip().startswith("floating.")]
    others = [change for change in options.overrides if change not in own]
    if options.arms:
        names = ", ".join(f'"{name}"' for name in options.arms)
        own.append(f"floating.arms=[{names}]")
    if options.holding:
        own.append("floating.holding=true")
    cell = load_cell(options.cell, others)
    if cell.file.floating is None and not options.arms:
        names = " or ".join(arm.name for arm in cell.arms)
        raise FloatError("arms that are to float", found="none", expected="--arm NAME", remedy=f"name {names}")
    if cell.file.floating is not None:
        return load_cell(options.cell, [*others, *own])
    return _with_table(cell, own, options.cell.name)


def _with_table(cell: Cell, changes: Sequence[str], source: str) -> Cell:
    """The cell with a table [floating] behind all else, so that the log keeps its comments.  Raises ConfigError."""
    lines = [change.strip().removeprefix("floating.") for change in changes]
    table = "\n".join(["", "[floating]", *lines, ""])
    return cell_from_toml(cell.toml.rstrip() + b"\n" + table.encode(), source)


def require_ports(cell: Cell, options: FloatOptions) -> None:
    """Refuse ports that are not there, may not be used or are in use.  Raises ConnectError."""
    for name in _floating(cell):
        path = _port(cell, options, name)
        try:
            os.close(os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC))
        except OSError as error:
            raise open_error(path, error) from error
        if holders(path):
            raise busy_error(path)


def float_arms(cell: Cell, options: FloatOptions, stop: Callable[[], bool], screen: Screen) -> Path:
    """Let the arms float until a stop, or until one of them stops; returns the log.

    Raises Refusal; every torque is off and the log is closed by then.
    """
    out = output_folder(options.out, f"{cell.file.name}-float")
    runtime = Path(tempfile.mkdtemp(prefix="coop-", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    try:
        arms = FloatingArms(cell, options, out, runtime)
        try:
            arms.start(screen)
            arms.watch(stop, screen)
            arms.end(screen)
        finally:
            arms.abandon()
    finally:
        shutil.rmtree(runtime, ignore_errors=True)
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
        self._recorder: Child | None = None
        self._servos: Child | None = None
        self._agents: dict[str, Child] = {}
        self._guards: dict[str, Child] = {}
        self._killed_s: dict[str, float] = {}
        self._telemetry: dict[str, Child] = {}

    def start(self, screen: Screen) -> None:
        """Start everything, recorder first; returns once every arm floats.  Raises ChildFailed."""
        screen.phase("starting")
        self._recorder = self._child("recorder", self._record_command())
        if self._options.emulate:
            self._servos = self._child("servos", self._emulate_command())
            self._servos.wait_ready(READY_TIMEOUT_S)
        for name in _floating(self._cell):
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

    def watch(self, stop: Callable[[], bool], screen: Screen) -> None:
        """Show the arms until every one of them has ended.  Raises ChildFailed for one that failed."""
        windows = [Window(self._cell, self._cell.arm(name), self._ring(name)) for name in self._agents]
        try:
            told = False
            while self._alive():
                glances = [window.look() for window in windows]
                screen.show(glances)
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
        _wait_all(self._telemetry.values(), STOP_TIMEOUT_S)
        self._recorder.terminate()
        if self._recorder.wait(STOP_TIMEOUT_S) != 0:
            raise self._recorder.failed("did not close the log")

    def abandon(self) -> None:
        """Make sure that everything has ended: arms first, which take their time to sink, then the rest."""
        self._stop_all()
        _wait_all(self._agents.values(), END_TIMEOUT_S)
        _wait_all([guard for name, guard in self._guards.items() if self._in_its_place(name)], END_TIMEOUT_S)
        for guard in self._guards.values():
            guard.terminate()
        _wait_all(self._guards.values(), STOP_TIMEOUT_S)
        others = [c for c in (*self._telemetry.values(), self._servos, self._recorder) if c is not None]
        _wait_all(self._telemetry.values(), STOP_TIMEOUT_S if self._agents else 0.0)
        for child in others:
            child.terminate()
        _wait_all(others, STOP_TIMEOUT_S)
        for child in (*self._agents.values(), *self._guards.values(), *others):
            child.kill()

    def _alive(self) -> bool:
        return any(child.process.poll() is None or self._in_its_place(name) for name, child in self._agents.items())

    def _in_its_place(self, name: str) -> bool:
        """Whether the arm's process was killed, and its guard may still be letting the arm down."""
        agent, guard = self._agents.get(name), self._guards[name]
        code = None if agent is None else agent.process.poll()
        if code is None or code >= 0 or guard.process.poll() is not None:
            return False
        now_s = time.monotonic()
        return now_s - self._killed_s.setdefault(name, now_s) < END_TIMEOUT_S  # longer: it has nothing to let down

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
            cell=self._cell_path, ports=self._runtime, ring=self._runtime / "plant.ring", faults=None, seed=0
        )

    def _agent_command(self, name: str) -> AgentCommand:
        return AgentCommand(
            cell=self._cell_path, arm=name, ring=self._ring(name), control=self._runtime / f"{name}.control",
            driver=DriverKind.DYNAMIXEL, port=self._port(name), emulated=self._options.emulate,
            priority=self._options.priority, guard=self._runtime / f"{name}.guard",
        )  # fmt: skip

    def _guard_command(self, name: str) -> GuardCommand:
        return GuardCommand(
            cell=self._cell_path, arm=name, socket=self._runtime / f"{name}.guard",
            control=self._runtime / f"{name}.control", post_mortem=self._out, driver=DriverKind.DYNAMIXEL,
            port=self._port(name), emulated=self._options.emulate, priority=self._options.priority,
        )  # fmt: skip

    def _port(self, name: str) -> Path:
        return self._runtime / name if self._options.emulate else Path(_port(self._cell, self._options, name))

    def _telemetry_command(self, name: str, endpoint: str) -> TelemetryCommand:
        return TelemetryCommand(
            cell=self._cell_path, member=name, ring=self._ring(name), connect=endpoint, lockstep=False
        )

    def _child(self, name: str, command: ChildCommand) -> Child:
        return Child(name, command.argv(), self._words)

    def _ring(self, name: str) -> Path:
        return self._runtime / f"{name}.ring"


def _floating(cell: Cell) -> Sequence[str]:
    assert cell.file.floating is not None, "floating_cell has seen to it"
    return cell.file.floating.arms


def _port(cell: Cell, options: FloatOptions, name: str) -> str:
    given = None if options.ports is None else str(options.ports / name)
    return port_of(cell.arm(name), Connection(port=given))


def _wait_all(children: Iterable[Child], timeout_s: float) -> None:
    deadline = time.monotonic() + timeout_s
    for child in children:
        child.wait(max(0.0, deadline - time.monotonic()))


__all__ = ["ChildFailed", "FloatOptions", "FloatingArms", "Screen", "float_arms", "floating_cell", "require_ports"]
