"""Another process by its handle: whether it runs none of its own code any more, and whether it has ended.

A process that was killed gives its memory back before its handle says so: with some hundred megabytes locked for a
real-time loop that takes from 50 ms to half a second, longer than the servos of an arm wait.  Before that it has lost
its program: /proc/PID/exe names none any more.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
from collections.abc import Callable
from pathlib import Path

KILL_LOOK_MS = 5


class ProcessHandle:
    """A pidfd and what it names; the descriptor is this one's from now on."""

    def __init__(self, pidfd: int) -> None:
        """Of a process that runs."""
        self._fd = pidfd
        self._program: Path | None = Path(f"/proc/{_pid_of(pidfd)}/exe")
        if not self._has_program():  # hidden from this process, or gone already: the handle alone says so
            self._program = None

    def fileno(self) -> int:
        """Readable once the process has ended."""
        return self._fd

    @property
    def ended(self) -> bool:
        """Whether all that was the process's has been given back: its sockets and locks, too."""
        return _is_readable(self._fd, 0)

    @property
    def gone(self) -> bool:
        """Whether it runs none of its own code any more."""
        return self.ended or not self._has_program()

    def kill(self, meanwhile: Callable[[], None]) -> None:
        """End it, whatever it does, and wait until it is gone; meanwhile is called again and again."""
        with contextlib.suppress(ProcessLookupError):
            signal.pidfd_send_signal(self._fd, signal.SIGKILL)
        while self._has_program() and not _is_readable(self._fd, KILL_LOOK_MS):
            meanwhile()

    def close(self) -> None:
        """Give the descriptor back."""
        os.close(self._fd)

    def _has_program(self) -> bool:
        if self._program is not None:
            try:
                self._program.readlink()  # takes some µs, and keeps none of the memory that is given back
            except FileNotFoundError:
                return False
            except OSError:
                pass  # nobody may be taken for gone who is not
        return True


def _pid_of(pidfd: int) -> int:
    """As this process's /proc has it; -1 once it has ended."""
    lines = Path(f"/proc/self/fdinfo/{pidfd}").read_text().splitlines()
    return int(dict(line.split(":\t") for line in lines)["Pid"])


def _is_readable(fd: int, timeout_ms: int) -> bool:
    poller = select.poll()
    poller.register(fd, select.POLLIN)
    return bool(poller.poll(timeout_ms))
