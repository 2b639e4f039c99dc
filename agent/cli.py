"""The command `coop`: parse, dispatch, print.  Nothing else, and the only file that prints."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from agent import cli_motors
from drivers.interface import Refusal

if TYPE_CHECKING:
    from agent.process.signals import StopFlag

app = typer.Typer(
    no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False, help="Cooperative manipulation."
)
app.add_typer(cli_motors.app, name="motors")

CellPath = Annotated[Path, typer.Argument(help="Cell file (TOML).", show_default=False)]
Overrides = Annotated[list[str], typer.Option("--set", metavar="KEY=VALUE", help="Change one value of the cell file.")]
ArmName = Annotated[str, typer.Option("--arm", help="Arm of the cell.", show_default=False)]
DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
NetworkConfig = Annotated[Path | None, typer.Option(help="Zenoh configuration (TLS, access control) instead.")]
ControlSockets = Annotated[list[Path], typer.Option("--control", help="Control sockets instead of the usual ones.")]
SomeArms = Annotated[list[str], typer.Option("--arm", help="Only these arms.")]
WithParent = Annotated[bool, typer.Option("--with-parent", hidden=True)]


class DriverName(StrEnum):
    """What moves the arm."""

    SIM = "sim"
    DYNAMIXEL = "dynamixel"


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
    strict: Annotated[bool, typer.Option("--strict", help="Exit 6 when a bound of the cell file is missed.")] = False,
    overrides: Overrides = [],  # noqa: B006
) -> None:
    """Run a simulated cell: plant, one agent per arm, recorder, report."""
    from rich.console import Console

    from agent.process.run import Pace, RunOptions, run_cell
    from agent.process.signals import StopFlag
    from agent.progress import RunProgress
    from agent.telemetry.report import terminal_table

    console = Console()
    requested = StopFlag()
    pace = Pace.WIRE if wire else Pace.REAL_TIME if real_time else Pace.LOCKSTEP
    options = RunOptions(cell, tuple(overrides), duration, out, seed, pace)
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
    from agent.config.check import Verdict, examine

    loaded = load_cell(cell, overrides)
    report = examine(loaded, wired=True)
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
    from agent.config.tune import Form, Margin, Tuner
    from agent.config.tune_table import toml_lines, tune_table

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
def agent(
    cell: CellPath,
    arm: ArmName,
    driver: Annotated[DriverName | None, typer.Option(help="Instead of the cell's driver.")] = None,
    ring: Annotated[Path | None, typer.Option(help="Ring file in shared memory.")] = None,
    control: Annotated[Path | None, typer.Option(help="Socket for start, stop and release.")] = None,
    plant_socket: Annotated[Path | None, typer.Option(help="Socket of the plant (simulated arms).")] = None,
    port: Annotated[str | None, typer.Option(help="Serial port, instead of the cell's.")] = None,
    hold: Annotated[bool | None, typer.Option(help="At a stop and at the end hold the object until released.")] = None,
    priority: Annotated[int | None, typer.Option(min=1, max=99, help="SCHED_FIFO priority, or refuse.")] = None,
    emulated: Annotated[bool, typer.Option("--emulated", help="The servos on that port are emulated.")] = False,
    real_time: Annotated[bool, typer.Option("--real-time", help="At the wall clock's pace, not in lockstep.")] = False,
    with_parent: WithParent = False,
) -> None:
    """Run one arm: the process that reads, steps, limits and writes."""
    from agent.config.cell import load_cell
    from agent.config.schema import DriverKind
    from agent.process.agent import AgentOptions, run_agent
    from agent.process.build import Connection
    from agent.process.paths import control_path, plant_socket_path, ring_path

    requested = _begin(with_parent)
    loaded = load_cell(cell)
    kind = DriverKind(driver.value) if driver is not None else loaded.file.driver
    name = loaded.file.name
    lockstep = kind is DriverKind.SIM and not real_time
    options = AgentOptions(
        arm=arm,
        driver=kind,
        connection=Connection(plant_socket or plant_socket_path(name), port, emulated),
        ring=ring or ring_path(name, arm),
        control=None if lockstep else control or control_path(name, arm),
        lockstep=lockstep,
        hold=hold if hold is not None else kind is DriverKind.DYNAMIXEL and not emulated,
        priority=priority,
    )
    summary = run_agent(loaded, options, requested, _ready)
    typer.echo(
        f"arm {arm}: {summary.ticks} cycles, {summary.late_cycles} late, {summary.stale_cycles} without a state, "
        f"mode {summary.mode.name} {summary.reason}",
        err=True,
    )


@app.command()
def start(
    cell: CellPath,
    at: Annotated[str | None, typer.Option(help="UTC, HH:MM:SS.", metavar="TIME")] = None,
    in_s: Annotated[float | None, typer.Option("--in", min=0.05, help="Seconds from now.")] = None,
    control: ControlSockets = [],  # noqa: B006
) -> None:
    """Give this host's agents the common instant at which they begin to follow the trajectory."""
    from agent.process.operate import start_arms

    typer.echo(start_arms(cell, at, in_s, control))


@app.command()
def stop(cell: CellPath, arm: SomeArms = [], control: ControlSockets = []) -> None:  # noqa: B006
    """Let this host's agents hold the object where it is."""
    from agent.process.operate import stop_arms

    typer.echo(stop_arms(cell, arm, control))


@app.command()
def release(cell: CellPath, arm: SomeArms = [], control: ControlSockets = []) -> None:  # noqa: B006
    """Confirm that the object is supported: the agents that hold it switch their torque off."""
    from agent.process.operate import release_arms

    typer.echo(release_arms(cell, arm, control))


@app.command()
def plant(
    cell: CellPath,
    socket: Annotated[Path | None, typer.Option(help="Socket to listen on.")] = None,
    ring: Annotated[Path | None, typer.Option(help="Ring file in shared memory.")] = None,
    real_time: Annotated[bool, typer.Option("--real-time", help="At the wall clock's pace, not in lockstep.")] = False,
    with_parent: WithParent = False,
) -> None:
    """Run the simulated cell that the agents' simulated drivers connect to."""
    from agent.config.cell import load_cell
    from agent.process.paths import plant_socket_path, ring_path
    from agent.process.plant import PlantOptions, run_plant

    requested = _begin(with_parent)
    loaded = load_cell(cell)
    name = loaded.file.name
    options = PlantOptions(socket or plant_socket_path(name), ring or ring_path(name, "plant"), lockstep=not real_time)
    typer.echo(run_plant(loaded, options, requested, _ready), err=True)


@app.command()
def emulate(
    cell: CellPath,
    ports: Annotated[Path, typer.Option(help="Folder for the ports, one link per arm.")] = Path("/tmp/coop-ports"),
    ring: Annotated[Path | None, typer.Option(help="Ring file for the truth.")] = None,
    faults: Annotated[Path | None, typer.Option(help="Faults as JSON lines; times from the start.")] = None,
    control: Annotated[Path | None, typer.Option(help="Datagram socket that takes faults.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the faults.")] = 0,
    no_timing: Annotated[bool, typer.Option("--no-timing", help="Answer at once, not at the bus's pace.")] = False,
    with_parent: WithParent = False,
) -> None:
    """Emulated Dynamixel servos of the cell's arms on pseudo terminals, for any Dynamixel client."""
    from agent.config.cell import load_cell
    from agent.process.emulate import EmulateOptions, run_emulate
    from agent.process.paths import ring_path

    requested = _begin(with_parent)
    loaded = load_cell(cell)
    ports.mkdir(parents=True, exist_ok=True)
    options = EmulateOptions(
        ports={arm.name: ports / arm.name for arm in loaded.arms},
        ring=ring or ring_path(loaded.file.name, "plant"),
        faults_file=faults,
        control_socket=control,
        seed=seed,
        timing=not no_timing,
    )
    typer.echo(run_emulate(loaded, options, requested, _ready), err=True)


@app.command()
def telemetry(
    cell: CellPath,
    member: Annotated[str, typer.Option("--member", "--arm", help="Arm of the cell, or `plant`.", show_default=False)],
    ring: Annotated[Path | None, typer.Option(help="Ring file in shared memory.")] = None,
    connect: Annotated[str, typer.Option(help="Endpoint of the recorder.")] = DEFAULT_ENDPOINT,
    network_config: NetworkConfig = None,
    lockstep: Annotated[bool, typer.Option("--lockstep", help="Simulated time waits for this process.")] = False,
    follow: Annotated[bool, typer.Option("--follow", help="Go on with the next run of the arm (service).")] = False,
    with_parent: WithParent = False,
) -> None:
    """Publish one ring over Zenoh; never touches a bus."""
    from agent.config.cell import load_cell
    from agent.process.paths import ring_path
    from agent.process.recorder import TelemetryOptions, run_telemetry

    requested = _begin(with_parent)
    loaded = load_cell(cell)
    where = ring or ring_path(loaded.file.name, member)
    options = TelemetryOptions(member, where, connect, network_config, lockstep, follow)
    report = run_telemetry(loaded, options, requested, _ready)
    typer.echo(
        f"{member}: {report.rows_written} rows, {report.rows_lost} lost in the ring, "
        f"{report.rows_unrecorded} not confirmed by the recorder",
        err=True,
    )


@app.command()
def record(
    cell: CellPath,
    out: Annotated[Path | None, typer.Option(help="Log file to write.")] = None,
    out_dir: Annotated[Path, typer.Option(help="Folder for logs when --out is not given.")] = Path("runs"),
    listen: Annotated[str, typer.Option(help="Endpoint to listen on; port 0 takes a free one.")] = DEFAULT_ENDPOINT,
    network_config: NetworkConfig = None,
    driver: Annotated[DriverName | None, typer.Option(help="What moves the arms, for the log.")] = None,
    truth: Annotated[bool, typer.Option(help="Expect the truth of a simulated plant.")] = False,
    seed: Annotated[int, typer.Option(help="Seed of the run, for the log.")] = 0,
    with_parent: WithParent = False,
) -> None:
    """Write everything the cell publishes into one MCAP log."""
    from agent.config.cell import load_cell
    from agent.config.schema import DriverKind
    from agent.process.paths import log_path
    from agent.process.recorder import RecorderOptions, run_recorder

    requested = _begin(with_parent)
    loaded = load_cell(cell)
    kind = DriverKind(driver.value) if driver is not None else loaded.file.driver
    log = out if out is not None else log_path(out_dir, loaded.file.name)
    has_plant = truth or kind is DriverKind.SIM
    options = RecorderOptions(log, kind, has_plant, seed, listen, network_config)
    report = run_recorder(loaded, options, requested, _ready)
    for path in report.repaired:
        typer.echo(f"repaired {path}", err=True)
    typer.echo(f"{report.path}: {'complete' if report.complete else 'INCOMPLETE'} {report.failure or ''}", err=True)
    if report.failure:
        raise typer.Exit(4)


@app.command()
def report(
    log: Annotated[Path, typer.Argument(help="MCAP log.", show_default=False)],
    out: Annotated[Path | None, typer.Option(help="Folder of the report (default: beside the log).")] = None,
) -> None:
    """Make the figures, the page and results.json from a log alone."""
    from rich.console import Console

    from agent.telemetry.read import read_log
    from agent.telemetry.report import terminal_table, write_report

    files = write_report(read_log(log), out or log.parent)
    Console().print(terminal_table(files.results))
    typer.echo(f"report   {files.html}")


@app.command()
def compare(
    first: Annotated[Path, typer.Argument(help="MCAP log.", show_default=False)],
    second: Annotated[Path, typer.Argument(help="MCAP log.", show_default=False)],
) -> None:
    """Say which figures of two logs differ, and which log has the better ones."""
    from rich.console import Console

    from agent.telemetry.compare import compare as differences
    from agent.telemetry.compare import comparison_table
    from agent.telemetry.metrics import summarise
    from agent.telemetry.read import read_log

    a, b = summarise(read_log(first)), summarise(read_log(second))
    Console().print(comparison_table(a, b, differences(a, b)))


@app.command()
def play(
    log: Annotated[Path, typer.Argument(help="MCAP log.", show_default=False)],
    speed: Annotated[float, typer.Option(min=0.001, help="Pace; 1 is the pace of the run.")] = 1.0,
    start: Annotated[float, typer.Option(min=0.0, help="First second to play.")] = 0.0,
    end: Annotated[float | None, typer.Option(help="Last second to play.")] = None,
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end.")] = False,
    listen: Annotated[str, typer.Option(help="Endpoint to listen on.")] = DEFAULT_ENDPOINT,
    network_config: NetworkConfig = None,
) -> None:
    """Publish a log again, byte for byte, under the prefix replay/."""
    from agent.telemetry.play import PlayOptions
    from agent.telemetry.play import run as play_log
    from agent.telemetry.zenoh_session import Network

    requested = _begin(False)
    network = Network(config_file=network_config) if network_config else Network(listen=listen)
    options = PlayOptions(log, network, speed, start, end, loop)
    done = play_log(options, requested, lambda endpoint: _ready(f"endpoint={endpoint}"))
    typer.echo(f"{log}: {done.rows} rows and {done.events} events played, {done.loops} times to the end", err=True)


@app.command()
def recover(
    log: Annotated[Path, typer.Argument(help="MCAP log that was not finished.", show_default=False)],
) -> None:
    """Mend a log that a crash or a power cut left unfinished, and verify the result."""
    from agent.telemetry.recover import recover as mend

    typer.echo(mend(log))


def _begin(with_parent: bool) -> StopFlag:
    from agent.process.signals import StopFlag, die_with_parent

    requested = StopFlag()
    if with_parent:
        die_with_parent()
    return requested


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
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
