"""What a row says of its tick; for whoever computes ticks again, from a log or from a ring."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.safety import Flag
from drivers.interface import JointState

Rows = NDArray[np.void]


def state_at(rows: Rows, i: int, n: int) -> JointState:
    """The measured joints of a row, in arrays of their own."""
    row = rows[i]
    return JointState(
        int(row["stamp_ns"]),
        row["q_measured"][:n].copy(),
        row["dq_measured"][:n].copy(),
        row["tau_measured"][:n].copy(),
    )


def is_fresh(flags: int) -> bool:
    """Whether the row's cycle had a fresh state."""
    return not flags & Flag.STALE
