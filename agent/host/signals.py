"""Signals as flags that a loop asks for."""

from __future__ import annotations

import ctypes
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

PR_SET_PDEATHSIG = 1
_WHY = {
    signal.SIGINT: "Ctrl-C", signal.SIGTERM: "it was told to end", signal.SIGTSTP: "Ctrl-Z",
    signal.SIGHUP: "its terminal or connection is gone",
}  # fmt: skip
OF_BACKGROUND = (signal.SIGTTOU, signal.SIGTTIN)  # of who writes to, or reads, a terminal that is not his: suspend him


class StopFlag:
    """Remembers a stop (SIGTERM, SIGINT, SIGHUP, SIGTSTP) and a release (SIGUSR1); made before anything is opened.

    SIGHUP, which comes when a terminal or its connection is gone, counts unless it is ignored, as under `nohup`; so
    does SIGTSTP (Ctrl-Z), for a suspended process watches over nothing, and servos that hear nothing let go.
    """

    def __init__(self, *, suspends: bool = False) -> None:
        """suspends: Ctrl-Z and a terminal may suspend this process, as any that has no arm to watch over."""
        self.stopped = False
        self.stops = 0  # how often it was asked for
        self.why = ""  # by which signal it was asked for last
        self.released = False
        self.heard: Callable[[str], None] = lambda _: None  # is told each stop at once, and must not block
        self._interrupts = False
        signal.signal(signal.SIGTERM, self._stop)
        signal.signal(signal.SIGINT, self._stop)
        for number in (signal.SIGHUP, *(() if suspends else (signal.SIGTSTP,))):
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._stop)
        if not suspends:
            for number in OF_BACKGROUND:
                signal.signal(number, signal.SIG_IGN)
        signal.signal(signal.SIGUSR1, self._release)

    def _stop(self, number: int, frame: FrameType | None) -> None:
        del frame
        self.why = f"{signal.Signals(number).name}: {_WHY[signal.Signals(number)]}"
        self.stopped = True
        self.stops += 1
        self.heard(self.why)
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
        """For work that asks nobody: a stop that comes within the block ends it, as KeyboardInterrupt.

        So it does where what the work is in drops that exception, or makes another one of it (agent.host.stops).
        """
        self._interrupts, before = True, self.stops
        try:
            yield
        except Exception as error:
            if self.stops > before:
                raise KeyboardInterrupt from error
            raise
        finally:
            self._interrupts = False
        if self.stops > before:
            raise KeyboardInterrupt


def begin(parent: int | None, *, at_once: bool = False) -> StopFlag:
    """Catch requests to stop before anything is opened; parent, at_once: as of `end_with`, None ends with nobody."""
    requested = StopFlag()
    if parent is not None:
        end_with(parent, at_once=at_once)
    return requested


def end_with(parent: int, *, at_once: bool = False) -> None:
    """Ask the kernel for SIGTERM when the parent, of that number, dies, so that `coop run` leaves no process behind.

    at_once: for SIGKILL, which a process that somebody has stopped (SIGSTOP) obeys, too.  Raises SystemExit when it is
    gone already: the kernel tells that to nobody, and who adopts its children need not be process 1.
    """
    by = signal.SIGKILL if at_once else signal.SIGTERM
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, by, 0, 0, 0)
    if os.getppid() != parent:
        raise SystemExit("the process that started this one is gone")
