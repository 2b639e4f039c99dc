"""The commands that are the processes of one arm: agent, guard."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer

from agent.cli.options import ArmName, CellPath, DriverName, WithParent, asked_yes, begin, ready

Driver = Annotated[DriverName | None, typer.Option(help="Instead of the cell's driver.")]
Port = Annotated[str | None, typer.Option(help="Serial port, instead of the cell's.")]
Priority = Annotated[int | None, typer.Option(min=1, max=99, help="SCHED_FIFO priority, or refuse.")]


def agent(
    cell: CellPath,
    arm: ArmName,
    driver: Driver = None,
    ring: Annotated[Path | None, typer.Option(help="Ring file in shared memory.")] = None,
    control: Annotated[Path | None, typer.Option(help="Socket for start, stop and release.")] = None,
    plant_socket: Annotated[Path | None, typer.Option(help="Socket of the plant (simulated arms).")] = None,
    port: Port = None,
    hold: Annotated[bool | None, typer.Option(help="At a stop and at the end hold the object until released.")] = None,
    priority: Priority = None,
    allow_no_realtime: Annotated[
        bool, typer.Option("--allow-no-realtime", help="Let a real arm be started at a normal priority.")
    ] = False,
    emulated: Annotated[bool, typer.Option("--emulated", help="Servos are emulated: nothing is real.")] = False,
    real_time: Annotated[bool, typer.Option("--real-time", help="At the wall clock's pace, not in lockstep.")] = False,
    whole: Annotated[bool, typer.Option("--whole", help="Begin at rest and wait for `coop approach`.")] = False,
    guard: Annotated[Path | None, typer.Option(help="Socket of the arm's guard, or refuse.")] = None,
    wait: Annotated[float, typer.Option(min=0.0, help="Seconds that guard and plant may take to be there.")] = 0.0,
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
    from agent.config.floating import spec_of
    from agent.config.schema.cell import DriverKind
    from agent.host.paths import control_path, make_runtime_dir, plant_socket_path, ring_path
    from agent.process.agent import run_agent
    from agent.process.build import Connection, port_of
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
    if in_the_loop(loaded, arm):
        port_of(loaded.arm(arm), Connection(port=port))
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
        wait_s=wait,
    )
    floats = spec_of(loaded, loaded.arm(arm)) is not None
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
    driver: Driver = None,
    port: Port = None,
    post_mortem: Annotated[Path, typer.Option(help="Folder for the log of what went before.")] = Path("runs"),
    hold: Annotated[bool | None, typer.Option(help="At a stop go on holding until released.")] = None,
    priority: Priority = None,
    emulated: Annotated[bool, typer.Option("--emulated", help="The servos on that port are emulated.")] = False,
    with_parent: WithParent = False,
) -> None:
    """Guard one arm: lend its agent the port, and go on in HOLD when that dies or hangs."""
    from agent.host.notify import Notifier

    with closing(Notifier()) as notifier:
        notifier.loading("loads")  # for a second from here on; its agent loads meanwhile, and waits for the socket
    from agent.config.cell import load_cell
    from agent.config.schema.cell import DriverKind
    from agent.host.paths import control_path, guard_path, make_runtime_dir, ring_path
    from agent.process.build import Connection
    from agent.process.guard import run_guard
    from agent.process.rehearse import driver_of, holds
    from agent.process.schedule import AgentOptions
    from agent.process.successor import GuardOptions

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
