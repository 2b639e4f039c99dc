"""The command `coop`: every refusal is one line for a person and an exit code for a script."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from agent.cli import logs as cli_logs
from agent.cli import motors as cli_motors
from agent.cli import processes as cli_processes
from agent.cli.options import CellPath, ControlSockets, Overrides, SomeArms
from agent.cli.where import where
from drivers.interface import Refusal

app = typer.Typer(
    no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False, help="Cooperative manipulation."
)


class FormName(StrEnum):
    """Which gains `coop tune` may change."""

    RATIO = "ratio"
    RATE = "rate"


@app.command()
def run(
    cell: CellPath,
    duration: Annotated[float | None, typer.Option(min=0.0, help="Seconds, instead of the cell's duration.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the results (default runs/<UTC>-<cell>).")] = None,
    seed: Annotated[int, typer.Option(help="Seed of everything random in the simulated cell.")] = 0,
    real_time: Annotated[bool, typer.Option("--real-time", help="At the wall clock's pace, not in lockstep.")] = False,
    wire: Annotated[bool, typer.Option("--wire", help="The real driver on emulated servos, in real time.")] = False,
    faults: Annotated[Path | None, typer.Option(help="Faults of the emulated servos, JSON lines.")] = None,
    strict: Annotated[bool, typer.Option("--strict", help="Exit 6 when a bound of the cell file is missed.")] = False,
    overrides: Overrides = [],  # noqa: B006
) -> None:
    """Run a simulated cell: plant, one agent per arm, recorder, report."""
    from rich.console import Console

    from agent.cli.progress import RunProgress
    from agent.host.signals import StopFlag
    from agent.process.children import RunKind
    from agent.process.run import RunOptions, run_cell
    from agent.report.report import terminal_table

    console = Console()
    requested = StopFlag()
    kind = RunKind.WIRE if wire else RunKind.REAL_TIME if real_time else RunKind.LOCKSTEP
    options = RunOptions(cell, tuple(overrides), duration, out, seed, kind, faults)
    with RunProgress(console) as progress:
        outcome = run_cell(options, requested, progress)
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
    from agent.verify.check import Verdict, examine

    loaded = load_cell(cell, overrides)
    report = examine(loaded, wired=True)
    table = Table(title=f"{loaded.file.name}  {loaded.fingerprint[:12]}", title_justify="left")
    for column in ("what", "where", "found", "wanted", ""):
        table.add_column(column, overflow="fold")
    colour = {Verdict.OK: "green", Verdict.WARNING: "yellow", Verdict.REFUSED: "red"}
    for f in report.findings:
        table.add_row(f.what, f.where, f.found, f.wanted, f"[{colour[f.verdict]}]{f.verdict}[/]")
    Console().print(table)
    for f in report.findings:
        if f.remedy:
            typer.echo(f"{f.verdict}: {f.what} ({f.where}): {f.remedy}")
    report.require()


@app.command()
def tune(
    cell: CellPath,
    form: Annotated[FormName, typer.Option(help="Scale k and its _rate_ form together, or only the latter.")] = (
        FormName.RATIO
    ),
    damping: Annotated[float, typer.Option(min=0.0, max=1.0, help="Least damping ratio of what swings.")] = 0.05,
    radius: Annotated[float, typer.Option(min=0.0, max=1.0, help="Largest spectral radius.")] = 0.999,
    write: Annotated[Path | None, typer.Option(help="Write the cell file with these gains.")] = None,
    overrides: Overrides = [],  # noqa: B006
) -> None:
    """Propose gains that keep a margin at the cell's rate and delay, also with the arms' inertia off."""
    from rich.console import Console

    from agent.atomic import write_atomically
    from agent.config.cell import load_cell
    from agent.verify.tune import Form, Margin, Tuner
    from agent.verify.tune_table import toml_lines, tune_table

    tuner, margin = Tuner(load_cell(cell, overrides)), Margin(radius, damping)
    proposals = tuner.proposals(margin)
    Console().print(tune_table(tuner.configured(), proposals))
    chosen = next((p for p in proposals if p.form.value == form.value), None) or tuner.propose(Form(form.value), margin)
    typer.echo(toml_lines(chosen) or "the configured gains are the largest that keep the margin")
    if write is not None:
        write_atomically(write, chosen.toml().encode())
        typer.echo(f"written  {write}", err=True)


@app.command()
def identify(
    log: Annotated[Path, typer.Argument(help="MCAP log of one arm with a light object.", show_default=False)],
    arm: Annotated[str | None, typer.Option(help="Name of the arm.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the new arm file (default: beside the log).")] = None,
    arms: Annotated[Path | None, typer.Option(help="Folder of the arm files the run used.")] = None,
    cutoff_hz: Annotated[float, typer.Option(min=0.1, help="Low-pass of torque and motion.")] = 5.0,
    slow_rad_per_s: Annotated[float, typer.Option(min=0.01, help="Slower motion says nothing of friction.")] = 0.2,
) -> None:
    """Identify friction, rotor inertia and gravity parameters of an arm, and write its new arm file."""
    from rich.console import Console

    import configs
    from agent.identify.fit import Options
    from agent.identify.run import identify as identify_log
    from agent.identify.run import write
    from agent.identify.show import estimates_table, residual_lines

    arms_dir = arms or configs.ARMS_DIR
    result = identify_log(log, arm, Options(cutoff_hz, slow_rad_per_s), arms_dir)
    files = write(result, out or log.parent, arms_dir)
    Console().print(estimates_table(result))
    typer.echo("\n".join(residual_lines(result)))
    typer.echo(f"arm file {files.arm}\nfigure   {files.figure}\nall      {files.summary}")


@app.command()
def start(
    cell: CellPath,
    at: Annotated[str | None, typer.Option(help="UTC, HH:MM:SS.", metavar="TIME")] = None,
    in_s: Annotated[float | None, typer.Option("--in", min=0.05, help="Seconds from now.")] = None,
    control: ControlSockets = [],  # noqa: B006
) -> None:
    """Give this host's agents the common instant at which they begin to follow the trajectory."""
    from agent.operator.words import start_arms

    typer.echo(start_arms(cell, at, in_s, control))


@app.command()
def stop(cell: CellPath, arm: SomeArms = [], control: ControlSockets = []) -> None:  # noqa: B006
    """Let this host's agents hold the object where it is."""
    from agent.operator.words import stop_arms

    typer.echo(stop_arms(cell, arm, control))


@app.command()
def release(cell: CellPath, arm: SomeArms = [], control: ControlSockets = []) -> None:  # noqa: B006
    """Confirm that the object is supported: the agents that hold it switch their torque off."""
    from agent.operator.words import release_arms

    typer.echo(release_arms(cell, arm, control))


for _command in (
    cli_processes.agent,
    cli_processes.plant,
    cli_processes.emulate,
    cli_processes.telemetry,
    cli_processes.record,
    cli_logs.report,
    cli_logs.compare,
    cli_logs.play,
    cli_logs.recover,
    cli_motors.doctor,
    where,
):
    app.command()(_command)
app.add_typer(cli_motors.app, name="motors")


def main() -> None:
    """Entry point: every Refusal is one line for a person and an exit code for a script."""
    try:
        app(standalone_mode=True)
    except Refusal as error:
        typer.echo(f"coop: {error}", err=True)
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
