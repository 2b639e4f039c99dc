"""A process of ours that begins as a copy of this one, which has loaded what it needs: at once, in the same memory.

Loading is most of a short process: 0.4 s of processor time for numpy, pinocchio and our own modules.  A copy has what
another thread held at that instant, and not the thread, so only a process that has one is copied.
"""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import BinaryIO, Final, NoReturn

LOOK_EVERY_S: Final = 0.005  # whether it has ended, while that is waited for
NAME_MAX: Final = 15  # letters of a process's name that the kernel keeps


def is_alone() -> bool:
    """Whether this process has one thread: libraries start some that Python knows nothing of."""
    return sum(1 for _ in Path("/proc/self/task").iterdir()) == 1


class Copy:
    """What `subprocess.Popen` is for a process that is started anew, as far as a run asks.

    It is in a session of its own, reads nothing, hears signals as a new process does, and has no file open but its
    standard streams.  What this process registered for its own exit, or does on its way out, the copy never does.
    """

    def __init__(self, name: str, be: Callable[[], int], words: BinaryIO) -> None:
        """name: by which `top` and `pgrep` know it; be: what it does, its exit code; words: where it writes them."""
        reads, writes = os.pipe()
        for stream in (sys.stdout, sys.stderr):
            stream.flush()  # or both would write what is left
        gc.freeze()  # a look for cycles would write to, and so copy, all that is there
        self.stdout = os.fdopen(reads, "rb", buffering=0)
        self.returncode: int | None = None
        try:
            with _deaf() as deaf:  # a signal for the copy waits until it hears as a new process does
                self.pid = os.fork()
                if not self.pid:
                    _live(name, be, (writes, words.fileno()), deaf)
        finally:
            os.close(writes)

    def poll(self) -> int | None:
        """Exit code; of who was killed by a signal its number, negative; None while it runs."""
        if self.returncode is None:
            ended, status = os.waitpid(self.pid, os.WNOHANG)
            if ended:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Exit code, once it has ended.  Raises subprocess.TimeoutExpired."""
        until = None if timeout is None else time.monotonic() + timeout
        while (code := self.poll()) is None:
            if until is not None and time.monotonic() >= until:
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0)
            time.sleep(LOOK_EVERY_S)
        return code

    def send_signal(self, number: int) -> None:
        """Send it a signal, if it has not ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """End it at once."""
        self.send_signal(signal.SIGKILL)


@contextlib.contextmanager
def _deaf() -> Iterator[Collection[int]]:
    """For a moment in which no signal is heard; what was deaf before."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
    try:
        yield before
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _live(name: str, be: Callable[[], int], streams: tuple[int, int], deaf: Collection[int]) -> NoReturn:
    """Be the copy, to its end; nothing of who was copied goes on."""
    code = 1
    try:
        os.setsid()
        _take(*streams)
        Path("/proc/self/comm").write_text(name[:NAME_MAX])
        _hear_as_new()
        signal.pthread_sigmask(signal.SIG_SETMASK, deaf)
        code = be()
    except SystemExit as ended:
        code = _code_of(ended)
    except BaseException:  # noqa: BLE001 - of who was copied nothing may go on
        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
        os._exit(code)


def _take(out: int, words: int) -> None:
    """Have standard streams of its own, and no other file."""
    os.dup2(out, 1)
    os.dup2(words, 2)
    os.closerange(3, os.sysconf("SC_OPEN_MAX"))  # before one more is opened, where there may be few
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    if nothing > 0:
        os.close(nothing)
    sys.stdin = os.fdopen(0, closefd=False)
    sys.stdout = os.fdopen(1, "w", closefd=False)
    sys.stderr = os.fdopen(2, "w", errors="backslashreplace", buffering=1, closefd=False)


def _hear_as_new() -> None:
    """End by a signal as a process does that has just been started; what is ignored stays so."""
    for number in signal.valid_signals():
        if callable(signal.getsignal(number)):
            signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)


def _code_of(ended: SystemExit) -> int:
    """As the interpreter has it."""
    if ended.code is None or isinstance(ended.code, int):
        return ended.code or 0
    sys.stderr.write(f"{ended.code}\n")
    return 1
