"""The commands that are processes beside those of the arms: plant, emulate, telemetry, record, ros2."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from agent.cli import complete
from agent.cli.options import (
    DEFAULT_ENDPOINT,
    ROS_ROUTER,
    CellPath,
    DriverName,
    NetworkConfig,
    WithParent,
    begin,
    ready,
)


class AfterLoss(StrEnum):
    """What the simulated cell does when the agent of an arm is gone."""

    END = "end"
    LIMP = "limp"


def plant(
    cell: CellPath,
    socket: Annotated[Path | None, typer.Option(help="Socket to listen on.")] = None,
    ring: Annotated[Path | None, typer.Option(help="Ring file in shared memory.")] = None,
    real_time: Annotated[bool, typer.Option("--real-time", help="At the wall clock's pace, not in lockstep.")] = False,
    lost_arm: Annotated[AfterLoss, typer.Option(help="When an agent dies: end the run, or let its arm go.")] = (
        AfterLoss.END
    ),
    with_parent: WithParent = False,
) -> None:
    """Run the simulated cell that the agents' simulated drivers connect to."""
    from agent.config.cell import load_cell
    from agent.host.paths import make_runtime_dir, plant_socket_path, ring_path
    from agent.process.plant import run_plant
    from agent.telemetry.row.topics import PLANT
    from sim_backend.served.options import LostArm

    requested = begin(with_parent)
    loaded = load_cell(cell)
    name = loaded.file.name
    if ring is None or socket is None:
        make_runtime_dir(name)
    where = socket or plant_socket_path(name), ring or ring_path(name, PLANT)
    loss = LostArm.GO_LIMP if lost_arm is AfterLoss.LIMP else LostArm.END_RUN
    line = run_plant(loaded, *where, lockstep=not real_time, lost_arm=loss, stop=requested, ready=ready)
    typer.echo(line, err=True)


def emulate(
    cell: CellPath,
    ports: Annotated[Path, typer.Option(help="Folder for the ports, one link per arm.")] = Path("/tmp/coop-ports"),
    ring: Annotated[Path | None, typer.Option(help="Ring file for the truth.")] = None,
    faults: Annotated[Path | None, typer.Option(help="Faults as JSON lines; times from the start.")] = None,
    control: Annotated[Path | None, typer.Option(help="Datagram socket that takes faults.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the faults.")] = 0,
    no_timing: Annotated[bool, typer.Option("--no-timing", help="Answer at once, not at the bus's pace.")] = False,
    whole: Annotated[bool, typer.Option("--whole", help="Arms begin at rest, the object on a table.")] = False,
    with_parent: WithParent = False,
) -> None:
    """Emulated Dynamixel servos of the cell's arms on pseudo terminals, for any Dynamixel client."""
    from agent.atomic import make_folder
    from agent.config.cell import load_cell
    from agent.host.paths import make_runtime_dir, ring_path
    from agent.process.emulate import about_the_object, gripping, run_emulate, run_emulate_alone
    from agent.process.whole import at_rest
    from agent.telemetry.row.topics import PLANT
    from sim_backend.wire.serve import ServeOptions

    requested = begin(with_parent)
    loaded = load_cell(cell)
    make_folder(ports)
    name = loaded.file.name
    floating = loaded.file.floating
    alone = loaded.file.hil is not None or (floating is not None and not floating.holding)
    if ring is None and not alone:
        make_runtime_dir(name)
    options = ServeOptions({arm.name: ports / arm.name for arm in loaded.arms}, faults, control, seed)
    if alone:
        typer.echo(run_emulate_alone(loaded, options, timing=not no_timing, stop=requested, ready=ready), err=True)
        return
    where = ring or ring_path(name, PLANT)
    begins = at_rest if whole else gripping if floating is None else about_the_object
    run = run_emulate(loaded, options, where, timing=not no_timing, stop=requested, ready=ready, begin=begins)
    typer.echo(run, err=True)


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
    ring: Annotated[Path | None, typer.Option(help="Ring file in shared memory.")] = None,
    connect: Annotated[str, typer.Option(help="Endpoint of the recorder.")] = DEFAULT_ENDPOINT,
    network_config: NetworkConfig = None,
    lockstep: Annotated[bool, typer.Option("--lockstep", help="Simulated time waits for this process.")] = False,
    follow: Annotated[bool, typer.Option("--follow", help="Go on with the next run of the arm (service).")] = False,
    with_parent: WithParent = False,
) -> None:
    """Publish one ring over Zenoh."""
    from agent.config.files import load_files
    from agent.host.paths import ring_path
    from agent.process.telemetry import run_telemetry
    from agent.telemetry.link.session import Network

    requested = begin(with_parent)
    files = load_files(cell)
    report = run_telemetry(
        files,
        member,
        ring or ring_path(files.file.name, member),
        Network(config_file=network_config) if network_config else Network(connect=(connect,)),
        lockstep=lockstep,
        follow=follow,
        stop=requested,
        ready=ready,
        say=lambda text: typer.echo(f"{member}: {text}", err=True),
    )
    typer.echo(
        f"{member}: {report.rows_written} rows, {report.rows_lost} lost in the ring, "
        f"{report.rows_unrecorded} not confirmed by the recorder",
        err=True,
    )


def record(
    cell: CellPath,
    out: Annotated[Path | None, typer.Option(help="Log file to write.")] = None,
    out_dir: Annotated[Path, typer.Option(help="Folder for logs when --out is not given.")] = Path("runs"),
    listen: Annotated[str, typer.Option(help="Endpoint to listen on; port 0 takes a free one.")] = DEFAULT_ENDPOINT,
    network_config: NetworkConfig = None,
    driver: Annotated[DriverName | None, typer.Option(help="What moves the arms, for the log.")] = None,
    truth: Annotated[bool, typer.Option(help="Expect the truth of a simulated plant.")] = False,
    seed: Annotated[int, typer.Option(help="Seed of the run, for the log.")] = 0,
    split_mb: Annotated[int | None, typer.Option(min=1, help="Go on in another log when one has so many MB.")] = None,
    split_s: Annotated[float | None, typer.Option(min=1.0, help="The same after so many seconds.")] = None,
    keep_mb: Annotated[
        int | None, typer.Option(min=1, help="Remove the folder's OLDEST LOGS when all take more than this.")
    ] = None,
    run_info: Annotated[Path | None, typer.Option(hidden=True, help="run.json of this run, if it is made.")] = None,
    with_parent: WithParent = False,
) -> None:
    """Write everything the cell publishes into one MCAP log."""
    from agent.config.files import load_files
    from agent.config.schema.cell import DriverKind
    from agent.host.paths import log_path
    from agent.log.parts import Limits
    from agent.process.recorder import described, run_recorder
    from agent.telemetry.link.session import Network

    requested = begin(with_parent)
    files = load_files(cell)
    kind = DriverKind(driver.value) if driver is not None else files.file.driver
    report = run_recorder(
        files,
        out if out is not None else log_path(out_dir, files.file.name),
        Network(config_file=network_config) if network_config else Network(listen=listen),
        run_info.read_bytes() if run_info is not None else described(cell, kind, seed),
        has_plant=truth or kind is DriverKind.SIM,
        limits=Limits(split_mb and split_mb << 20, split_s, keep_mb and keep_mb << 20),
        alone=run_info is None,
        stop=requested,
        ready=ready,
    )
    for path in report.repaired:
        typer.echo(f"repaired {path}", err=True)
    for path in report.logs[1:]:
        typer.echo(f"went on in {path}", err=True)
    for key, count in report.completeness.items():
        if key.startswith("rejected."):
            typer.echo(f"left out {count} messages: {key.removeprefix('rejected.').replace('_', ' ')}", err=True)
    typer.echo(f"{report.path}: {'complete' if report.complete else 'INCOMPLETE'} {report.failure or ''}", err=True)
    if report.failure:
        raise typer.Exit(4)


def ros2(
    cell: CellPath,
    connect: Annotated[str, typer.Option(help="Endpoint of the ROS 2 router (rmw_zenohd).")] = ROS_ROUTER,
    telemetry: Annotated[str, typer.Option(help="Endpoint of the recorder.")] = DEFAULT_ENDPOINT,
    network_config: NetworkConfig = None,
    domain: Annotated[int, typer.Option(envvar="ROS_DOMAIN_ID", min=0, max=232, help="ROS domain.")] = 0,
    driver: Annotated[DriverName | None, typer.Option(help="What moves the arms.")] = None,
    truth: Annotated[bool, typer.Option(help="Expect the truth of a simulated plant.")] = False,
    clock: Annotated[
        bool | None, typer.Option("--clock/--no-clock", help="Publish /clock; as a rule when the cell is simulated.")
    ] = None,
    with_parent: WithParent = False,
) -> None:
    """Show the cell to ROS 2 viewers, live: standard topics as rmw_zenoh has them, read only."""
    from agent.config.files import load_files
    from agent.config.schema.cell import DriverKind
    from agent.process.ros import run_ros
    from agent.telemetry.link.session import Network, Role

    requested = begin(with_parent)
    files = load_files(cell)
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
    )
    typer.echo(
        f"{report.published} ROS messages, {report.dropped} of telemetry dropped, {report.refused} refused", err=True
    )
