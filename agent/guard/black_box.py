"""Has the post-mortem written while the arm is held, by a process of its own that nobody waits for."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from typing import Final

WRITER: Final = "agent.process.post_mortem"
LOOK_S: Final = 0.02


class BlackBox:
    """Starts the writer once, some cycles after the hold began, so that the hold's first cycles are in the file."""

    def __init__(self, arguments: Sequence[str], cycles: int, *, wanted: bool) -> None:
        """arguments: of `agent.process.post_mortem`."""
        self._command = [sys.executable, "-m", WRITER, *arguments]
        self._left = cycles if wanted else 0
        self._process: subprocess.Popen[bytes] | None = None

    def beat(self) -> None:
        """One cycle of the hold."""
        if self._left:
            self._left -= 1
            if not self._left:
                self._start()

    def finish(self, meanwhile: Callable[[], None]) -> None:
        """The hold is over: start the writer if that was not its turn yet, and wait for it.

        meanwhile is called again and again.
        """
        if self._left:
            self._left = 0
            self._start()
        while self._process is not None:
            try:
                self._process.wait(LOOK_S)
            except subprocess.TimeoutExpired:
                meanwhile()
            else:
                self._process = None

    def _start(self) -> None:
        surroundings = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        with contextlib.suppress(OSError):  # the arm is held without a file too
            self._process = subprocess.Popen(self._command, stdin=subprocess.DEVNULL, env=surroundings)
