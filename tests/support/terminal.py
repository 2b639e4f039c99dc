"""A command on a real terminal, in a process group of its own below a shell's, as job control has it."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Final, Self

from tests.support.coop import COOP, TIMEOUT_S

CTRL_C, CTRL_Z = b"\x03", b"\x1a"
# The shell: takes the terminal, starts the command in front or behind, and says what has become of it.
SHELL: Final = """
import fcntl, os, signal, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
where, *command = sys.argv[1:]
job_control = signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU
signal.signal(signal.SIGTTOU, signal.SIG_IGN)
child = os.fork()
if not child:
    os.setpgid(0, 0)
    if where == "front":
        os.tcsetpgrp(0, os.getpid())
    for number in job_control:
        signal.signal(number, signal.SIG_DFL)
    os.execv(command[0], command)
while True:
    _, status = os.waitpid(child, os.WUNTRACED)
    if not os.WIFSTOPPED(status):
        sys.exit(os.waitstatus_to_exitcode(status))
    print(f"SUSPENDED by {signal.Signals(os.WSTOPSIG(status)).name}", flush=True)
    os.killpg(child, signal.SIGKILL)
"""


class Terminal:
    """A command of `coop`, or another, that a person starts and types to; it is gone after the block."""

    def __init__(self, *arguments: str | Path, folder: Path, program: tuple[str, ...] = COOP, **how: Any) -> None:
        """how: `behind` for a command in the background, `tostop` as of stty, `environment`."""
        where = "behind" if how.get("behind") else "front"
        self.own, theirs = os.openpty()
        if how.get("tostop"):
            subprocess.run(["stty", "tostop"], stdin=theirs, check=True)
        self.process = subprocess.Popen(
            [sys.executable, "-c", SHELL, where, *program, *map(str, arguments)], cwd=folder, stdin=theirs,
            stdout=theirs, stderr=theirs, start_new_session=True, env=os.environ | how.get("environment", {}),
        )  # fmt: skip
        os.close(theirs)
        self.shown = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self.own)  # a hangup, of which all that is left there ends
        try:
            self.process.wait(TIMEOUT_S)
        finally:
            self.process.kill()

    def type(self, keys: bytes) -> None:
        os.write(self.own, keys)

    def until(self, what: str) -> None:
        """Wait for words, from the first that were shown on."""
        deadline = time.monotonic() + TIMEOUT_S
        while what not in self.shown:
            assert "SUSPENDED" not in self.shown, self.shown
            assert self._read(), self.shown
            assert time.monotonic() < deadline, self.shown

    def end(self) -> int:
        """Wait for its end; its exit code."""
        while self._read():
            pass
        return self.process.wait(TIMEOUT_S)

    def _read(self) -> bool:
        if not select.select([self.own], [], [], TIMEOUT_S)[0]:
            return False
        try:
            more = os.read(self.own, 65536)
        except OSError:  # nobody has it open any more
            return False
        self.shown += more.decode(errors="replace")
        return bool(more)
