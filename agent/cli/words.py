"""An operator's words to the agents of this host: start, stop, release."""

from __future__ import annotations

from typing import Annotated

import typer

from agent.cli.options import CellPath, ControlSockets, SomeArms


def start(
    cell: CellPath,
    at: Annotated[str | None, typer.Option(help="UTC, HH:MM:SS.", metavar="TIME")] = None,
    in_s: Annotated[float | None, typer.Option("--in", min=0.05, max=86400.0, help="Seconds from now.")] = None,
    control: ControlSockets = [],  # noqa: B006
) -> None:
    """Give this host's agents the common instant at which they begin to follow the trajectory."""
    from agent.operator.words import start_arms

    typer.echo(start_arms(cell, at, in_s, control))


def stop(cell: CellPath, arm: SomeArms = [], control: ControlSockets = []) -> None:  # noqa: B006
    """Let this host's agents hold the object where it is."""
    from agent.operator.words import stop_arms

    typer.echo(stop_arms(cell, arm, control))


def release(cell: CellPath, arm: SomeArms = [], control: ControlSockets = []) -> None:  # noqa: B006
    """Confirm that the object is supported: the agents that hold it switch their torque off."""
    from agent.operator.words import release_arms

    typer.echo(release_arms(cell, arm, control))
