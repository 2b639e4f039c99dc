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


def show(rows: RingReader, progress: Progress, *, began_s: float, duration_s: float) -> None:
    """Tell of the newest row; began_s: monotonic time at which the run began."""
    block = rows.read_last(1)
    if not block.count:
        return
    row = AGENT_STATE.decode(block.payload)[0]
    t = float(row["t"])
    elapsed = max(time.monotonic() - began_s, 1e-3)
    progress.advance(t, duration_s, t / elapsed, float(np.linalg.norm(row["e_p"])) * 1e3)
