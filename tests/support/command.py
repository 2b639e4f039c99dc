"""`coop` in this process: a command line in, exit code and both outputs back."""

from __future__ import annotations

import contextlib
import gc
import io
import signal
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from agent.cli.main import dispatch, whole
from tests.support.stops import CAUGHT


@dataclass(frozen=True)
class Done:
    code: int
    out: str
    err: str


def coop(
    *arguments: str | Path | float, err: io.StringIO | None = None, cwd: Path | None = None, stdin: str | None = None
) -> Done:
    """Run one command line as `coop` does, but for the end of the process; garbage is looked for again after it.

    err: where standard error goes; cwd: the folder it runs in; stdin: what a person types.
    """
    out, err = io.StringIO(), err or io.StringIO()
    before = {number: signal.getsignal(number) for number in CAUGHT}
    collects = gc.isenabled()
    try:
        with contextlib.ExitStack() as around:
            around.enter_context(contextlib.redirect_stdout(out))
            around.enter_context(contextlib.redirect_stderr(err))
            if cwd is not None:
                around.enter_context(contextlib.chdir(cwd))
            if stdin is not None:
                around.enter_context(_typed(stdin))
            try:
                code = dispatch([str(a) for a in arguments])
            except SystemExit as end:  # completion answers and ends
                code = int(end.code or 0)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if collects:
            gc.enable()  # an agent and a measurement of the host switch it off for good
    return Done(code, out.getvalue(), err.getvalue())


@contextlib.contextmanager
def _typed(text: str) -> Iterator[None]:
    before, sys.stdin = sys.stdin, io.StringIO(text)
    try:
        yield
    finally:
        sys.stdin = before


def commands() -> Iterator[tuple[str, ...]]:
    """Every command of `coop` by its words."""
    group = whole()
    for name, command in group.commands.items():  # type: ignore[attr-defined]
        inner = getattr(command, "commands", None)
        yield from ((name, word) for word in inner) if inner else ((name,),)
