"""The command `coop where`: prints the folders of what ships beside the code."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer


class What(StrEnum):
    """A folder of `agent.host.shipped`."""

    CELLS = "cells"
    ARMS = "arms"
    UNITS = "units"
    DOCS = "docs"
    LAYOUTS = "layouts"


def where(
    what: Annotated[What | None, typer.Argument(metavar="FOLDER", help="Only this folder, without its name.")] = None,
) -> None:
    """Say where the shipped cells, arm files, systemd units, documents and viewers' layouts lie."""
    from agent.host.shipped import Shipped, folder

    if what is not None:
        typer.echo(folder(Shipped(what.value)))
        return
    for each in Shipped:
        typer.echo(f"{each:<7} {folder(each)}")
