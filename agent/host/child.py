"""A process of ours that `coop run` has started: its ready line, its words, its end."""

from __future__ import annotations

import os
import selectors
import signal
import subprocess
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path

from agent.host import python
from agent.host.copied import Copy, is_alone
from agent.host.ready_line import READY, values_of
from drivers.interface import Refusal

TELLS = "TELLS "
CUT = "a file that it stored into was cut, as its ring"  # of SIGBUS, at which a process has no words of its own
LOOK_EVERY_S = 0.05  # while a ready line is waited for


class ChildFailed(Refusal):
    """A process of the run ended by itself, or did not get ready."""

    exit_code = 5


class Child:
    """One process of the run, in a session of its own so that Ctrl-C reaches only `coop run`."""

    def __init__(
        self, name: str, arguments: Sequence[str], log_dir: Path, be: Callable[[Sequence[str]], int] | None = None
    ) -> None:
        """be: what a copy of this process does with these arguments; none, or with other threads here: started anew."""
        self.name = name
        self.log = log_dir / f"{name}.log"
        self._received = b""
        self._readies = deque[dict[str, str]]()
        self._said = set[str]()
        self._told: list[str] = []
        self.process: subprocess.Popen[bytes] | Copy
        with self.log.open("wb") as log:
            if be is not None and is_alone():
                self.process = Copy(name, partial(be, arguments), log)
                return
            self.process = subprocess.Popen(
                python.command("agent.process", *arguments),
                env=python.surroundings(),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=log,
                start_new_session=True,
            )

    def wait_ready(self, timeout_s: float, look: Callable[[], None] = lambda: None) -> dict[str, str]:
        """Key-value pairs of the child's next ready line.  Raises ChildFailed when it ends or stays silent.

        look: is called every LOOK_EVERY_S meanwhile; what it raises ends the wait.
        """
        deadline = time.monotonic() + timeout_s
        while not self._readies:
            look()
            left_s = deadline - time.monotonic()
            if left_s <= 0.0:
                raise self.failed(f"not ready after {timeout_s:g} s")
            if not self._listen(min(LOOK_EVERY_S, left_s)):
                self.process.wait()
                raise self.failed("ended before it was ready")
        return self._readies.popleft()

    def has_said(self, key: str) -> bool:
        """Whether this key has been in one of its ready lines, also one that has been taken."""
        self._listen(0.0)
        return key in self._said

    def told(self) -> list[str]:
        """What the child has told for a person since the last look; nothing is waited for."""
        self._listen(0.0)
        told, self._told = self._told, []
        return told

    def _listen(self, within_s: float) -> bool:
        """Take in what it says within that time; whether it may say more."""
        out = self.process.stdout
        assert out is not None
        with selectors.DefaultSelector() as selector:
            selector.register(out, selectors.EVENT_READ)
            if not selector.select(within_s):
                return True
        chunk = os.read(out.fileno(), 4096)
        *lines, self._received = (self._received + chunk).split(b"\n")
        for line in (line.decode(errors="replace") for line in lines):
            if line.startswith(READY):
                self._readies.append(values_of(line))
                self._said.update(self._readies[-1])
            elif line.startswith(TELLS):
                self._told.append(line.removeprefix(TELLS))
        return bool(chunk)

    def failed(self, what: str) -> ChildFailed:
        """The error that tells of this child's end, with its last words."""
        last, code = self.last_words(), self.process.poll()
        ended = f"exit code {code}: {CUT}" if code == -signal.SIGBUS else f"exit code {code}"
        said = "it still runs" if code is None else ended
        return ChildFailed(
            self.name,
            found=f"{what} ({said})" + (f": {last}" if last else ""),
            expected="a process that runs to the end",
            remedy=f"its log is {self.log}" if self.log.exists() else f"{self.log} is gone, which was its log",
        )

    def last_words(self) -> str:
        """Last line that the child wrote to its log, without the program's own prefix; none where the log is gone."""
        try:
            lines = self.log.read_text(errors="replace").strip().splitlines()
            full = not lines and os.statvfs(self.log.parent).f_bavail == 0
        except OSError:
            return ""
        if full:
            return "no room is left on the disk, not for its words either"
        return lines[-1].removeprefix("coop: ") if lines else ""

    def terminate(self) -> None:
        """Ask for an end; nothing happens when it has ended."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)

    def wait(self, timeout_s: float) -> int | None:
        """Exit code, or None when it still runs after the time."""
        try:
            return self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return None

    def kill(self) -> None:
        """End it at once, whatever it is doing."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        if self.process.stdout is not None:
            self.process.stdout.close()


def wait_all(children: Iterable[Child], timeout_s: float) -> None:
    """Wait for all of them until one common time-out."""
    deadline = time.monotonic() + timeout_s
    for child in children:
        child.wait(max(0.0, deadline - time.monotonic()))
