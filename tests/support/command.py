"""`coop` in this process: a command line in, exit code and both outputs back."""

from __future__ import annotations

import contextlib
import io
import signal
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import typer

from agent.cli.main import app, dispatch

_TAKEN = (signal.SIGTERM, signal.SIGINT, signal.SIGUSR1)


@dataclass(frozen=True)
class Done:
    code: int
    out: str
    err: str


def coop(*arguments: str | Path, err: io.StringIO | None = None) -> Done:
    """Run one command line as `coop` does, but for the end of the process; err: where standard error goes."""
    out, err = io.StringIO(), err or io.StringIO()
    before = {number: signal.getsignal(number) for number in _TAKEN}
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            try:
                code = dispatch([str(a) for a in arguments])
            except SystemExit as end:  # completion answers and ends
                code = int(end.code or 0)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return Done(code, out.getvalue(), err.getvalue())


def commands() -> Iterator[tuple[str, ...]]:
    """Every command of `coop` by its words."""
    group = typer.main.get_command(app)
    for name, command in group.commands.items():  # type: ignore[attr-defined]
        inner = getattr(command, "commands", None)
        yield from ((name, word) for word in inner) if inner else ((name,),)
