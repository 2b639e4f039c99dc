"""How far the motion goes on until the others feel that an arm stays: by the two channels of their residual.

What pulls at the arm that stays is what each of the others feels: what its law gives for a pose that has gone ahead of
the object and for the velocity that the object lacks.  It goes through the channels of agent.control.residual, of which
the fast one is without the wrench's own part of the last seconds and the slow one low-passed; the first arm with one
above its limit has noticed.  The blow at the begin, friction and the other senses are left out: they mostly notice
sooner.  An arm that aligns itself to the one that stays does so later, with no more of a pull.  What the estimates of
an adaptive arm come to give beside it (`summed`) is not felt: the residual takes it for what is known.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.config.cell import Cell
from agent.control.models import Matrix
from agent.control.residual import Residual
from agent.verify.ahead import ahead
from drivers.interface import Vector

STEP_S: Final = 0.05
STEPS: Final = 80  # as far as one looks for it


class Feeling:
    """How far the motion of a cell goes on from some instants, s, and when arms with such a residual feel it."""

    def __init__(self, cell: Cell, residual: Residual, instants: Sequence[float]) -> None:
        own, base, slow = (_low_pass(rate) for rate in (residual.rate_per_s, residual.base_per_s, residual.slow_per_s))
        self._channels = np.stack([own - base @ own, slow @ own])[:, None, None]
        self._most = np.reshape(residual.limits, (2, 1, 1, 1, 2))
        last = math.floor(cell.file.duration_s / STEP_S)
        begin = np.minimum(np.round(np.array(instants) / STEP_S), last)
        steps = np.minimum(begin[:, None] + np.arange(STEPS + 1), last)  # of one grid, so that places share instants
        self.ways = ahead(cell, STEP_S * steps)  # (T, STEPS + 1, 6) m and rotation vectors

    def until_felt(self, pulls: Sequence[Matrix], least_s: float) -> tuple[NDArray[np.intp], Vector]:
        """(T,) at which step it is felt, but no sooner than so long after, and after which time, s.

        pulls: of every other arm the wrench (T, STEPS + 1, 6) on these ways.  Where it is not felt meanwhile it is the
        step at which they pull hardest, and infinite.
        """
        w = np.stack(pulls)
        over: NDArray[np.bool_] = np.any(_sizes(self._channels @ w) > self._most, axis=(0, 1, 4))
        felt, hardest = over.any(axis=1), np.linalg.norm(w[..., :3], axis=-1).max(axis=0).argmax(axis=1)
        at = np.where(felt, np.maximum(over.argmax(axis=1), round(least_s / STEP_S)), hardest)
        return at, np.where(felt, at * STEP_S, math.inf)


def _low_pass(rate_per_s: float) -> Matrix:
    """What is low-passed (STEPS + 1,) of anything that begins after nothing, as a matrix."""
    k = np.arange(STEPS + 1)
    part, late = -math.expm1(-rate_per_s * STEP_S), k[:, None] - k
    found: Matrix = np.where(late >= 0, part * (1.0 - part) ** np.maximum(late, 0), 0.0)
    return found


def summed(rates: Matrix, leak_per_s: float) -> Matrix:
    """What comes of rates (T, STEPS + 1, m) per second that are forgotten at that rate, step by step."""
    late = np.subtract.outer(np.arange(STEPS + 1), np.arange(STEPS + 1)) - 1  # of what comes in the step before
    kept = np.where(late >= 0, STEP_S * np.exp(-leak_per_s * STEP_S * np.maximum(late, 0)), 0.0)
    found: Matrix = kept @ rates
    return found


def _sizes(wrenches: Matrix) -> Matrix:
    """(…, 2) N, N·m of wrenches (…, 6)."""
    found: Matrix = np.linalg.norm(np.reshape(wrenches, (*wrenches.shape[:-1], 2, 3)), axis=-1)
    return found
