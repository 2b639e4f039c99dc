"""`coop run`: plant, agents, telemetry and recorder of a simulated cell on one machine; leaves nothing running."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Protocol

import numpy as np

from agent.config.cell import Cell, load_cell
from agent.host.child import Child
from agent.log.read import read_log
from agent.operator.socket import Verb, ask
from agent.process.folder import LOG_NAME, RunError, output_folder
from agent.process.plant import RING_NAME
from agent.process.recorder import FREE_PORT
from agent.report.report import write_report
from agent.report.results import Results
from agent.telemetry.ring.ring import RingReader
from agent.telemetry.row.sample import AGENT_STATE
from agent.verify.check import examine

READY_TIMEOUT_S = 30.0
STOP_TIMEOUT_S = 20.0
START_IN_NS = 500_000_000
ABANDON_TIMEOUT_S = 5.0
LOOK_EVERY_S = 0.05


class Pace(Enum):
    """What moves the arms, and how fast time passes."""

    LOCKSTEP = "lockstep"  # simulated drivers; time waits for every process
    REAL_TIME = "real time"  # simulated drivers at the wall clock's pace
    WIRE = "wire"  # the real driver on emulated servos, at the wall clock's pace


@dataclass(frozen=True)
class RunOptions:
    """How a run is started."""

    cell: Path
    overrides: tuple[str, ...]
    duration_s: float | None
    out: Path | None
    seed: int
    pace: Pace
    faults: Path | None = None  # of the emulated servos, JSON lines
    replace: bool = False  # an earlier run in `out`


@dataclass(frozen=True)
class RunOutcome:
    """What a run left behind."""

    log: Path
    report: Path
    results: Results
    interrupted: bool
    within_bounds: bool


class Progress(Protocol):
    """Somebody who watches."""

    def phase(self, what: str) -> None:
        """What is being done."""
        ...

    def advance(self, t_s: float, duration_s: float, speed: float, error_mm: float | None) -> None:
        """How far the run is."""
        ...


def run_cell(options: RunOptions, stop: Callable[[], bool], progress: Progress) -> RunOutcome:
    """Run a simulated cell to its end, or to a requested stop.

    Raises Refusal: ConfigError before anything starts, ChildFailed when a process ends early (everything else
    is then stopped and the log is closed and readable).
    """
    if options.faults is not None and options.pace is not Pace.WIRE:
        raise RunError(
            "faults", found=f"{options.faults} without --wire", expected="emulated servos", remedy="add --wire"
        )
    overrides = list(options.overrides)
    if options.duration_s is not None:
        overrides.append(f"duration_s={options.duration_s}")
    cell = load_cell(options.cell, overrides)
    progress.phase("checking")
    examine(cell, wired=options.pace is Pace.WIRE).require()
    out = output_folder(options.out, cell.file.name, replace=options.replace)
    runtime = Path(tempfile.mkdtemp(prefix="coop-", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    try:
        run = _Run(cell, options, out, runtime)
        try:
            run.start(progress)
            interrupted = run.watch(stop, progress)
            run.end(progress)
        finally:
            run.abandon()
    finally:
        shutil.rmtree(runtime, ignore_errors=True)
    progress.phase("report")
    log = read_log(out / LOG_NAME)
    report = write_report(log, out)
    progress.phase("done")
    return RunOutcome(out / LOG_NAME, report.html, report.results, interrupted, report.results.within_bounds)


class _Run:
    """The processes of one run."""

    def __init__(self, cell: Cell, options: RunOptions, out: Path, runtime: Path) -> None:
        self._cell = cell
        self._options = options
        self._out = out
        self._runtime = runtime
        self._logs = out / "logs"
        self._logs.mkdir(exist_ok=True)
        self._cell_path = runtime / "cell.toml"
        self._cell_path.write_bytes(cell.toml)
        self._lockstep = options.pace is Pace.LOCKSTEP
        self._pace = [] if self._lockstep else ["--real-time"]
        self._telemetry_pace = ["--lockstep"] if self._lockstep else []
        self._recorder: Child | None = None
        self._plant: Child | None = None
        self._agents: dict[str, Child] = {}
        self._telemetry: dict[str, Child] = {}
        self._began = 0.0

    def start(self, progress: Progress) -> None:
        """Start everything, recorder first, so that no row is before its time."""
        progress.phase("starting")
        cell = str(self._cell_path)
        self._recorder = self._child("recorder", self._recorder_command(cell))
        self._plant = self._child("plant", self._plant_command(cell))
        self._plant.wait_ready(READY_TIMEOUT_S)
        for arm in self._cell.arms:
            self._agents[arm.name] = self._child(f"arm-{arm.name}", self._agent_command(cell, arm.name))
        endpoint = self._recorder.wait_ready(READY_TIMEOUT_S)["endpoint"]
        for name in (RING_NAME, *self._agents):
            self._telemetry[name] = self._child(
                f"telemetry-{name}",
                ["telemetry", cell, "--member", name, "--ring", str(self._ring(name)), "--connect", endpoint,
                 *self._telemetry_pace],
            )  # fmt: skip
        for child in (*self._agents.values(), *self._telemetry.values()):
            child.wait_ready(READY_TIMEOUT_S)
        if not self._lockstep:
            self._start_together(progress)
        self._began = time.monotonic()

    def _start_together(self, progress: Progress) -> None:
        """Give all arms one start instant once each of them holds its start pose."""
        progress.phase("torque on")
        for child in self._agents.values():
            child.wait_ready(READY_TIMEOUT_S)
        start_utc_ns = time.time_ns() + START_IN_NS
        for arm in self._agents:
            ask(self._control(arm), Verb.START, start_utc_ns=start_utc_ns, fingerprint=self._cell.fingerprint)

    def _recorder_command(self, cell: str) -> list[str]:
        driver = "dynamixel" if self._options.pace is Pace.WIRE else "sim"
        log, seed = str(self._out / LOG_NAME), str(self._options.seed)
        return [
            "record", cell, "--out", log, "--listen", FREE_PORT, "--driver", driver, "--truth", "--seed", seed
        ]  # fmt: skip

    def _plant_command(self, cell: str) -> list[str]:
        ring = ["--ring", str(self._ring(RING_NAME))]
        if self._options.pace is Pace.WIRE:
            faults = ["--faults", str(self._options.faults)] if self._options.faults is not None else []
            return ["emulate", cell, "--ports", str(self._runtime), "--seed", str(self._options.seed), *faults, *ring]
        return ["plant", cell, "--socket", str(self._socket), *ring, *self._pace]

    def _agent_command(self, cell: str, arm: str) -> list[str]:
        common = ["agent", cell, "--arm", arm, "--ring", str(self._ring(arm)), "--control", str(self._control(arm))]
        if self._options.pace is Pace.WIRE:
            return [*common, "--driver", "dynamixel", "--port", str(self._runtime / arm), "--emulated"]
        return [*common, "--driver", "sim", "--plant-socket", str(self._socket), *self._pace]

    def watch(self, stop: Callable[[], bool], progress: Progress) -> bool:
        """Watch until every agent has ended; True when a stop was requested.  Raises ChildFailed."""
        progress.phase("running")
        first = self._cell.arms[0].name
        with RingReader(self._ring(first), AGENT_STATE) as rows:
            while any(child.process.poll() is None for child in self._agents.values()):
                self._require_alive()
                if stop():
                    for child in self._agents.values():
                        child.terminate()
                    return True
                self._show(rows, progress)
                time.sleep(LOOK_EVERY_S)
            self._show(rows, progress)
        self._require_alive()
        return False

    def end(self, progress: Progress) -> None:
        """End everything in the order in which nothing is lost."""
        progress.phase("closing the log")
        _wait_all(self._agents.values(), STOP_TIMEOUT_S)
        assert self._plant is not None
        assert self._recorder is not None
        if self._options.pace is Pace.WIRE:  # emulated servos serve until they are told to stop
            self._plant.terminate()
        if self._plant.wait(STOP_TIMEOUT_S) is None:
            self._plant.terminate()
        _wait_all(self._telemetry.values(), STOP_TIMEOUT_S)  # each ends when the recorder has its last row
        self._recorder.terminate()
        if self._recorder.wait(STOP_TIMEOUT_S) != 0:
            raise self._recorder.failed("did not close the log")

    def abandon(self) -> None:
        """Make sure that everything has ended: ask all, give the recorder time to close the log, then kill."""
        children = [c for c in (*self._agents.values(), self._plant, *self._telemetry.values(), self._recorder) if c]
        for child in children:
            child.terminate()
        _wait_all(children, ABANDON_TIMEOUT_S)
        for child in children:
            child.kill()

    def _child(self, name: str, arguments: Sequence[str]) -> Child:
        return Child(name, arguments, self._logs)

    @property
    def _socket(self) -> Path:
        return self._runtime / "plant.sock"

    def _control(self, arm: str) -> Path:
        return self._runtime / f"{arm}.control"

    def _ring(self, name: str) -> Path:
        return self._runtime / f"{name}.ring"

    def _require_alive(self) -> None:
        """Raise ChildFailed when a process that should run has ended, or one that has ended did so with an error."""
        lasting = {"recorder": self._recorder, **self._telemetry}
        for child in lasting.values():
            if child is not None and child.process.poll() not in (None, 0):
                raise child.failed("ended during the run")
        for child in (*self._agents.values(), self._plant):
            if child is not None and child.process.poll() not in (None, 0):
                self._blame(child)

    def _blame(self, child: Child) -> None:
        """Name the arm that failed first: the others fail because of it."""
        time.sleep(0.3)
        killed = [c for c in self._agents.values() if (c.process.poll() or 0) < 0]
        raise (killed[0] if killed else child).failed("ended during the run")

    def _show(self, rows: RingReader, progress: Progress) -> None:
        block = rows.read_at(rows.written - 1, 1) if rows.written else None
        if block is None or not block.count:
            return
        row = AGENT_STATE.decode(block.payload)[0]
        t = float(row["t"])
        elapsed = max(time.monotonic() - self._began, 1e-3)
        progress.advance(t, self._cell.file.duration_s, t / elapsed, float(np.linalg.norm(row["e_p"])) * 1e3)


def _wait_all(children: Iterable[Child], timeout_s: float) -> None:
    deadline = time.monotonic() + timeout_s
    for child in children:
        child.wait(max(0.0, deadline - time.monotonic()))
