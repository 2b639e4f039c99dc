"""A flag of requests to stop, whose signals the test's process has as before when it is done with."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager

from agent.host.signals import StopFlag

CAUGHT = (
    signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU, signal.SIGUSR1
)  # fmt: skip


@contextmanager
def stop_flag() -> Iterator[StopFlag]:
    before = {number: signal.getsignal(number) for number in CAUGHT}
    try:
        yield StopFlag()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
