"""The commands on logs: report, compare, identify, calibrate, export, play, recover, layout."""

from __future__ import annotations

import math
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from agent.cli.options import (
    DEFAULT_ENDPOINT,
    AsJson,
    CellPath,
    Force,
    LogPath,
    NetworkConfig,
    Overrides,
    console,
    instant,
    note,
    print_json,
)
from agent.cli.progress import Steps
from agent.cli.results import show_results
from agent.host.ready_line import pairs
from agent.host.starting import ready

if TYPE_CHECKING:
    from agent.log.read import AnyLog

VIEW = "view.html"  # beside a report that was asked for it


def report(
    log: LogPath,
    out: Annotated[Path | None, typer.Option(help="Folder of the report (default: beside the log).")] = None,
    view: Annotated[bool, typer.Option("--view", help="Also view.html, the run in 3D (some seconds).")] = False,
    force: Force = False,
) -> None:
    """Make the figures, the page and results.json from a log alone; its own earlier report is replaced."""
    from agent.log.read import open_log
    from agent.report.report import keep_other_reports, write_report
    from agent.view.film import still

    folder = out or log.parent
    if not force:
        keep_other_reports(log, folder)
    with Steps() as step:
        step("reading the log")
        with open_log(log) as opened:
            step("drawing")
            files = write_report(opened, folder, still, keeps=not force, beside=[VIEW] if view else [])
            if view:
                step("drawing in 3D")
                _write_view(opened, folder)
    show_results(files.results, log)
    typer.echo(f"report   {files.html}")


def _require_some(logs: list[Path], most: int) -> None:
    from agent.report.compare import CompareError

    if not 2 <= len(logs) <= most:
        raise CompareError("coop compare", found=f"{len(logs)} logs", expected=f"2 to {most}", remedy="name so many")


def _write_view(log: AnyLog, folder: Path) -> None:
    from agent.report.prepared import prepare
    from agent.view.need import need_viser

    need_viser()
    from agent.view.html import write_html

    write_html(prepare(log), folder / VIEW)


def compare(
    logs: Annotated[list[Path], typer.Argument(metavar="A B [C ...]", help="MCAP logs.", show_default=False)],
    html: Annotated[Path | None, typer.Option(help="Also write a page.")] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Say which figures and settings of logs differ, and which log has the better ones, each against the first."""
    from agent.atomic import require_place
    from agent.log.read import open_log
    from agent.report.compare import compare as differences
    from agent.report.compare import comparison_table
    from agent.report.metrics import summarise_prepared
    from agent.report.prepared import prepare
    from agent.report.settings import settings_of, settings_table
    from agent.report.shown import LETTERS, ComparedRun, error_series

    _require_some(logs, len(LETTERS))
    if html is not None:
        require_place(html, force=force)
    runs, untold = [], list[str]()
    with Steps() as step:
        for log in logs:
            step(f"reading {log}")
            with open_log(log) as opened:
                run = prepare(opened)
                results = summarise_prepared(run)
                told = opened.remarks if as_json else dict.fromkeys((*opened.remarks, *results.missing))
                untold += [f"{log}: {line}" for line in told]
                runs.append(ComparedRun(log, results, settings_of(opened), error_series(run)))
        if html is not None:
            from agent.report.compare_page import write_comparison

            step("drawing")
            write_comparison(runs, html)
    for line in untold:
        note(line)
    if as_json:
        from agent.cli.documents import compare_document

        print_json(compare_document(runs))
        return
    first = runs[0].results
    for letter, other in zip(LETTERS[1:], runs[1:], strict=False):
        found = differences(first, other.results)
        console().print(comparison_table(first, other.results, found, (LETTERS[0], letter)))
    console().print(settings_table([run.settings for run in runs]))
    if html is not None:
        typer.echo(f"page     {html}")


def identify(
    log: Annotated[
        Path, typer.Argument(metavar="LOG", help="MCAP log of one arm with a light object.", show_default=False)
    ],
    arm: Annotated[str | None, typer.Option(help="Name of the arm.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the new arm file (default: beside the log).")] = None,
    cutoff_hz: Annotated[float, typer.Option(min=0.1, help="Low-pass of torque and motion.")] = 5.0,
    slow_rad_per_s: Annotated[float, typer.Option(min=0.01, help="Slower motion says nothing of friction.")] = 0.2,
    force: Force = False,
) -> None:
    """Identify friction, rotor inertia and gravity parameters of an arm, and write its new arm file."""
    from agent.identify.equations import Options
    from agent.identify.run import identify as identify_log
    from agent.identify.run import write
    from agent.identify.show import delay_line, estimates_table, friction_lines, residual_lines, scale_lines

    with Steps() as step:
        result = identify_log(log, arm, Options(cutoff_hz, slow_rad_per_s), tell=step)
        step("writing")
        files = write(result, out or log.parent, replace=force)
    console().print(estimates_table(result))
    typer.echo("\n".join([*friction_lines(result), *scale_lines(result), *residual_lines(result), delay_line(result)]))
    typer.echo(f"arm file {files.arm}\nfigure   {files.figure}\nall      {files.summary}")


def calibrate(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG...",
            help="MCAP log of arms that hold one object, slowly moved; or one of each host.",
            show_default=False,
        ),
    ],
    out: Annotated[Path | None, typer.Option(help="Folder of the new cell (default: beside the first log).")] = None,
    change: Overrides = [],
    as_json: AsJson = False,
) -> None:
    """Calibrate bases, grasps and joint zeros from logs' joint angles, and write a new cell file where it is better."""
    from agent.calibrate.result import summary
    from agent.calibrate.run import calibrate as calibrate_logs
    from agent.calibrate.run import write
    from agent.calibrate.show import estimates_table, lines

    with Steps() as step:
        result = calibrate_logs(logs, change, step, note)
    if not as_json:
        console().print(estimates_table(result))
        typer.echo("\n".join(lines(result)))
    files = write(result, logs, out or logs[0].parent)
    if as_json:
        print_json(
            {
                **summary(result), "log": str(logs[0]), "logs": [str(log) for log in logs],
                "written": None if files is None else str(files.cell),
            }
        )  # fmt: skip
        return
    if files is None:
        return
    arms = "\n".join(f"arm file {arm}" for arm in files.arms)
    typer.echo(f"cell     {files.cell}\n{arms}\nfigure   {files.figure}\nall      {files.summary}")


class FormatName(StrEnum):
    """Kinds of files that `coop export` writes."""

    CSV = "csv"
    PARQUET = "parquet"


def export(
    log: LogPath,
    out: Annotated[
        Path | None, typer.Option(help="Folder of the tables (default: the log's name and the format, beside it).")
    ] = None,
    form: Annotated[FormatName, typer.Option("--format", help="parquet needs pyarrow.")] = FormatName.CSV,
    arm: Annotated[list[str], typer.Option("--arm", help="Only this arm; also: plant.")] = [],
    field: Annotated[
        list[str], typer.Option("--field", metavar="NAME", help="Only this field; all but `memory` otherwise.")
    ] = [],
    from_s: Annotated[
        float,
        typer.Option("--from", callback=instant, help="First second of the trajectory; negative before its start."),
    ] = -math.inf,
    to_s: Annotated[float, typer.Option("--to", callback=instant, help="Where to end, s.")] = math.inf,
    force: Force = False,
) -> None:
    """Write the rows as tables, one per arm, units in the column names; whole files or none."""
    from agent.log.export import Choice, Format
    from agent.log.export import export as export_log
    from agent.log.read import open_log

    folder = out or log.with_name(f"{log.stem}-{form.value}")
    with Steps() as step:
        step("reading the log")
        with open_log(log, any_layout=True) as opened:
            step("writing")
            choice = Choice(tuple(arm), tuple(field), from_s, to_s)
            done = export_log(opened, folder, Format(form.value), choice, replace=force)
    for problem in opened.remarks:
        note(f"{log}: {problem}")
    for name, rows in done.rows.items():
        typer.echo(f"{folder / name}  {rows} rows")


def play(
    log: LogPath,
    speed: Annotated[float, typer.Option(min=0.001, help="Pace; 1 is the pace of the run.")] = 1.0,
    start: Annotated[
        float, typer.Option("--from", "--start", min=0.0, help="First second to play, from the first row on.")
    ] = 0.0,
    end: Annotated[float | None, typer.Option("--to", "--end", help="Last second to play.")] = None,
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end.")] = False,
    listen: Annotated[str, typer.Option(help="Endpoint to listen on.")] = DEFAULT_ENDPOINT,
    network_config: NetworkConfig = None,
) -> None:
    """Publish a log again, byte for byte, under the prefix replay/; on a terminal keys pause, step and seek."""
    from agent.cli.keys import HELP, Keyboard
    from agent.host.signals import StopFlag
    from agent.telemetry.link import play as played
    from agent.telemetry.link.session import Network

    requested = StopFlag(suspends=True)
    network = Network(config_file=network_config) if network_config else Network(listen=listen)
    with Keyboard() as keyboard:
        if keyboard.present:
            note(HELP)
        options = played.PlayOptions(log, network, speed, start, end, loop, keyboard.orders, keyboard.show)
        done = played.run(options, requested, lambda endpoint: ready(pairs(endpoint=endpoint)))
    for problem in done.problems:
        note(f"{log}: {problem}")
    note(f"{log}: {done.rows} rows and {done.events} events played, {done.loops} times to the end")


def recover(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="MCAP log that was not finished.", show_default=False)],
    force: Annotated[bool, typer.Option("--force", help="Also one that is finished, and damaged.")] = False,
) -> None:
    """Mend a log that a crash or a power cut left unfinished, keep a damaged original, and verify the result."""
    from agent.log.recover import recover as mend

    done = mend(log, force=force)
    for problem in done.problems:
        note(f"{log}: {problem}")
    typer.echo(f"{log}: {done.line}")
    if done.original is not None:
        typer.echo(f"{log}: the damaged original is kept as {done.original}")
    elif done.damaged:
        note(f"{log}: --force makes a new log of what can be read, and keeps the original beside it")
    if done.damaged or not done.rows:
        raise typer.Exit(1)


class Viewer(StrEnum):
    """A program that shows logs."""

    FOXGLOVE = "foxglove"  # and Lichtblick
    PLOTJUGGLER = "plotjuggler"


def layout(
    cell: CellPath,
    viewer: Annotated[Viewer, typer.Option(help="Foxglove's is Lichtblick's too.")] = Viewer.FOXGLOVE,
) -> None:
    """Print a viewer's layout for the logs of a cell, and for its live view."""
    from agent.config.files import load_files
    from agent.log import layouts
    from agent.process.scene import scene_of

    make = layouts.foxglove if viewer is Viewer.FOXGLOVE else layouts.plotjuggler
    typer.echo(make(scene_of(load_files(cell))), nl=False)
