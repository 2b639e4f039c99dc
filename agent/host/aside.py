"""A line on the terminal of a process whose loop waits for nobody, also not for a terminal that Ctrl-S has stopped."""

from __future__ import annotations

import os
import sys
from contextlib import suppress


class Aside:
    """Says lines on standard error while that is a terminal, and nothing elsewhere: there the log has them.

    It never blocks: what a terminal does not take at once is lost.
    """

    def __init__(self) -> None:
        """Open the terminal a second time, for its other users wait as they like."""
        self._fd: int | None = None
        with suppress(OSError, ValueError):  # closed, or no file
            if sys.stderr.isatty():
                flags = os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
                self._fd = os.open(f"/proc/self/fd/{sys.stderr.fileno()}", flags)

    def __call__(self, text: str) -> None:
        """One line."""
        if self._fd is not None:
            with suppress(OSError):
                os.write(self._fd, f"{text}\n".encode(errors="backslashreplace"))
