"""An operator's words to the agents of this host, each a command: from start and stop to park; and how they are."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from agent.cli.options import AsJson, CellPath, ControlSockets, SomeArms, note
from agent.host.starting import is_unread

if TYPE_CHECKING:
    from agent.config.cell import Cell

HostName = Annotated[str | None, typer.Option("--host", help="This host's name in the cell file, if not its own.")]

ClockFile = Annotated[Path | None, typer.Option("--clock", help="File that tells the clock's error, not chrony.")]
CLEAR = "\x1b[H\x1b[2J"
WATCH_STEP_S, WATCH_EVERY_STEPS = 0.1, 10


def start(
    cell: CellPath,
    at: Annotated[str | None, typer.Option(help="UTC, HH:MM:SS.", metavar="TIME")] = None,
    in_s: Annotated[float | None, typer.Option("--in", min=0.05, max=86400.0, help="Seconds from now.")] = None,
    control: ControlSockets = [],
    host: HostName = None,
    clock: ClockFile = None,
) -> None:
    """Give this host's agents the common instant at which they begin to follow the trajectory; all of them or none."""
    from agent.host.clock import read_clock
    from agent.operator.words import Here, start_arms

    typer.echo(start_arms(_loaded(cell, control), at, in_s, control, Here(read_clock(clock), host), note))


def stop(
    cell: CellPath,
    arm: SomeArms = [],
    control: ControlSockets = [],
    host: HostName = None,
) -> None:
    """Let this host's agents hold the object where it is (simulated ones let go and end); says who did not answer."""
    _pass_on("stop", cell, arm, control, host)


def release(
    cell: CellPath,
    arm: SomeArms = [],
    control: ControlSockets = [],
    host: HostName = None,
) -> None:
    """Confirm that the object is supported: the agents that hold it switch their torque off."""
    _pass_on("release", cell, arm, control, host)


def approach(
    cell: CellPath,
    arm: SomeArms = [],
    control: ControlSockets = [],
    host: HostName = None,
) -> None:
    """Send this host's arms from their rest to their grasps, grippers open."""
    _pass_on("approach", cell, arm, control, host)


def grasp(
    cell: CellPath,
    arm: SomeArms = [],
    control: ControlSockets = [],
    host: HostName = None,
) -> None:
    """Close this host's grippers on the object; each arm that holds it takes its load share up."""
    _pass_on("grasp", cell, arm, control, host)


def lower(
    cell: CellPath,
    at: Annotated[str | None, typer.Option(help="UTC, HH:MM:SS.", metavar="TIME")] = None,
    in_s: Annotated[float | None, typer.Option("--in", min=0.05, max=86400.0, help="Seconds from now.")] = None,
    arm: SomeArms = [],
    control: ControlSockets = [],
    host: HostName = None,
) -> None:
    """Set the object down where it stood, all arms from one instant on (without one: in a second)."""
    from agent.operator.words import lower_arms

    in_s = 1.0 if at is None and in_s is None else in_s
    typer.echo(lower_arms(_loaded(cell, control), at, in_s, arm, control, host))


def park(
    cell: CellPath,
    arm: SomeArms = [],
    control: ControlSockets = [],
    host: HostName = None,
) -> None:
    """Send this host's arms back to their rest."""
    _pass_on("park", cell, arm, control, host)


def guide(
    cell: CellPath,
    once: Annotated[bool, typer.Option("--once", help="Say how things are now, and end.")] = False,
    control: ControlSockets = [],
    host: HostName = None,
) -> None:
    """Walk through a session: what is seen at this host's arms, and what to say next, whenever it changes.

    With --once: exit code 1 when one does not answer.
    """
    from agent.host.signals import StopFlag
    from agent.operator.guide import lines, missing
    from agent.operator.local import places
    from agent.operator.status import arms as look

    loaded = _loaded(cell, control)
    arms = places(loaded, [], control, host)
    requested, before = StopFlag(suspends=True), [""]
    while not requested():
        found = look(loaded, arms)
        now = lines(found, str(cell), "--control" if control else "--arm")
        if now != before:
            typer.echo("\n".join([*now, ""]))
            before = now
        if once:
            raise typer.Exit(1 if missing(found) else 0)
        if is_unread():
            return
        time.sleep(WATCH_STEP_S)


def _loaded(cell: Path, control: list[Path]) -> Cell:
    """The cell; whose the folder is in which its agents were looked for, where that is not this user's, is told."""
    from agent.config.cell import load_cell
    from agent.host.paths import foreign_folder

    loaded = load_cell(cell)
    found = "" if control else foreign_folder(loaded.file.name)
    if found:
        note(f"{found}: nobody in it is asked; have it removed, or set XDG_RUNTIME_DIR")
    return loaded


def _pass_on(word: str, cell: Path, arm: list[str], control: list[Path], host: str | None) -> None:
    from agent.operator.table import Verb
    from agent.operator.words import tell_arms

    typer.echo(tell_arms(_loaded(cell, control), Verb(word), arm, control, host))


def status(
    cell: CellPath,
    watch: Annotated[bool, typer.Option("--watch", help="Again every second, until Ctrl-C.")] = False,
    host: HostName = None,
    clock: ClockFile = None,
    logs: Annotated[list[Path], typer.Option(help="Folders of logs, where a recorder may be at work.")] = [],
    as_json: AsJson = False,
) -> None:
    """Show how the arms of this host are: exit code 1 when one does not answer."""
    from agent.host.clock import read_clock
    from agent.host.signals import StopFlag
    from agent.operator.show import lines
    from agent.operator.status import LOG_FOLDERS
    from agent.operator.status import status as look

    loaded = _loaded(cell, [])
    stop = StopFlag(suspends=True) if watch else None
    while True:
        document = look(loaded, read_clock(clock), host, logs or LOG_FOLDERS)
        if as_json:
            typer.echo(json.dumps(document, indent=None if watch else 2, allow_nan=False))
        else:
            live = watch and sys.stdout.isatty()
            if live:
                typer.echo(CLEAR, nl=False)
            for line in lines(document, live=live):
                typer.echo(f"{typer.style(line.head, fg=line.tone.value)}  {line.rest}")
        if stop is None:
            raise typer.Exit(0 if all(arm["answers"] for arm in document["arms"]) else 1)
        if is_unread():
            return
        for _ in range(WATCH_EVERY_STEPS):
            if stop():
                raise typer.Exit(130)
            time.sleep(WATCH_STEP_S)
