"""`coop run`: a simulated cell from its check to its report, as processes of one machine; none of them outlives it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from agent.config.cell import Cell, load_cell
from agent.config.reading import validate
from agent.config.schema.types import Seed, Strict
from agent.host.signals import StopFlag
from agent.log.read import open_log
from agent.process.befallen import require_done
from agent.process.children import Children
from agent.process.folder import LOG_NAME, RunError, output_folder, words_of
from agent.process.progress import Progress
from agent.process.real_arms import RealArms, RealChildren
from agent.process.rehearse import in_the_loop, require_wall_clock
from agent.process.run_folder import rings_bytes, run_folder
from agent.process.run_kind import RunKind
from agent.report.names import picture_files
from agent.report.results import Results
from agent.report.results_file import write_results
from agent.telemetry.link.endpoint import FREE_PORT, require_endpoint
from agent.verify.check import examine

LIFT_M = 0.02  # of a cell without [session] that is asked for a whole one


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
    replace: bool = False  # an earlier run in `out`
    listen: str = FREE_PORT  # where the recorder listens, for viewers
    report: bool = True  # else the results alone
    whole: bool = False  # emulated arms, from rest to rest
    real: RealArms | None = None  # the arms of [hil] are real ones; None: emulated


@dataclass(frozen=True)
class RunOutcome:
    """What a run left behind."""

    log: Path
    report: Path | None
    results: Results
    interrupted: bool
    within_bounds: bool
    gave_up: str = ""  # why a session went no further; its arms came back as far as they could


class ReportStopped(RunError):
    """A person did not wait for the report; the log is complete."""

    exit_code = 130


def run_cell(options: RunOptions, stop: StopFlag, progress: Progress) -> RunOutcome:
    """Run a simulated cell to its end, or to a requested stop.

    Raises Refusal: ConfigError before anything starts, ChildFailed when a process ends early (everything else
    is then stopped and the log is closed and readable), StoppedEarly when a stop comes while processes start,
    ReportStopped when it comes while the report is made.  A stop before anything starts is a KeyboardInterrupt.
    """
    with stop.interrupting():
        cell = _examined(options, progress)
    arms = [arm.name for arm in cell.arms]
    own = [*words_of(arms), *(picture_files(arms) if options.report else ())]
    with output_folder(options.out, cell.file.name, own=own, replace=options.replace) as out:
        log = out / LOG_NAME
        interrupted, gave_up = _carry_out(options, cell, log, stop, progress)
        progress.phase("report")
        page, results = _reported(log, out, stop, drawn=options.report)
    progress.phase("done")
    return RunOutcome(log, page, results, interrupted, results.within_bounds, gave_up)


def _examined(options: RunOptions, progress: Progress) -> Cell:
    """The cell, which may run.  Raises Refusal."""
    cell = _cell_of(options)
    require_wall_clock(cell, real_time=options.kind is RunKind.HIL, found=f"a run in {options.kind.value}")
    require_done(cell, stops=True, alone=cell.file.looped, whole=options.whole)
    if options.real is not None:
        options.real.require(cell, options.faults)
    if options.faults is not None:
        _require_faults(options.faults, cell, options.kind)
    progress.phase("checking")
    examine(cell, wired=options.kind.has_servos).require()
    return cell


def _carry_out(options: RunOptions, cell: Cell, log: Path, stop: StopFlag, progress: Progress) -> tuple[bool, str]:
    """Run all processes to their end; whether that was asked for, and why a session went no further."""
    room = rings_bytes(len(cell.arms)) if options.real is None else None
    with run_folder(room, progress.note) as runtime:
        children = _children(options, cell, log, runtime)
        try:
            children.start(stop, progress)
            interrupted = children.watch(stop, progress)
            children.end(progress)
        finally:
            children.abandon()
    return interrupted, "" if children.person is None else children.person.trouble


class _Asked(Strict):
    """What of the command has the range that it has in files."""

    seed: Seed


def _cell_of(options: RunOptions) -> Cell:
    """The cell as it is to run.  Raises RunError for what it cannot be asked, EndpointError, ConfigError."""
    validate(_Asked, {"seed": options.seed}, "the command")
    require_endpoint(options.listen)
    if options.faults is not None and not options.kind.has_servos:
        raise RunError(
            "faults", found=f"{options.faults} without --wire", expected="emulated servos", remedy="add --wire"
        )
    if options.whole and options.kind is not RunKind.WIRE:
        raise RunError(
            "--whole", found=f"a run in {options.kind.value}", expected="emulated servos, which have grippers",
            remedy="add --wire",
        )  # fmt: skip
    overrides = list(options.overrides)
    if options.duration_s is not None:
        overrides.append(f"duration_s={options.duration_s}")
    cell = load_cell(options.cell, overrides)
    if options.whole and cell.file.session is None:
        cell = load_cell(options.cell, [*overrides, f"session.lift_m={LIFT_M}"])
    if cell.file.floating is not None:
        raise RunError(
            f"cell {cell.file.name}", found="[floating], by which arms wait for a hand", expected="arms that work",
            remedy="`coop float`, or remove the table",
        )  # fmt: skip
    if cell.file.duration_s * cell.file.rate_hz < 1.0 - 1e-9:
        raise RunError(
            f"duration_s of cell {cell.file.name}", found=f"{cell.file.duration_s:g} s",
            expected=f"one cycle at least, {1.0 / cell.file.rate_hz:g} s", remedy="lengthen the run",
        )  # fmt: skip
    return cell


def _require_faults(path: Path, cell: Cell, kind: RunKind) -> None:
    """Raise FaultError unless the file is about servos that this run emulates."""
    from agent.process.emulate import require_faults  # noqa: PLC0415 - emulated servos, which few runs have fail

    require_faults(path, [arm for arm in cell.arms if kind is RunKind.WIRE or in_the_loop(cell, arm.name)])


def _children(options: RunOptions, cell: Cell, log: Path, runtime: Path) -> Children:
    given = cell, options.kind, options.seed, options.faults, log, runtime, options.listen
    if options.real is not None:
        return RealChildren(*given, real=options.real, cell_path=options.cell)
    return Children(*given, whole=options.whole)


def _reported(log: Path, out: Path, stop: StopFlag, *, drawn: bool) -> tuple[Path | None, Results]:
    """Write the results beside a log, with the page of the report if it is to be drawn.  Raises ReportStopped."""
    try:
        with stop.interrupting(), open_log(log) as opened:
            if not drawn:
                return None, write_results(opened, out)
            from agent.report.report import write_report  # noqa: PLC0415 - figures cost 0.3 s, and not every run has any
            from agent.view.film import still  # noqa: PLC0415 - figures, too

            written = write_report(opened, out, still)
            return written.html, written.results
    except KeyboardInterrupt:
        raise ReportStopped(
            f"report of {log}", found="a stop while it was made", expected="time to make it; the log is complete",
            remedy="`coop report` makes it",
        ) from None  # fmt: skip
