"""Processes of the tests' own, forked from one that has imported what they need: a new one would import it anew.

Whoever forks has no thread and no open file of the tests; it ends with the test run.
"""

from __future__ import annotations

import contextlib
import multiprocessing
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from typing import Any

FORKED = multiprocessing.get_context("forkserver")
FORKED.set_forkserver_preload(
    [
        "tests.support.servos.motor_emulator",
        "tests.support.servos.wire_emulator",
        "tests.support.telemetry.telemetry_cell",
    ]
)
END_S = 30.0


@contextlib.contextmanager
def serving(serve: Callable[..., None], *arguments: Any) -> Iterator[multiprocessing.process.BaseProcess]:
    """A process that runs `serve(*arguments, stop)`; `stop` comes true on the way out, where it must end well."""
    asked, ask = FORKED.Pipe(duplex=False)
    process = FORKED.Process(target=_serve, args=(serve, arguments, asked), daemon=True)
    process.start()
    asked.close()
    try:
        yield process
    finally:
        ask.close()
        process.join(END_S)
        assert process.exitcode == 0


def _serve(serve: Callable[..., None], arguments: tuple[Any, ...], asked: Connection) -> None:
    serve(*arguments, lambda: asked.poll(0))  # readable once the other end is closed
