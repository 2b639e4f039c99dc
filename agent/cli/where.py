"""The command `coop where`: prints the folders of what ships beside the code."""

from __future__ import annotations

from typing import Annotated

import typer

from agent.host.shipped import Shipped, folder


def where(
    what: Annotated[Shipped | None, typer.Argument(help="Only this folder, without its name.")] = None,
) -> None:
    """Say where the shipped cells, arm files, systemd units and documents lie."""
    if what is not None:
        typer.echo(folder(what))
        return
    for each in Shipped:
        typer.echo(f"{each:<6} {folder(each)}")
