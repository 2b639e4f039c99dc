"""The commands that are processes beside those of the arms: plant, emulate, telemetry, record, ros2."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from agent.cli import complete
from agent.cli.options import (
    DEFAULT_ENDPOINT,
    ROS_ROUTER,
    AtOnce,
    CellPath,
    CommonStart,
    NetworkConfig,
    Overrides,
    Stops,
    UtcOffset,
    WithParent,
    note,
)
from agent.config.schema.driver import DriverKind
from agent.host.starting import ready
from agent.process.loss import AfterLoss


def plant(
    cell: CellPath,
    socket: Annotated[Path | None, typer.Option(help="Socket to listen on.")] = None,
    ring: Annotated[Path | None, typer.Option(help="Ring file in shared memory.")] = None,
    real_time: Annotated[bool, typer.Option("--real-time", help="At the wall clock's pace, not in lockstep.")] = False,
    lost_arm: Annotated[AfterLoss, typer.Option(help="When an agent dies: end the run, or let its arm go.")] = (
        AfterLoss.END
    ),
    pauses: Annotated[str | None, typer.Option(hidden=True, help="Instants to wait at for SIGUSR1.")] = None,
    stops: Stops = False,
    common_start: CommonStart = None,
    utc_offset_ns: UtcOffset = None,
    with_parent: WithParent = None,
) -> None:
    """Run the simulated cell that the agents' simulated drivers connect to."""
    from agent.process.commands import PlantCommand
    from agent.process.started import Listener
    from agent.process.started import plant as run

    run(
        PlantCommand(
            cell=cell, socket=socket, ring=ring, real_time=real_time, lost_arm=lost_arm, pauses=pauses,
            stops=stops, common_start=common_start, utc_offset_ns=utc_offset_ns, with_parent=with_parent,
        ),
        Listener(note),
    )  # fmt: skip


def emulate(
    cell: CellPath,
    ports: Annotated[Path, typer.Option(help="Folder for the ports, one link per arm.")] = Path("/tmp/coop-ports"),
    ring: Annotated[Path | None, typer.Option(help="Ring file for the truth.")] = None,
    faults: Annotated[Path | None, typer.Option(help="Faults as JSON lines; times from the start.")] = None,
    control: Annotated[Path | None, typer.Option(help="Datagram socket that takes faults.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the faults.")] = 0,
    no_timing: Annotated[bool, typer.Option("--no-timing", help="Answer at once, not at the bus's pace.")] = False,
    whole: Annotated[bool, typer.Option("--whole", help="Arms begin at rest, the object on a table.")] = False,
    stops: Stops = False,
    common_start: CommonStart = None,
    utc_offset_ns: UtcOffset = None,
    with_parent: WithParent = None,
) -> None:
    """Emulated Dynamixel servos of the cell's arms on pseudo terminals, for any Dynamixel client."""
    from agent.process.commands import EmulateCommand
    from agent.process.started import Listener
    from agent.process.started import emulate as run

    run(
        EmulateCommand(
            cell=cell, ports=ports, ring=ring, faults=faults, control=control, seed=seed, no_timing=no_timing,
            whole=whole, stops=stops, common_start=common_start, utc_offset_ns=utc_offset_ns, with_parent=with_parent,
        ),
        Listener(note),
    )  # fmt: skip


def telemetry(
    cell: CellPath,
    member: Annotated[
        str,
        typer.Option(
            "--member",
            "--arm",
            help="Arm of the cell, or `plant`.",
            show_default=False,
            autocompletion=complete.members,
        ),
    ],
    ring: Annotated[Path | None, typer.Option(help="Ring file in shared memory; also of a run that is over.")] = None,
    connect: Annotated[str, typer.Option(help="Endpoint of the recorder.")] = DEFAULT_ENDPOINT,
    network_config: NetworkConfig = None,
    lockstep: Annotated[bool, typer.Option("--lockstep", help="Simulated time waits for this process.")] = False,
    follow: Annotated[bool, typer.Option("--follow", help="Go on with the next run of the arm (service).")] = False,
    cell_name: Annotated[str | None, typer.Option(hidden=True, help="Of a cell whose files are known.")] = None,
    fingerprint: Annotated[str | None, typer.Option(hidden=True, help="Of the same.")] = None,
    at_once: AtOnce = False,
    with_parent: WithParent = None,
) -> None:
    """Publish one ring over Zenoh."""
    from agent.process.commands import TelemetryCommand
    from agent.process.listening import telemetry as run
    from agent.process.started import Listener

    code = run(
        TelemetryCommand(
            cell=cell, member=member, ring=ring, connect=connect, network_config=network_config, lockstep=lockstep,
            follow=follow, cell_name=cell_name, fingerprint=fingerprint, at_once=at_once,
            with_parent=with_parent,
        ),
        Listener(note),
    )  # fmt: skip
    if code:
        raise typer.Exit(code)


def record(
    cell: CellPath,
    out: Annotated[Path | None, typer.Option(help="Log file to write.")] = None,
    out_dir: Annotated[Path, typer.Option(help="Folder for logs when --out is not given.")] = Path("runs"),
    listen: Annotated[str, typer.Option(help="Endpoint to listen on; port 0 takes a free one.")] = DEFAULT_ENDPOINT,
    network_config: NetworkConfig = None,
    driver: Annotated[DriverKind | None, typer.Option(help="What moves the arms, for the log.")] = None,
    truth: Annotated[bool, typer.Option(help="Expect the truth of a simulated plant.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the run, for the log.")] = 0,
    split_mb: Annotated[int | None, typer.Option(min=1, help="Go on in another log when one has so many MB.")] = None,
    split_s: Annotated[float | None, typer.Option(min=1.0, help="The same after so many seconds.")] = None,
    keep_mb: Annotated[
        int | None, typer.Option(min=1, help="Remove the folder's OLDEST LOGS when all take more than this.")
    ] = None,
    run_info: Annotated[Path | None, typer.Option(hidden=True, help="run.json of this run, if it is made.")] = None,
    at_once: AtOnce = False,
    with_parent: WithParent = None,
) -> None:
    """Write everything the cell publishes into one MCAP log."""
    from agent.process.commands import RecordCommand
    from agent.process.listening import record as run
    from agent.process.started import Listener

    code = run(
        RecordCommand(
            cell=cell, out=out, out_dir=out_dir, listen=listen, network_config=network_config, driver=driver,
            truth=truth, seed=seed, split_mb=split_mb, split_s=split_s, keep_mb=keep_mb, run_info=run_info,
            at_once=at_once, with_parent=with_parent,
        ),
        Listener(note),
    )  # fmt: skip
    if code:
        raise typer.Exit(code)


def ros2(
    cell: CellPath,
    overrides: Overrides = [],
    connect: Annotated[str, typer.Option(help="Endpoint of the ROS 2 router (rmw_zenohd).")] = ROS_ROUTER,
    telemetry: Annotated[str, typer.Option(help="Endpoint of the recorder.")] = DEFAULT_ENDPOINT,
    network_config: NetworkConfig = None,
    domain: Annotated[int, typer.Option(envvar="ROS_DOMAIN_ID", min=0, max=232, help="ROS domain.")] = 0,
    driver: Annotated[DriverKind | None, typer.Option(help="What moves the arms.")] = None,
    truth: Annotated[bool, typer.Option(help="Expect the truth of a simulated plant.")] = False,
    clock: Annotated[
        bool | None, typer.Option("--clock/--no-clock", help="Publish /clock; as a rule when the cell is simulated.")
    ] = None,
    with_parent: WithParent = None,
) -> None:
    """Show the cell to ROS 2 viewers, live: standard topics as rmw_zenoh has them, read only."""
    from agent.config.files import load_files
    from agent.host.signals import begin
    from agent.process.ros import run_ros
    from agent.telemetry.link.session import Network, Role

    requested = begin(with_parent)
    files = load_files(cell, overrides)
    simulated = (driver.value if driver is not None else files.file.driver.value) == DriverKind.SIM.value
    report = run_ros(
        files,
        Network(config_file=network_config) if network_config else Network(connect=(telemetry,), role=Role.VIEWER),
        Network(connect=(connect,), role=Role.VIEWER, timestamps=True),
        domain=domain,
        has_plant=truth or simulated,
        clock=simulated if clock is None else clock,
        stop=requested,
        ready=ready,
        tell=note,
    )
    typer.echo(
        f"{report.published} ROS messages, {report.dropped} of telemetry dropped, {report.refused} refused", err=True
    )
