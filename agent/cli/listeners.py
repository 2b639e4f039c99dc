"""What `coop faults inject` does and says where telemetry or the recorder fail."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from agent.cli.faults import SCHEMA, given, tell
from agent.cli.options import print_json

if TYPE_CHECKING:
    from agent.config.cell import Cell
    from agent.faults.heard import Heard
    from agent.faults.plan import Injection


PREFIX = "coop-faults-"  # of what a run leaves among the temporary files while it lasts


def inject(cell: Cell, faults: Sequence[Injection], seed: int, out: Path | None, *, as_json: bool) -> None:
    """Carry these out on the processes of a lockstep run.  Raises Refusal; typer.Exit with 1 where a torque differs."""
    from agent.cli.progress import RunProgress
    from agent.faults.heard import heard
    from agent.faults.judge import RowResult
    from agent.faults.listeners import logs_left, rehearse_listeners
    from agent.faults.log import require_new
    from agent.host.child import ChildFailed
    from agent.host.signals import StopFlag
    from agent.process.run_folder import keep, temporary_folder

    if out is not None:
        for number in range(logs_left(cell, faults)):
            require_new(_name(out, number))
    with temporary_folder(PREFIX) as folder, StopFlag().interrupting():
        try:
            with RunProgress() as progress:
                run = rehearse_listeners(cell, faults, seed, folder / "run.mcap", progress)
                progress.phase("comparing")
                found = heard(run)
        except ChildFailed:
            keep(folder)  # with the words of whom the error names
            raise
        left = [] if out is None else [_kept(log, _name(out, i)) for i, log in enumerate(run.logs)]
    if as_json:
        about = {"schema": SCHEMA, "cell": cell.file.name, "faults": given(run.faults)}
        print_json({**about, **found.document(), "logs": [str(log) for log in left]})
    else:
        _say(run.faults, found)
        for log in left:
            typer.echo(f"log               {log}")
    if found.verdict is RowResult.MISSED:
        raise typer.Exit(1)


def _name(out: Path, number: int) -> Path:
    """Of the log that is left: the one asked for; of further ones with a number behind it."""
    return out if not number else out.with_name(f"{out.stem}_{number + 1}{out.suffix}")


def _kept(log: Path, target: Path) -> Path:
    """A copy of the log under the name asked for.  Raises LogFileError."""
    from agent.atomic import copy_atomically
    from agent.faults.log import require_new
    from agent.log.file import LogFileError

    require_new(target)
    copy_atomically(log, target, LogFileError)
    return target


def _say(faults: Sequence[Injection], found: Heard) -> None:
    from agent.faults.plan import Target

    for fault in faults:
        tell(fault, "" if fault.target is Target.RECORDER else f", arm {fault.arm}")
    for arm, one in found.torque.items():
        where = "" if one.t is None else f", t = {one.t:.3f} s"
        of = f"of {one.rows} rows, against the undisturbed run"
        said = f"the same to the bit {of}" if one.same else f"DIFFERS from row {one.differs_at}{where} on {of}"
        typer.echo(f"torque {arm:<10} {said}")
    for name, kept in found.kept.items():
        strange = f", {kept.foreign} THAT ARE NOT ITS OWN" if kept.foreign else ""
        typer.echo(f"rows {name:<12} {kept.logged} of {kept.written} in the log, {kept.missing} missing{strange}")
    said = "complete" if found.complete else "incomplete"
    typer.echo(f"log says          {said}")
    for text in found.problems:
        typer.echo(f"                  {text}")
    if found.complete and any(kept.missing for kept in found.kept.values()):
        typer.echo("                  WHICH IS NOT TRUE: rows are missing")
    if found.sent:
        typer.echo(f"strange messages  {found.sent} sent")
    for why, count in found.left_out.items():
        typer.echo(f"left out          {count} messages: {why}")
