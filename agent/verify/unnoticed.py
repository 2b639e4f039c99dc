"""How far off their motion arms come where nobody notices that one of them stays: by the errors that hold an arm.

Without `[safety.noticing]` the others follow the motion until the object is `safety.tracking_error_max_m` or `_rad` off
it, or as far as the motion goes.  What ends it sooner, a torque at its bound, is not looked at here.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agent.config.cell import Cell
from agent.control.models import Matrix
from agent.verify.ahead import ahead

AHEAD = 40  # steps of one period, or of what is left of the run


def to_the_end(cell: Cell, instants: Sequence[float]) -> Matrix:
    """(T, AHEAD + 1, 6) by how much the motion goes on from these instants, s: m, and rotation vectors."""
    begin, period_s = np.array(instants), cell.trajectory().period_s
    end = np.maximum(begin, np.minimum(begin + period_s, cell.file.duration_s))
    return ahead(cell, np.linspace(begin, end, AHEAD + 1, axis=1))


def until_off_track(errors: Matrix, max_m: float, max_rad: float) -> Matrix:
    """(T, 6) of errors (T, A, 6) in the order of time: the first beyond these limits, put at them, else the largest."""
    size = np.maximum(
        np.linalg.norm(errors[..., :3], axis=-1) / max_m, np.linalg.norm(errors[..., 3:], axis=-1) / max_rad
    )
    beyond = size >= 1.0
    chosen = np.where(beyond.any(axis=1), beyond.argmax(axis=1), size.argmax(axis=1))
    every = np.arange(len(errors))
    found: Matrix = errors[every, chosen] / np.maximum(size[every, chosen], 1.0)[:, None]
    return found
