"""`python -m agent.process VERB CELL ...`: a process of a run, from the words of its typed command.

What `coop VERB CELL ...` does, without what reads the lines of persons, which costs as long as a numpy.
"""

from __future__ import annotations

import contextlib
import sys

from agent.host.starting import USAGE, end, of_host, settle, tell
from agent.process.commands import read
from agent.process.started import Listener, run


def main() -> int:
    """Exit code of the process; a Refusal is told in its lines."""
    settle()
    words = sys.argv[1:]
    try:
        command = read(words)
    except (LookupError, ValueError, TypeError):
        _told(
            f"coop: process: found {' '.join(words) or 'no words'}, expected those of a typed command; use `coop VERB`"
        )
        return USAGE
    try:
        return run(command, Listener(_told, parent=_told_parent))
    except OSError as error:
        _told(f"coop: {of_host(error)}")
        return USAGE
    except Exception as error:
        from drivers.interface import Refusal  # noqa: PLC0415 - numpy with it, which not every process loads at once

        if not isinstance(error, Refusal):
            raise
        for line in error.lines:
            _told(f"coop: {line}")
        return error.exit_code


def _told(text: str) -> None:
    with contextlib.suppress(OSError):  # a full disk under its words is no failure of what it has done
        sys.stderr.write(text + "\n")
        sys.stderr.flush()


def _told_parent(text: str) -> None:
    with contextlib.suppress(OSError):  # it may have gone
        tell(text)


if __name__ == "__main__":
    end(main())
