"""Parameters of an arm, the speed over which its breakaway falls off and the loop's delay, found together.

The torque is linear in its parameters alone.  A speed v_s and a delay δ are found by their derivatives as two more
columns, ∂τ/∂ln v_s and dτ/dt, as τ(t − δ) = τ − δ dτ/dt, until nothing is left for them to explain (Gauss-Newton).
The standard errors of all of them are then of one least squares, and hold what they take from each other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.identify.equations import Motion
from agent.identify.friction import FOLDS, LOAD, Shape, Term, with_friction
from agent.identify.solve import Part, least_squares
from drivers.interface import Vector

Matrix = NDArray[np.float64]

CONDITION_MAX: Final = 1e8  # beyond it is rounding; what the motion does not tell apart has large standard errors
ROUNDS: Final = 25
LOG_STEP: Final = 0.3  # largest of a round, of ln v_s
LOG_NEAR: Final = 0.01  # to both sides, for the derivative
LOG_CLOSE: Final = 1e-3
CLOSE_S: Final = 1e-5
SPEEDS: Final = (0.03, 5.0)  # of v_s, rad/s
LONGEST_PERIODS: Final = 20.0  # of a delay


@dataclass(frozen=True)
class Found:
    """Parameters, v_s and delay that explain a stretch of motion."""

    value: Vector  # (b,) parameters: the base's, and those of the terms behind them
    sigma: Vector  # (b,) standard errors
    shape: Shape | None  # how breakaway falls off
    speed_sigma: float  # standard error of v_s, rad/s; 0 without breakaway
    delay_s: float
    delay_sigma_s: float  # 0 where the delay was given
    squares: Matrix  # (FOLDS, n) mean squared residual of each joint in blocks of time

    @property
    def speed(self) -> float:
        """v_s, rad/s; 0 without breakaway."""
        return 0.0 if self.shape is None else self.shape.stribeck_rad_per_s


def together(
    part: Part, motion: Motion, terms: Sequence[Term], shape: Shape | None, delay_s: float | None = None, *,
    hold: bool = False,
) -> Found:  # fmt: skip
    """What explains the part; from this shape on, with this delay or, where there is none given, with the best one.

    hold: keep the shape as it is.
    Raises IdentifyError when the motion leaves something undetermined.
    """
    count, b = len(part.t), part.columns.shape[2] + len(terms)
    delay = motion.recording.delay_s if delay_s is None else delay_s
    longest_s, speed_sigma = LONGEST_PERIODS * motion.recording.period_s, 0.0
    if all(key == LOAD for key, _ in terms):
        shape = None
    for _ in range(ROUNDS):
        late = replace(part, tau=part.tau + motion.later(delay)[:count])
        rate = motion.rate(delay)[:count, :, None] if delay_s is None else np.empty((*part.tau.shape, 0))
        joined, slope = joined_with(late, motion, terms, shape, slice(count)), np.empty((*part.tau.shape, 0))
        if shape is not None and not hold:
            value = least_squares(_more(joined, rate), CONDITION_MAX)[0]
            slope = _slope(part, motion, terms, shape, value[:b])
        value, sigma, _ = least_squares(_more(joined, slope, rate), CONDITION_MAX)
        faster = later = 0.0
        if shape is not None and not hold:
            faster, speed_sigma = float(value[b]), float(sigma[b]) * shape.stribeck_rad_per_s
            step = math.exp(max(-LOG_STEP, min(faster, LOG_STEP)))
            shape = shape._replace(stribeck_rad_per_s=float(np.clip(shape.stribeck_rad_per_s * step, *SPEEDS)))
        if delay_s is None:
            later = float(value[-1])
            delay = float(np.clip(delay + later, 0.0, longest_s))
        if abs(faster) < LOG_CLOSE and abs(later) < CLOSE_S:
            break
    rest = (joined.tau - _more(joined, slope, rate).columns @ value) * part.used
    return Found(
        value[:b],
        sigma[:b],
        shape,
        speed_sigma,
        delay,
        float(sigma[-1]) if delay_s is None else 0.0,
        _squares(rest, part.used),
    )


def joined_with(part: Part, motion: Motion, terms: Sequence[Term], shape: Shape | None, samples: slice) -> Part:
    """The part, these samples of the motion, with the columns of the terms behind its own."""
    if not terms:
        return part
    friction = motion.friction(() if shape is None else (shape,)).some(samples)
    return replace(part, columns=with_friction(part.columns, friction, shape, terms))


def _slope(part: Part, motion: Motion, terms: Sequence[Term], shape: Shape, value: Vector) -> Matrix:
    """(k, n, 1) ∂τ/∂ln v_s with these parameters."""
    near = [shape._replace(stribeck_rad_per_s=shape.stribeck_rad_per_s * math.exp(by)) for by in (LOG_NEAR, -LOG_NEAR)]
    friction, none = motion.friction(near).some(slice(len(part.t))), part.columns[:, :, :0]
    faster, slower = (with_friction(none, friction, one, terms) for one in near)
    slope: Matrix = (faster - slower) @ value[len(value) - len(terms) :, None] / (2.0 * LOG_NEAR)
    return slope


def _more(part: Part, *columns: Matrix) -> Part:
    return replace(part, columns=np.concatenate([part.columns, *columns], axis=2))


def _squares(rest: Matrix, used: NDArray[np.bool_]) -> Matrix:
    blocks = zip(np.array_split(rest**2, FOLDS), np.array_split(used, FOLDS), strict=True)
    return np.array([block.sum(axis=0) / np.maximum(own.sum(axis=0), 1) for block, own in blocks])
