"""`coop run`: a simulated cell from its check to its report, as processes of one machine; none of them outlives it."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from agent.config.cell import Cell, load_cell
from agent.log.read import open_log
from agent.process.children import Children, Progress, RunKind
from agent.report.report import write_report
from agent.report.results import Results
from agent.verify.check import examine
from drivers.interface import Refusal


class RunError(Refusal):
    """The run could not be started or did not come to its end."""


@dataclass(frozen=True)
class RunOptions:
    """How a run is started."""

    cell: Path
    overrides: tuple[str, ...]
    duration_s: float | None
    out: Path | None
    seed: int
    kind: RunKind
    faults: Path | None = None  # of the emulated servos, JSON lines


@dataclass(frozen=True)
class RunOutcome:
    """What a run left behind."""

    log: Path
    report: Path
    results: Results
    interrupted: bool
    within_bounds: bool


def run_cell(options: RunOptions, stop: Callable[[], bool], progress: Progress) -> RunOutcome:
    """Run a simulated cell to its end, or to a requested stop.

    Raises Refusal: ConfigError before anything starts, ChildFailed when a process ends early (everything else
    is then stopped and the log is closed and readable).
    """
    if options.faults is not None and options.kind is not RunKind.WIRE:
        raise RunError(
            "faults", found=f"{options.faults} without --wire", expected="emulated servos", remedy="add --wire"
        )
    overrides = list(options.overrides)
    if options.duration_s is not None:
        overrides.append(f"duration_s={options.duration_s}")
    cell = load_cell(options.cell, overrides)
    progress.phase("checking")
    examine(cell, wired=options.kind is RunKind.WIRE).require()
    out = _output_folder(options.out, cell)
    log = out / "run.mcap"
    runtime = Path(tempfile.mkdtemp(prefix="coop-", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    try:
        children = Children(cell, options.kind, options.seed, options.faults, log, runtime)
        try:
            children.start(progress)
            interrupted = children.watch(stop, progress)
            children.end(progress)
        finally:
            children.abandon()
    finally:
        shutil.rmtree(runtime, ignore_errors=True)
    progress.phase("report")
    with open_log(log) as opened:
        report = write_report(opened, out)
    progress.phase("done")
    return RunOutcome(log, report.html, report.results, interrupted, report.results.within_bounds)


def _output_folder(wanted: Path | None, cell: Cell) -> Path:
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    out = wanted or Path("runs") / f"{stamp}-{cell.file.name}"
    if (out / "run.mcap").exists():
        raise RunError(
            "output folder", found=f"{out / 'run.mcap'} from an earlier run", expected="a folder without a log",
            remedy="name another folder with --out",
        )  # fmt: skip
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        raise RunError(
            f"output folder {out}", found=error.strerror, expected="a folder that can be written",
            remedy="name another folder with --out, or change its permissions",
        ) from error  # fmt: skip
    return out
