"""What somebody who watches a run is told: what is being done, and how far the first arm is by its ring."""

from __future__ import annotations

import time
from typing import Protocol

import numpy as np

from agent.telemetry.ring.reader import RingReader
from agent.telemetry.row.sample import AGENT_STATE


class Progress(Protocol):
    """Somebody who watches."""

    def phase(self, what: str, *, still: bool = False) -> None:
        """What is being done; still: by a process that is to have no other thread meanwhile."""
        ...

    def note(self, text: str) -> None:
        """Something that stays to be read."""
        ...

    def advance(self, t_s: float, duration_s: float, speed: float, error_mm: float | None) -> None:
        """How far the run is."""
        ...


class HowFar:
    """Tells of the newest row of the first arm; the pace counts from the first look that finds the motion begun."""

    def __init__(self, rows: RingReader, progress: Progress, duration_s: float) -> None:
        self._rows = rows
        self._progress = progress
        self._duration_s = duration_s
        self._first: tuple[float, float] | None = None  # its time in the row and on the monotonic clock

    def look(self) -> None:
        """Tell how far it is now."""
        block = self._rows.read_last(1)
        if not block.count:
            return
        row = AGENT_STATE.decode(block.payload)[0]
        t_s, now_s = float(row["t"]), time.monotonic()
        if self._first is None and t_s > 0.0:
            self._first = t_s, now_s
            return  # its pace is known at the next look
        began_t_s, began_s = self._first or (t_s, now_s)
        speed = (t_s - began_t_s) / max(now_s - began_s, 1e-3)
        self._progress.advance(t_s, self._duration_s, speed, float(np.linalg.norm(row["e_p"])) * 1e3)
