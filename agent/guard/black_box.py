"""Has the post-mortem written beside the hold, by a process that is waited for only afterwards, and not for ever."""

from __future__ import annotations

import contextlib
import math
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from agent.host import python

WRITER: Final = "agent.process.post_mortem"
LOOK_S: Final = 0.02
PATIENCE_S: Final = 60.0  # with a writer once nothing is held any more; it takes seconds, on a busy host too
KILL_S: Final = 5.0  # until it is gone; a disk that does not answer may keep it longer
UNFINISHED: Final = ".part"  # behind the name of a file that is not whole


class BlackBox:
    """Starts the writer once, some cycles after the hold began, so that the hold's first cycles are in the file."""

    def __init__(self, arguments: Sequence[str], out: Path, cycles: int, *, wanted: bool) -> None:
        """arguments: of `agent.process.post_mortem`; out: the file that they name."""
        self._command = python.command(WRITER, *arguments)
        self._part = out.with_name(out.name + UNFINISHED)
        self._left = cycles if wanted else 0
        self._process: subprocess.Popen[bytes] | None = None
        self._refused = ""

    def beat(self) -> None:
        """One cycle of the hold."""
        if self._left:
            self._left -= 1
            if not self._left:
                self._start()

    def finish(self, meanwhile: Callable[[], None], missing: Callable[[str], None]) -> None:
        """The hold is over: start the writer if that was not its turn yet, and wait for it, at most `PATIENCE_S`.

        meanwhile is called again and again; missing is told why there is no whole file.
        """
        if self._left:
            self._left = 0
            self._start()
        process, self._process = self._process, None
        if self._refused:
            missing(f"its writer could not be started ({self._refused})")
        if process is None:
            return
        if not _ended(process, PATIENCE_S, meanwhile):
            process.kill()
            _ended(process, KILL_S, meanwhile)
            missing(f"its writer had not ended after {PATIENCE_S:g} s and was killed{self._begun()}")
        elif code := process.returncode:
            missing(f"its writer ended with {code}, see the guard's journal{self._begun()}")

    def _begun(self) -> str:
        """Where what the writer began is, if it began."""
        return f"; what it began is in {self._part}" if self._part.exists() else ""

    def _start(self) -> None:
        try:
            self._process = subprocess.Popen(
                self._command,
                stdin=subprocess.DEVNULL,
                env=python.surroundings(),
                start_new_session=True,  # Ctrl-C and Ctrl-Z are for the guard
            )
        except OSError as error:  # the arm is held without a file too
            self._refused = error.strerror or str(error)


def _ended(process: subprocess.Popen[bytes], within_s: float, meanwhile: Callable[[], None]) -> bool:
    """Whether it ends by then."""
    for _ in range(math.ceil(within_s / LOOK_S)):
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(LOOK_S)
            return True
        meanwhile()
    return False
