"""An operator's words to the agents of this host: start, stop, release."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from agent.cli.options import CellPath, ControlSockets, SomeArms, note

HostName = Annotated[str | None, typer.Option("--host", help="This host's name in the cell file, if not its own.")]


def start(
    cell: CellPath,
    at: Annotated[str | None, typer.Option(help="UTC, HH:MM:SS.", metavar="TIME")] = None,
    in_s: Annotated[float | None, typer.Option("--in", min=0.05, max=86400.0, help="Seconds from now.")] = None,
    control: ControlSockets = [],  # noqa: B006
    host: HostName = None,
    clock: Annotated[Path | None, typer.Option(help="File that tells the clock's error, instead of chrony.")] = None,
) -> None:
    """Give this host's agents the common instant at which they begin to follow the trajectory; all of them or none."""
    from agent.config.cell import load_cell
    from agent.host.clock import read_clock
    from agent.operator.words import Here, start_arms

    typer.echo(start_arms(load_cell(cell), at, in_s, control, Here(read_clock(clock), host), note))


def stop(
    cell: CellPath,
    arm: SomeArms = [],  # noqa: B006
    control: ControlSockets = [],  # noqa: B006
    host: HostName = None,
) -> None:
    """Let this host's agents hold the object where it is; says who did not answer."""
    from agent.config.cell import load_cell
    from agent.operator.words import stop_arms

    typer.echo(stop_arms(load_cell(cell), arm, control, host))


def release(
    cell: CellPath,
    arm: SomeArms = [],  # noqa: B006
    control: ControlSockets = [],  # noqa: B006
    host: HostName = None,
) -> None:
    """Confirm that the object is supported: the agents that hold it switch their torque off."""
    from agent.config.cell import load_cell
    from agent.operator.words import release_arms

    typer.echo(release_arms(load_cell(cell), arm, control, host))
