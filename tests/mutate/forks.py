"""Work in forked children, some at a time, each with a folder and a process group of its own and a limit on its time.

A child tells what it is doing by `tell`; what it said last is all that is left of one that hangs or dies.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, Pipe, wait
from typing import Any

from agent.host.signals import end_with

Tell = Callable[[Any], None]
Work = Callable[[Tell], None]


@dataclass(frozen=True)
class Job:
    """One child's work, its limit in seconds of wall time, and who gets the list of what it said.

    hear: gets each word as it comes.
    """

    work: Work
    limit_s: float
    done: Callable[[list[Any]], None] = lambda _: None
    hear: Callable[[Any], None] = lambda _: None


@dataclass
class _Child:
    pid: int
    pipe: Connection
    folder: str
    deadline: float
    job: Job
    said: list[Any] = field(default_factory=list)

    def listen(self) -> bool:
        """Take what it said; False when nothing more can come."""
        try:
            while self.pipe.poll():
                word = self.pipe.recv()
                self.said.append(word)
                self.job.hear(word)
        except (EOFError, OSError):
            return False
        return True

    def end(self) -> None:
        """Whatever it started ends with it."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        os.waitpid(self.pid, 0)
        self.pipe.close()
        shutil.rmtree(self.folder, ignore_errors=True)
        self.job.done(self.said)


def run_all(jobs: Iterable[Job], at_once: int) -> None:
    """Run the jobs in order, `at_once` of them at a time; the next job is asked for when there is room for it."""
    running: list[_Child] = []
    waiting, more = iter(jobs), True
    try:
        while more or running:
            while more and len(running) < at_once:
                job = next(waiting, None)
                more = job is not None
                if job is not None:
                    running.append(_started(job))
            wait([child.pipe for child in running], timeout=0.5)
            for child in list(running):
                if not child.listen() or time.monotonic() > child.deadline:
                    running.remove(child)
                    child.end()
    finally:
        for child in running:
            child.end()


def _started(job: Job) -> _Child:
    folder = tempfile.mkdtemp(prefix="mu-")
    receives, sends = Pipe(duplex=False)
    parent = os.getpid()
    pid = os.fork()
    if pid:
        with contextlib.suppress(OSError):  # whichever comes first, this or the child's own
            os.setpgid(pid, pid)
        sends.close()
        return _Child(pid, receives, folder, time.monotonic() + job.limit_s, job)
    try:
        os.setpgid(0, 0)
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        end_with(parent)
        nothing = os.open(os.devnull, os.O_RDWR)
        for fd in (0, 1, 2):
            os.dup2(nothing, fd)
        os.environ["PYTEST_DEBUG_TEMPROOT"] = os.environ["TMPDIR"] = tempfile.tempdir = folder
        job.work(sends.send)
    except BaseException:  # noqa: BLE001 - whatever it was, the parent tells it
        sends.send(("crashed", traceback.format_exc()))
    finally:
        os._exit(0)
    raise AssertionError("a child does not come here")
