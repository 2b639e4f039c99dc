"""An agent that is watched: its process, its ring, and what becomes of both when it is gone."""

from __future__ import annotations

import contextlib
import os
import select
import signal
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from agent.guard.line import GuardError, Said
from agent.guard.pulse import Pulse
from agent.guard.resume import ROWS
from agent.guard.vigil import Vigil
from agent.replay.tick import Rows
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.ring.texts import TextWriter
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.sample import AGENT_STATE

DESCRIPTORS = 4  # of the process, its guard's pulse, the ring, its texts
KILL_LOOK_MS = 20


@dataclass
class Watched:
    """One agent with its torque on.  Nothing is written to ring and texts before `inherit`."""

    pidfd: int
    ring: Path
    reader: RingReader
    writer: RingWriter
    texts: TextWriter
    pulse: Pulse
    vigil: Vigil
    handed_over: bool = False  # it has said that it ends, and that the object is held
    rehearsed: bool = False

    @classmethod
    def of(cls, said: Said, vigil: Vigil) -> Watched:
        """From its word `watch`, whose first descriptors are taken.  Raises GuardError, RingError, and closes them."""
        if len(said.fds) < DESCRIPTORS:
            said.drop()
            raise GuardError(
                "word 'watch'", found=f"{len(said.fds)} descriptors", expected="process, pulse, ring and texts",
                remedy="start agent and guard from one release",
            )  # fmt: skip
        pidfd, pulse_fd, ring, texts = said.fds[:DESCRIPTORS]
        with contextlib.ExitStack() as always, contextlib.ExitStack() as undo:
            always.callback(os.close, ring)
            always.callback(os.close, texts)
            undo.callback(os.close, pidfd)
            pulse = Pulse(pulse_fd)
            undo.callback(pulse.close)
            reader = undo.enter_context(RingReader(Path(f"/proc/self/fd/{ring}"), AGENT_STATE))
            writer = undo.enter_context(RingWriter.go_on(os.dup(ring), AGENT_STATE))
            text_writer = TextWriter.go_on(os.dup(texts))
            undo.pop_all()
        return cls(pidfd, Path(str(said.content.get("ring"))), reader, writer, text_writer, pulse, vigil)

    @property
    def gone(self) -> bool:
        """Whether its process has ended."""
        return _ended(self.pidfd, 0)

    def hangs(self, now_ns: int) -> bool:
        """One look at its rows: whether none has come for too long.  The agent sees that there was a look."""
        self.pulse.beat()
        return self.vigil.is_stale(now_ns, self.reader.written)

    def kill(self, meanwhile: Callable[[], None]) -> None:
        """End it, whatever it does, and wait until it has ended; meanwhile is called again and again."""
        with contextlib.suppress(ProcessLookupError):
            signal.pidfd_send_signal(self.pidfd, signal.SIGKILL)
        while not _ended(self.pidfd, KILL_LOOK_MS):
            meanwhile()

    def last_rows(self) -> Rows:
        """Its last rows, at most `ROWS`, and none from before a damaged one."""
        return np.frombuffer(self.reader.read_last(ROWS).payload, AGENT_STATE.dtype)

    def inherit(self) -> None:
        """It is dead: what is written from now on goes behind its last row and its last text."""
        self.writer.catch_up()
        self.texts.catch_up()

    def close(self) -> None:
        """Let go of everything that is the agent's."""
        for one in (self.reader, self.writer, self.texts, self.pulse):
            one.close()
        os.close(self.pidfd)


def _ended(pidfd: int, timeout_ms: int) -> bool:
    poller = select.poll()
    poller.register(pidfd, select.POLLIN)
    return bool(poller.poll(timeout_ms))
