"""The command `coop run`: a simulated cell from start to report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from agent.cli.options import AsJson, CellPath, Force, Overrides, console, print_json


def run(
    cell: CellPath,
    duration: Annotated[float | None, typer.Option(min=0.0, help="Seconds, instead of the cell's duration.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the results (default runs/<UTC>-<cell>).")] = None,
    seed: Annotated[int, typer.Option(help="Seed of everything random in the simulated cell.")] = 0,
    real_time: Annotated[bool, typer.Option("--real-time", help="At the wall clock's pace, not in lockstep.")] = False,
    wire: Annotated[bool, typer.Option("--wire", help="The real driver on emulated servos, in real time.")] = False,
    hil: Annotated[
        str | None,
        typer.Option(
            metavar="ARMS", help="Rehearse: these arms (left,right) on emulated servos, each on its own, in the loop."
        ),
    ] = None,
    whole: Annotated[bool, typer.Option("--whole", help="With --wire: from rest to the object and back.")] = False,
    faults: Annotated[Path | None, typer.Option(help="Faults of the emulated servos, JSON lines.")] = None,
    strict: Annotated[bool, typer.Option("--strict", help="Exit 6 when a bound of the cell file is missed.")] = False,
    listen: Annotated[str | None, typer.Option(help="Endpoint for live viewers (default: a free port).")] = None,
    report: Annotated[bool, typer.Option("--report/--no-report", help="Draw the report, or results alone.")] = True,
    force: Force = False,
    overrides: Overrides = [],  # noqa: B006
    as_json: AsJson = False,
) -> None:
    """Run a simulated cell: plant, one agent per arm, recorder, report."""
    from agent.cli.progress import RunProgress
    from agent.host.signals import StopFlag
    from agent.process.children import RunKind
    from agent.process.run import RunOptions, run_cell
    from agent.report.bounds import require_bounds
    from agent.report.results_file import terminal_table
    from agent.telemetry.link.session import FREE_PORT

    requested = StopFlag()
    kind = RunKind.WIRE if wire else RunKind.REAL_TIME if real_time else RunKind.LOCKSTEP
    if hil is not None:
        names = ", ".join(f'"{name.strip()}"' for name in hil.split(","))
        kind, overrides = RunKind.HIL, [*overrides, 'driver="sim"', f"hil.arms=[{names}]"]
    where = listen or FREE_PORT
    options = RunOptions(cell, tuple(overrides), duration, out, seed, kind, faults, force, where, report, whole)
    with RunProgress() as progress:
        outcome = run_cell(options, requested, progress)
    if as_json:
        from agent.cli.documents import run_document

        print_json(run_document(outcome))
    else:
        console().print(terminal_table(outcome.results))
        typer.echo(f"log      {outcome.log}")
        if outcome.report is not None:
            typer.echo(f"report   {outcome.report}")
    if outcome.interrupted:
        typer.echo("stopped by request; the log ends there and is complete up to it", err=as_json)
        raise typer.Exit(130)
    if strict:
        require_bounds(outcome.results)
