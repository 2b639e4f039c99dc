"""A process of a run from the words of its typed command, started anew or as a copy of who starts it."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Sequence

from agent.host.starting import USAGE, of_host, settle, tell
from agent.process.commands import read
from agent.process.started import Listener, run


def main(words: Sequence[str]) -> int:
    """Exit code of the process; a Refusal is told in its lines."""
    settle()
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
        from drivers.interface import Refusal  # numpy with it, which not every process loads at once

        if not isinstance(error, Refusal):
            raise
        for line in error.lines:
            _told(f"coop: {line}")
        return error.exit_code


def load(*, servos: bool) -> None:
    """Load what copies of this process need, but for the network, which those do that use it; servos: emulated ones."""
    import agent.process.agent
    import agent.process.floats
    import agent.process.plant

    if servos:
        import agent.process.emulate  # noqa: F401


def _told(text: str) -> None:
    with contextlib.suppress(OSError):  # a full disk under its words is no failure of what it has done
        sys.stderr.write(text + "\n")
        sys.stderr.flush()


def _told_parent(text: str) -> None:
    with contextlib.suppress(OSError):  # it may have gone
        tell(text)
