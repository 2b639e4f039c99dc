"""An agent that is watched: its process, its ring, and what becomes of both when it is gone.

The ring's file is common to both processes, so this one maps none of it and keeps the newest rows for itself: where the
file is cut the agent dies of it (SIGBUS), and the hold begins as if the file were whole.
"""

from __future__ import annotations

import contextlib
import os
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from agent.guard.line import GuardError, Said
from agent.guard.pulse import Pulse
from agent.guard.resume import ROWS
from agent.guard.vigil import Vigil
from agent.host.process_handle import ProcessHandle
from agent.replay.tick import Rows
from agent.telemetry.ring.file import RingError
from agent.telemetry.ring.heir import RingHeir
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.ring.texts import TEXT_FORMAT, TextWriter
from agent.telemetry.row.sample import AGENT_STATE

DESCRIPTORS = 4  # of the process, its guard's pulse, the ring, its texts


@dataclass
class Watched:
    """One agent with its torque on.  Nothing is written to ring and texts before `inherit`."""

    process: ProcessHandle
    ring: Path
    reader: RingReader
    writer: RingHeir
    text_ring: RingHeir
    pulse: Pulse
    vigil: Vigil
    kept: deque[bytes] = field(default_factory=lambda: deque(maxlen=ROWS))  # the newest rows, without a gap
    kept_end: int = 0  # index behind the last of them
    handed_over: bool = False  # it has said that it ends, and that the object is held
    asked_by: str = ""  # by what it was asked to end, as it has said then
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
            process = ProcessHandle(pidfd)
            pulse = Pulse(pulse_fd)
            undo.callback(pulse.close)
            reader = undo.enter_context(RingReader(Path(f"/proc/self/fd/{ring}"), AGENT_STATE))
            writer = undo.enter_context(RingHeir(os.dup(ring), AGENT_STATE))
            text_ring = RingHeir(os.dup(texts), TEXT_FORMAT)
            undo.pop_all()
        return cls(process, Path(str(said.content.get("ring"))), reader, writer, text_ring, pulse, vigil)

    def __post_init__(self) -> None:
        self.texts = TextWriter.of(self.text_ring)

    @property
    def gone(self) -> bool:
        """Whether its process does nothing any more."""
        return self.process.gone

    def hangs(self, now_ns: int) -> bool:
        """One look at its rows: whether none has come for too long.  The agent sees that there was a look."""
        self.pulse.beat()
        self.text_ring.catch_up()
        written = self.writer.catch_up()
        if written > self.kept_end:
            self._keep(written)
        return self.vigil.is_stale(now_ns, written)

    @property
    def rows(self) -> int:
        """How many rows it has written."""
        return self.writer.written

    def last_rows(self) -> Rows:
        """Its last rows, at most `ROWS`, and none from before a damaged one."""
        payload = b"".join(self.kept)
        with contextlib.suppress(RingError):
            block = self.reader.read_last(ROWS)
            if block.count and block.first + block.count >= self.kept_end:
                payload = block.payload
        return np.frombuffer(payload, AGENT_STATE.dtype)

    @property
    def damage(self) -> str:
        """What has become of its files, for which it will have died; empty while they are whole."""
        found = {"its ring": self.writer.damage, "the ring of its texts": self.text_ring.damage}
        return ", ".join(f"{what} was {how}" for what, how in found.items() if how)

    def inherit(self, tell: Callable[[str], None]) -> None:
        """It is dead: what is written from now on goes behind its last row and its last text.

        Files that are none any more are mended; tell: is told, once, when rows cannot be written.
        """
        self.writer.failed = lambda why: tell(f"rows of this hold are lost: {why}")
        self._keep(self.writer.catch_up())
        self.text_ring.catch_up()
        if self.writer.damage:
            self.writer.written = self.kept_end
            self.writer.mend(self.kept)
        if self.text_ring.damage:
            self.text_ring.mend(())

    def close(self) -> None:
        """Let go of everything that is the agent's."""
        for one in (self.reader, self.writer, self.texts, self.pulse):
            one.close()
        self.process.close()

    def _keep(self, end: int) -> None:
        """The rows before `end` that are new, as far as they are whole; what is there stays where none is."""
        first = max(self.kept_end, end - ROWS)
        block = self.reader.read_at(first, end - first)
        if not block.count:
            return
        if block.first != self.kept_end:
            self.kept.clear()
        size = self.reader.header.row_bytes
        self.kept.extend(block.payload[i : i + size] for i in range(0, len(block.payload), size))
        self.kept_end = block.first + block.count
