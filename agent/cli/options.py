"""What several commands of `coop` share: options, readiness, stop requests."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from agent.host.signals import StopFlag

CellPath = Annotated[Path, typer.Argument(help="Cell file (TOML), or the name of one that ships.", show_default=False)]
LogPath = Annotated[Path, typer.Argument(help="MCAP log.", show_default=False)]
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


def begin(with_parent: bool) -> StopFlag:
    """Catch requests to stop before anything is opened."""
    from agent.host.signals import StopFlag, die_with_parent

    requested = StopFlag()
    if with_parent:
        die_with_parent()
    return requested


def ready(what: str) -> None:
    """Tell the parent that this process is ready, and what it needs to know."""
    sys.stdout.write(f"READY {what}\n")
    sys.stdout.flush()
