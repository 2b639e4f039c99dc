"""Signals as flags that a loop asks for."""

from __future__ import annotations

import ctypes
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

PR_SET_PDEATHSIG = 1


class StopFlag:
    """Remembers a stop (SIGTERM, SIGINT, SIGHUP) and a release (SIGUSR1); install it before anything is opened.

    SIGHUP, which comes when a terminal or its connection is gone, counts unless it is ignored, as under `nohup`.
    """

    def __init__(self) -> None:
        self.stopped = False
        self.stops = 0  # how often it was asked for
        self.released = False
        self._interrupts = False
        signal.signal(signal.SIGTERM, self._stop)
        signal.signal(signal.SIGINT, self._stop)
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
            signal.signal(signal.SIGHUP, self._stop)
        signal.signal(signal.SIGUSR1, self._release)

    def _stop(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.stopped = True
        self.stops += 1
        if self._interrupts:
            self._interrupts = False  # one is enough, and what it ends may tidy up
            raise KeyboardInterrupt

    def _release(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.released = True

    def __call__(self) -> bool:
        """Whether a stop was asked for."""
        return self.stopped

    @contextmanager
    def interrupting(self) -> Iterator[None]:
        """For work that asks nobody: a stop that comes within the block ends it, as KeyboardInterrupt."""
        self._interrupts = True
        try:
            yield
        finally:
            self._interrupts = False


def begin(with_parent: bool, *, at_once: bool = False) -> StopFlag:
    """Catch requests to stop before anything is opened; at_once: as of `die_with_parent`."""
    requested = StopFlag()
    if with_parent:
        die_with_parent(at_once=at_once)
    return requested


def die_with_parent(*, at_once: bool = False) -> None:
    """Ask the kernel for SIGTERM when the parent dies, so that `coop run` never leaves a process behind.

    at_once: for SIGKILL, which a process that somebody has stopped (SIGSTOP) obeys, too.
    """
    if os.getppid() == 1:
        raise SystemExit("the process that started this one is gone")
    _ask_for_end(signal.SIGKILL if at_once else signal.SIGTERM)


def end_with(parent: int) -> None:
    """The same for a process that knows its parent's number, which may be 1.  Raises SystemExit when it is gone."""
    _ask_for_end()
    if os.getppid() != parent:
        raise SystemExit("the process that started this one is gone")


def _ask_for_end(by: signal.Signals = signal.SIGTERM) -> None:
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, by, 0, 0, 0)
