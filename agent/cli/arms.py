"""The commands that are the processes of one arm: agent, guard."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from agent.cli.options import ArmName, CellPath, UtcOffset, WithParent, asked_yes, note
from agent.config.schema.driver import DriverKind

Driver = Annotated[DriverKind | None, typer.Option(help="Instead of the cell's driver.")]
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
    stop_in: Annotated[int | None, typer.Option(hidden=True, min=0, help="Cycle in which it is stopped.")] = None,
    utc_offset_ns: UtcOffset = None,
    with_parent: WithParent = None,
) -> None:
    """Run one arm: the process that reads, steps, limits and writes."""
    from agent.process.commands import AgentCommand
    from agent.process.started import Listener
    from agent.process.started import agent as run

    run(
        AgentCommand(
            cell=cell, arm=arm, driver=driver, ring=ring, control=control, plant_socket=plant_socket, port=port,
            hold=hold, priority=priority, allow_no_realtime=allow_no_realtime, emulated=emulated, real_time=real_time,
            whole=whole, guard=guard, wait=wait, gripper_empty=gripper_empty, gripper_word=gripper_word,
            stop_in=stop_in, utc_offset_ns=utc_offset_ns, with_parent=with_parent,
        ),
        Listener(note, asked_yes),
    )  # fmt: skip


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
    with_parent: WithParent = None,
) -> None:
    """Guard one arm: lend its agent the port, and go on in HOLD when that dies or hangs."""
    from agent.process.commands import GuardCommand
    from agent.process.started import Listener
    from agent.process.started import guard as run

    run(
        GuardCommand(
            cell=cell, arm=arm, socket=socket, control=control, driver=driver, port=port,
            post_mortem=post_mortem, hold=hold, priority=priority, emulated=emulated, with_parent=with_parent,
        ),
        Listener(note),
    )  # fmt: skip
