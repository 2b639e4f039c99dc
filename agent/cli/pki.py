"""The command that makes a cell's certificates: pki."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from agent.cli.options import AsJson, CellPath, note, print_json
from agent.pki import PORT


def pki(
    cell: CellPath,
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="To be made, for keys and all.", show_default=False)],
    recorder: Annotated[
        str, typer.Option(help="Name or address under which arms dial the recorder.")
    ] = "recorder.cell",
    listen: Annotated[str, typer.Option(help="Address on which the recorder listens.")] = "0.0.0.0",
    port: Annotated[int, typer.Option(min=1, max=65535, help="Its port.")] = PORT,
    days: Annotated[int, typer.Option(min=1, max=398, help="How long certificates last.")] = 365,
    renew: Annotated[list[str], typer.Option(help="Only make this member's certificate and key anew.")] = [],
    in_place: Annotated[bool, typer.Option("--in-place", help="Configurations name FOLDER, not /etc/coop.")] = False,
    as_json: AsJson = False,
) -> None:
    """Make a cell's authority, certificates, keys and Zenoh files with access control, for several hosts."""
    from agent.config.files import load_files
    from agent.pki import make

    wish = make.Wish(load_files(cell), folder, recorder, listen, port, days, in_place)
    if renew and wish != make.Wish(wish.cell, folder, days=days):
        raise typer.BadParameter(
            "--renew goes with --days alone: the member's hosts and configuration stay as they are"
        )
    ends = make.renew(wish, renew) if renew else make.make(wish)
    if as_json:
        print_json(
            {"schema": 1, "folder": str(folder.absolute()), "ends": {n: at.isoformat() for n, at in ends.items()}}
        )
        return
    for name, at in ends.items():
        typer.echo(f"{name:<12} until {at:%Y-%m-%d}")
    if not renew:
        note(f"copy {folder}/NAME/. to /etc/coop on NAME's host, then take {folder}/authority/ca.key offline")
