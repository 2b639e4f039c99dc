"""What several commands of `coop` share: options with their completion, readiness, stop requests, JSON."""

from __future__ import annotations

import gc
import json
import math
import os
import sys
import termios
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from agent.cli import complete

if TYPE_CHECKING:
    from rich.console import Console

    from drivers.interface import Refusal


CellPath = Annotated[
    Path,
    typer.Argument(
        metavar="CELL",
        help="Cell file (TOML), or the name of a shipped cell.",
        show_default=False,
        autocompletion=complete.cells,
    ),
]
LogPath = Annotated[Path, typer.Argument(metavar="LOG", help="MCAP log.", show_default=False)]
Overrides = Annotated[
    list[str],
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Change one value of the cell file.", autocompletion=complete.settings
    ),
]
ArmName = Annotated[
    str, typer.Option("--arm", help="Arm of the cell.", show_default=False, autocompletion=complete.arms)
]
DEFAULT_ENDPOINT = "tcp/127.0.0.1:7448"  # 7447 is the router of ROS 2
ROS_ROUTER = "tcp/127.0.0.1:7447"  # where `rmw_zenohd` listens
NetworkConfig = Annotated[Path | None, typer.Option(help="Zenoh configuration (TLS, access control) instead.")]
ControlSockets = Annotated[list[Path], typer.Option("--control", help="Control sockets instead of the usual ones.")]
SomeArms = Annotated[list[str], typer.Option("--arm", help="Only these arms.", autocompletion=complete.arms)]
WithParent = Annotated[int | None, typer.Option(hidden=True, help="Process that starts this one, with which it ends.")]
UtcOffset = Annotated[
    int | None, typer.Option(hidden=True, help="UTC minus CLOCK_MONOTONIC, ns, as the run has found it.")
]
Stops = Annotated[bool, typer.Option("--stops", hidden=True, help="Arms of [[simulation.fault]] are told to hold.")]
CommonStart = Annotated[
    Path | None, typer.Option(hidden=True, help="File in which the run will say when the trajectory starts.")
]
AtOnce = Annotated[bool, typer.Option("--at-once", hidden=True)]
AsJson = Annotated[bool, typer.Option("--json", help="For scripts: one JSON document on standard output.")]
Force = Annotated[bool, typer.Option("--force", help="Replace what is there.")]

WIDTH_ELSEWHERE = 240  # columns where there is no terminal, so that no word of a table is cut


def instant(value: float | None) -> float | None:
    """What an option says in seconds of a log, or without end; `nan`, before and after nothing, is refused."""
    if value is not None and math.isnan(value):
        raise typer.BadParameter("seconds are a number")
    return value


def in_front() -> bool:
    """Whether a person can type to this command: it has a terminal, and no other command is in front of that."""
    if sys.stdin is None or not sys.stdin.isatty():
        return False
    try:
        return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except OSError:  # a terminal that is not its session's knows no foreground
        return True


def asked_yes(question: str) -> bool:
    """Whether a person at the terminal says yes; no where there is none."""
    return in_front() and confirmed(question)


def confirmed(question: str) -> bool:
    """Whether standard input says yes; at a terminal, what was typed before the question is no answer to it."""
    if sys.stdin is not None and sys.stdin.isatty():
        termios.tcflush(sys.stdin, termios.TCIFLUSH)
    return typer.confirm(question, err=True)


def require_yes(question: str) -> None:
    """Go on where standard input says yes, as `confirmed` hears it; end the command where it does not."""
    if not confirmed(question):
        raise typer.Abort


def require_use(
    given: Mapping[str, bool], refusal: type[Refusal], *, found: str, expected: str, remedy: str = ""
) -> None:
    """Raise `refusal` where an option is given that would change nothing; by option, whether it was given.

    remedy: what makes it count, if that is possible.
    """
    named = [option for option, was_given in given.items() if was_given]
    if named:
        remedy = f"{remedy}, or leave it out" if remedy else "leave it out"
        raise refusal(", ".join(named), found=found, expected=expected, remedy=remedy)


def note(text: str) -> None:
    """One line on standard error."""
    typer.echo(text, err=True)


@contextmanager
def uncollected() -> Iterator[None]:
    """Without looking for garbage: what a command loads and computes in a second makes hardly any.

    Nor is it looked for at once afterwards: what has been made by then counts as old.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.freeze()
            gc.unfreeze()  # into the oldest generation
            gc.enable()


def console() -> Console:
    """Standard output for tables: as wide as the terminal, or as wide as a table wants to be."""
    from rich.console import Console

    shown = Console(emoji=False)
    return shown if shown.is_terminal else Console(width=max(shown.width, WIDTH_ELSEWHERE), emoji=False)


def coloured() -> bool:
    """Whether a person looks at standard output, or wants to be treated as one who does."""
    return sys.stdout.isatty() or bool(os.environ.get("FORCE_COLOR"))


def print_json(document: dict[str, Any]) -> None:
    """The one JSON document of a command with --json."""
    typer.echo(json.dumps(document, indent=2, allow_nan=False))
