"""A process of ours that `coop run` has started: its ready line, its words, its end."""

from __future__ import annotations

import os
import selectors
import signal
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path

from agent.host import python
from drivers.interface import Refusal

READY, TELLS = "READY ", "TELLS "


class ChildFailed(Refusal):
    """A process of the run ended by itself, or did not get ready."""

    exit_code = 5


class Child:
    """One process of the run, in a session of its own so that Ctrl-C reaches only `coop run`."""

    def __init__(self, name: str, arguments: Sequence[str], log_dir: Path) -> None:
        self.name = name
        self.log = log_dir / f"{name}.log"
        self._received = b""
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                python.command("agent.process", *arguments),
                env=python.surroundings(),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=log,
                start_new_session=True,
            )

    def wait_ready(self, timeout_s: float) -> dict[str, str]:
        """Key-value pairs of the child's next ready line.  Raises ChildFailed when it ends or stays silent."""
        out = self.process.stdout
        assert out is not None
        deadline = time.monotonic() + timeout_s
        while b"\n" not in self._received:
            if not self._says_more(max(0.0, deadline - time.monotonic())):
                raise self.failed(f"not ready after {timeout_s:g} s")
            chunk = os.read(out.fileno(), 4096)
            if not chunk:
                self.process.wait()
                raise self.failed("ended before it was ready")
            self._received += chunk
        head, _, self._received = self._received.partition(b"\n")
        line = head.decode()
        return dict(pair.split("=", 1) for pair in line.removeprefix(READY).split())

    def told(self) -> list[str]:
        """What the child has told for a person since the last look; nothing is waited for."""
        out = self.process.stdout
        assert out is not None
        if self._says_more(0.0):
            self._received += os.read(out.fileno(), 4096)
        *lines, self._received = self._received.split(b"\n")
        texts = (line.decode(errors="replace") for line in lines)
        return [text.removeprefix(TELLS) for text in texts if text.startswith(TELLS)]

    def _says_more(self, within_s: float) -> bool:
        assert self.process.stdout is not None
        with selectors.DefaultSelector() as selector:
            selector.register(self.process.stdout, selectors.EVENT_READ)
            return bool(selector.select(within_s))

    def failed(self, what: str) -> ChildFailed:
        """The error that tells of this child's end, with its last words."""
        last = self.last_words()
        return ChildFailed(
            self.name,
            found=f"{what} (exit code {self.process.poll()})" + (f": {last}" if last else ""),
            expected="a process that runs to the end",
            remedy=f"its log is {self.log}",
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
