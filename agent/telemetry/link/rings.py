"""The ring that a telemetry process is to publish: waited for, and looked at whether it is that member's."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from agent.telemetry.link.patience import Patience
from agent.telemetry.link.publication import Pace, PublishOptions
from agent.telemetry.link.wire import CYCLE_S
from agent.telemetry.ring.file import RingError, exists
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.ring.texts import TextReader, texts_path
from agent.telemetry.row.topics import PLANT


def wait_for_ring(
    options: PublishOptions, since_ns: int, stop: Callable[[], bool], say: Callable[[str], None]
) -> RingReader | None:
    """The member's ring once it is there, None after a stop; say: is told in words once that lasts.  Raises RingError.

    since_ns: UTC of the start.  A ring under the member's name that is another's is refused.
    """
    past = False  # a ring is there, and belongs to another log
    patience = Patience(lambda: say(_without_ring(options, past=past)))
    while not stop():
        patience.waiting(True)
        if exists(options.ring):
            reader = RingReader(options.ring, options.layout, acknowledges=options.pace is Pace.LOCKSTEP)
            any_age = not (options.fresh or options.follow)
            if any_age or reader.writer_alive or reader.header.created_ns >= since_ns:
                _require_own(options, reader)
                return reader
            reader.close()
            past = True
        time.sleep(CYCLE_S)
    return None


def _require_own(options: PublishOptions, reader: RingReader) -> None:
    """Close it and raise RingError where it is another member's: its rows would be in the log as this one's."""
    name, joints = reader.header.name, reader.header.joints
    if name != options.member:
        found, expected = f"the ring of {name!r}", f"that of {options.member!r}"
    elif options.joints is not None and joints != options.joints:
        found, expected = f"joints {', '.join(joints) or 'none'}", ", ".join(options.joints) or "none"
    else:
        return
    reader.close()
    raise RingError(
        f"telemetry ring {options.ring}", found=found, expected=expected,
        remedy=f"give the ring that the agent of {options.member} made from this cell file",
    )  # fmt: skip


def _without_ring(options: PublishOptions, *, past: bool) -> str:
    maker = "coop plant` or `coop emulate" if options.member == PLANT else f"coop agent --arm {options.member}"
    where = f"the ring {options.ring}, which `{maker}` makes there or where its --ring says"
    waits = f"waits for {where}, until it is stopped"
    if past and not options.follow:
        return f"{waits}; the one there is an earlier run's, which --ring with that path sends"
    return waits


def open_texts(ring: Path, pid: int, stack: ExitStack) -> TextReader | None:
    """Texts of the process that writes the ring, None when it writes none; those of an earlier one do not count."""
    if not texts_path(ring).exists():
        return None
    reader = TextReader(ring)
    if reader.pid != pid:
        reader.close()
        return None
    stack.callback(reader.close)
    return reader
