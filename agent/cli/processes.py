"""The commands that are processes of a cell: agent, plant, emulate, telemetry, record."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from agent.cli import complete
from agent.cli.options import (
    DEFAULT_ENDPOINT,
    ROS_ROUTER,
    ArmName,
    CellPath,
    DriverName,
    NetworkConfig,
    WithParent,
    asked_yes,
    begin,
    ready,
)


class AfterLoss(StrEnum):
    """What the simulated cell does when the agent of an arm is gone."""

    END = "end"
    LIMP = "limp"


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
    allow_no_realtime: Annotated[
        bool, typer.Option("--allow-no-realtime", help="Let a real arm be started at a normal priority.")
    ] = False,
    emulated: Annotated[bool, typer.Option("--emulated", help="Servos are emulated: nothing is real.")] = False,
    real_time: Annotated[bool, typer.Option("--real-time", help="At the wall clock's pace, not in lockstep.")] = False,
    whole: Annotated[bool, typer.Option("--whole", help="Begin at rest and wait for `coop approach`.")] = False,
    guard: Annotated[Path | None, typer.Option(help="Socket of the arm's guard, or refuse.")] = None,
    gripper_empty: Annotated[
        bool, typer.Option("--gripper-empty", help="Arm in the loop: a person has looked, it holds nothing.")
    ] = False,
    gripper_word: Annotated[
        Path | None, typer.Option(help="The same, said by a file that a person makes; it is taken away.")
    ] = None,
    with_parent: WithParent = False,
) -> None:
    """Run one arm: the process that reads, steps, limits and writes."""
    from agent.config.cell import load_cell
    from agent.config.schema.cell import DriverKind
    from agent.host.paths import control_path, make_runtime_dir, plant_socket_path, ring_path
    from agent.process.agent import run_agent
    from agent.process.build import Connection
    from agent.process.floats import run_float
    from agent.process.rehearse import (
        driver_of,
        holds,
        in_the_loop,
        require_empty_gripper,
        require_one_host,
        require_wall_clock,
        taken,
    )
    from agent.process.schedule import AgentOptions

    requested = begin(with_parent)
    loaded = load_cell(cell)
    kind = driver_of(loaded, arm, DriverKind(driver.value) if driver is not None else None)
    name = loaded.file.name
    if not emulated:
        require_one_host(loaded)
    if in_the_loop(loaded, arm) and not emulated:
        said = gripper_empty or taken(gripper_word)
        require_empty_gripper(arm, said or asked_yes(f"Is the gripper of arm {arm} EMPTY?"))
    require_wall_clock(loaded, real_time=real_time or kind is DriverKind.DYNAMIXEL)
    lockstep = kind is DriverKind.SIM and not real_time
    if guard is not None and lockstep:
        raise typer.BadParameter("needs --real-time: in lockstep, time waits for the agent", param_hint="--guard")
    if ring is None or (control is None and not lockstep):
        make_runtime_dir(name)
    options = AgentOptions(
        arm=arm,
        driver=kind,
        connection=Connection(plant_socket or plant_socket_path(name), port, emulated),
        ring=ring or ring_path(name, arm),
        control=None if lockstep else control or control_path(name, arm),
        lockstep=lockstep,
        hold=whole or holds(loaded, kind, emulated=emulated, asked=hold),
        whole=whole,
        priority=priority,
        guard=guard,
        no_realtime=allow_no_realtime,
    )
    floats = loaded.file.floating is not None and arm in loaded.file.floating.arms
    summary = (run_float if floats else run_agent)(loaded, options, requested, ready)
    typer.echo(
        f"arm {arm}: {summary.ticks} cycles, {summary.late_cycles} late, {summary.stale_cycles} without a state, "
        f"mode {summary.mode.name} {summary.reason}",
        err=True,
    )


def guard(
    cell: CellPath,
    arm: ArmName,
    socket: Annotated[Path | None, typer.Option(help="Socket for the agent (its --guard).")] = None,
    control: Annotated[Path | None, typer.Option(help="Socket for stop and release, once the agent is gone.")] = None,
    driver: Annotated[DriverName | None, typer.Option(help="Instead of the cell's driver.")] = None,
    port: Annotated[str | None, typer.Option(help="Serial port, instead of the cell's.")] = None,
    post_mortem: Annotated[Path, typer.Option(help="Folder for the log of what went before.")] = Path("runs"),
    hold: Annotated[bool | None, typer.Option(help="At a stop go on holding until released.")] = None,
    priority: Annotated[int | None, typer.Option(min=1, max=99, help="SCHED_FIFO priority, or refuse.")] = None,
    emulated: Annotated[bool, typer.Option("--emulated", help="The servos on that port are emulated.")] = False,
    with_parent: WithParent = False,
) -> None:
    """Guard one arm: lend its agent the port, and go on in HOLD when that dies or hangs."""
    from agent.config.cell import load_cell
    from agent.config.schema.cell import DriverKind
    from agent.host.paths import control_path, guard_path, make_runtime_dir, ring_path
    from agent.process.build import Connection
    from agent.process.guard import GuardOptions, run_guard
    from agent.process.rehearse import driver_of, holds
    from agent.process.schedule import AgentOptions

    requested = begin(with_parent)
    loaded = load_cell(cell)
    kind = driver_of(loaded, arm, DriverKind(driver.value) if driver is not None else None)
    name = loaded.file.name
    if socket is None or control is None:
        make_runtime_dir(name)
    options = AgentOptions(
        arm=arm,
        driver=kind,
        connection=Connection(port=port, emulated=emulated),
        ring=ring_path(name, arm),
        control=control or control_path(name, arm),
        lockstep=False,
        hold=holds(loaded, kind, emulated=emulated, asked=hold),
        priority=priority,
    )
    summary = run_guard(
        loaded, GuardOptions(options, cell, socket or guard_path(name, arm), post_mortem), requested, ready
    )
    if summary is not None:
        typer.echo(f"arm {arm}: held for {summary.ticks} cycles, mode {summary.mode.name} {summary.reason}", err=True)


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
    from agent.process.emulate import gripping, run_emulate, run_emulate_alone
    from agent.process.whole import at_rest
    from agent.telemetry.row.topics import PLANT
    from sim_backend.wire.serve import ServeOptions

    requested = begin(with_parent)
    loaded = load_cell(cell)
    make_folder(ports)
    name = loaded.file.name
    alone = loaded.file.hil is not None or (loaded.file.floating is not None and not loaded.file.floating.holding)
    if ring is None and not alone:
        make_runtime_dir(name)
    options = ServeOptions({arm.name: ports / arm.name for arm in loaded.arms}, faults, control, seed)
    if alone:
        typer.echo(run_emulate_alone(loaded, options, timing=not no_timing, stop=requested, ready=ready), err=True)
        return
    where = ring or ring_path(name, PLANT)
    begins = at_rest if whole else gripping
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
