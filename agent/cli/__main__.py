"""The command `coop` as a process, also by `python -m agent.cli`: Ctrl-C while it loads ends it without a traceback."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType

STOPPED = 130


def main() -> None:
    """Load the command, then run it."""
    heard = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # not of what a script runs in background
    if heard:
        signal.signal(signal.SIGINT, _end)
    from agent.cli.main import main as coop

    try:
        if heard:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        coop()
    except KeyboardInterrupt:  # before the line is read; a command hears it itself
        sys.exit(STOPPED)


def _end(number: int, frame: FrameType | None) -> None:
    """End at once: while modules load, nothing is open, and an exception would pass through what loads them."""
    del number, frame
    os._exit(STOPPED)


if __name__ == "__main__":
    main()
