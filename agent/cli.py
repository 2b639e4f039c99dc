"""The command `coop`: parse, dispatch, print.  Nothing else, and the only file that prints."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from drivers.interface import Refusal

app = typer.Typer(
    no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False, help="Cooperative manipulation."
)

CellPath = Annotated[Path, typer.Argument(help="Cell file (TOML).", show_default=False)]
Overrides = Annotated[list[str], typer.Option("--set", metavar="KEY=VALUE", help="Change one value of the cell file.")]
ArmName = Annotated[str, typer.Option("--arm", help="Arm of the cell.", show_default=False)]
WithParent = Annotated[bool, typer.Option("--with-parent", hidden=True)]


class DriverName(StrEnum):
    """What moves the arm."""

    SIM = "sim"
    DYNAMIXEL = "dynamixel"


@app.command()
def run(
    cell: CellPath,
    duration: Annotated[float | None, typer.Option(min=0.0, help="Seconds, instead of the cell's duration.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the results (default runs/<UTC>-<cell>).")] = None,
    seed: Annotated[int, typer.Option(help="Seed of everything random in the simulated cell.")] = 0,
    real_time: Annotated[
        bool, typer.Option("--real-time", help="At the wall clock's pace instead of lockstep.")
    ] = False,
    strict: Annotated[bool, typer.Option("--strict", help="Exit 6 when a bound of the cell file is missed.")] = False,
    overrides: Overrides = [],  # noqa: B006
) -> None:
    """Run a simulated cell: plant, one agent per arm, recorder, report."""
    from rich.console import Console

    from agent.process.run import RunOptions, run_cell
    from agent.process.signals import StopFlag
    from agent.progress import RunProgress
    from agent.telemetry.report import terminal_table

    console = Console()
    stop = StopFlag()
    options = RunOptions(cell, tuple(overrides), duration, out, seed, lockstep=not real_time)
    with RunProgress(console) as progress:
        outcome = run_cell(options, stop, progress)
    console.print(terminal_table(outcome.results))
    console.print(f"log      {outcome.log}\nreport   {outcome.report}")
    if outcome.interrupted:
        console.print("stopped by request; the log ends there and is complete up to it")
        raise typer.Exit(130)
    if strict and not outcome.within_bounds:
        raise typer.Exit(6)


@app.command()
def check(cell: CellPath, overrides: Overrides = []) -> None:  # noqa: B006
    """Examine a cell before anything moves; exit code 2 when it must not run."""
    from rich.console import Console
    from rich.table import Table

    from agent.config.cell import load_cell
    from agent.config.check import Verdict, examine

    loaded = load_cell(cell, overrides)
    report = examine(loaded)
    table = Table(title=f"{loaded.file.name}  {loaded.fingerprint[:12]}", title_justify="left")
    for column in ("what", "where", "found", "wanted", ""):
        table.add_column(column, overflow="fold")
    colour = {Verdict.OK: "green", Verdict.WARNING: "yellow", Verdict.REFUSED: "red"}
    for f in report.findings:
        table.add_row(f.what, f.where, f.found, f.limit, f"[{colour[f.verdict]}]{f.verdict}[/]")
    Console().print(table)
    for f in report.findings:
        if f.remedy:
            typer.echo(f"{f.verdict}: {f.what} ({f.where}): {f.remedy}")
    report.require()


@app.command()
def agent(
    cell: CellPath,
    arm: ArmName,
    driver: Annotated[DriverName | None, typer.Option(help="Instead of the cell's driver.")] = None,
    ring: Annotated[Path | None, typer.Option(help="Ring file in shared memory.")] = None,
    plant_socket: Annotated[Path | None, typer.Option(help="Socket of the plant (simulated arms).")] = None,
    real_time: Annotated[
        bool, typer.Option("--real-time", help="At the wall clock's pace instead of lockstep.")
    ] = False,
    with_parent: WithParent = False,
) -> None:
    """Run one arm: the process that reads, steps, limits and writes."""
    from agent.config.cell import load_cell
    from agent.config.schema import DriverKind
    from agent.process.agent import AgentOptions, run_agent
    from agent.process.paths import plant_socket_path, ring_path

    stop = _begin(with_parent)
    loaded = load_cell(cell)
    kind = DriverKind(driver.value) if driver is not None else loaded.file.driver
    options = AgentOptions(
        arm=arm,
        driver=kind,
        ring=ring or ring_path(loaded.file.name, arm),
        plant_socket=plant_socket or plant_socket_path(loaded.file.name),
        lockstep=kind is DriverKind.SIM and not real_time,
    )
    summary = run_agent(loaded, options, stop, _ready)
    typer.echo(
        f"arm {arm}: {summary.ticks} cycles, {summary.late_cycles} late, mode {summary.mode.name} {summary.reason}",
        err=True,
    )


@app.command()
def plant(
    cell: CellPath,
    socket: Annotated[Path | None, typer.Option(help="Socket to listen on.")] = None,
    ring: Annotated[Path | None, typer.Option(help="Ring file in shared memory.")] = None,
    real_time: Annotated[
        bool, typer.Option("--real-time", help="At the wall clock's pace instead of lockstep.")
    ] = False,
    with_parent: WithParent = False,
) -> None:
    """Run the simulated cell that the agents' simulated drivers connect to."""
    from agent.config.cell import load_cell
    from agent.process.paths import plant_socket_path, ring_path
    from agent.process.plant import PlantOptions, run_plant

    stop = _begin(with_parent)
    loaded = load_cell(cell)
    name = loaded.file.name
    options = PlantOptions(socket or plant_socket_path(name), ring or ring_path(name, "plant"), lockstep=not real_time)
    typer.echo(run_plant(loaded, options, stop, _ready), err=True)


def _begin(with_parent: bool):  # type: ignore[no-untyped-def]
    from agent.process.signals import StopFlag, die_with_parent

    stop = StopFlag()
    if with_parent:
        die_with_parent()
    return stop


def _ready(what: str) -> None:
    sys.stdout.write(f"READY {what}\n")
    sys.stdout.flush()


def main() -> None:
    """Entry point: every Refusal is one line for a person and an exit code for a script."""
    try:
        app(standalone_mode=True)
    except Refusal as error:
        typer.echo(f"coop: {error}", err=True)
        sys.exit(error.exit_code)


if __name__ == "__main__":
    main()
