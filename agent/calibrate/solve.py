"""Nonlinear least squares on the closed chain, with priors, robust weights and standard errors.

At every pose the arms i see the object at T_i.  What is fitted is the disagreement of each arm with the first,
z_i = (p_i − p_1, log R_i R_1ᵀ), whitened by its covariance from errors of the joints, C_1 + δ_ij C_i with
C_i = σ² J_i J_iᵀ + floor: the true pose of the object, which nobody measures, drops out without loss.  Parameters are
scaled by their prior, so that each has the prior N(0, 1), and a scale of zero keeps one where it is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from agent.calibrate.chain import Chain, Matrix, Seen
from drivers.dynamixel.servo.counts import TICK_RAD
from drivers.interface import Vector

JOINT_NOISE_RAD: Final = TICK_RAD / math.sqrt(12.0)  # of a reading on the encoder's grid
FLOOR_M: Final = 5e-5  # what pads and links give beside the joints
FLOOR_RAD: Final = 1e-4
SPREAD_MIN: Final = 0.2  # of the readings, relative to the noise above: several in a mean have less
FAR: Final = 5.0  # spreads beyond which a pose counts less than half (Cauchy)
STEPS_MAX: Final = 30
FIRST_STEPS: Final = 4  # with every pose at its full weight
SMALL_STEP: Final = 1e-6  # of a prior's standard deviation


@dataclass(frozen=True, eq=False)
class Solution:
    """Parameters of a chain, and how well they are known."""

    x: Vector  # (p,)
    sigma: Vector  # (p,) standard errors, those of the prior where the poses say nothing
    spread: float  # of what is left over, relative to the grid of the encoders
    seen: Vector  # (p,) singular values of the whitened and scaled Jacobian, large first: above 1 the poses tell more
    weights: Vector  # (k,) of the poses, below 1 where one does not fit the others
    steps: int

    @property
    def observed(self) -> int:
        """Combinations of parameters of which the poses tell more than the prior."""
        return int((self.seen > 1.0).sum())


def solve(chain: Chain, q: Sequence[Matrix], fixed: Vector | None = None) -> Solution:
    """Fit the chain to reported joint angles, (k, n) of each arm.

    fixed: (p,) parameters that are to stay at a value; NaN: those that are fitted.
    """
    scale, x = chain.scale.copy(), np.zeros(chain.size)
    if fixed is not None:
        held = np.isfinite(fixed)
        x[held], scale[held] = fixed[held], 0.0
    at, spread, weights = x.copy(), 1.0, np.ones(len(q[0]))
    for step in range(1, STEPS_MAX + 1):
        z, A = _equations(chain, x, q)
        if step > FIRST_STEPS:
            spread, weights = _weighed(z)
        root = np.sqrt(weights)[:, None] / spread
        columns = ((root[:, :, None] * A) * scale).reshape(-1, chain.size)
        H = columns.T @ columns + np.eye(chain.size)
        u = np.divide(x - at, scale, out=np.zeros_like(x), where=scale > 0.0)
        du = -np.linalg.solve(H, columns.T @ (root * z).ravel() + u)
        x = x + scale * du
        if step > FIRST_STEPS and float(np.abs(du).max()) < SMALL_STEP:
            break
    seen = np.linalg.svd(columns, compute_uv=False)
    sigma: Vector = scale * np.sqrt(np.diag(np.linalg.inv(H)))
    return Solution(x, sigma, spread, np.asarray(seen), weights, step)


def disagreement(chain: Chain, x: Vector, q: Sequence[Matrix]) -> tuple[Vector, Vector]:
    """How far each pose's arms see the object from the mean of all, rms over the arms: (k,) m and (k,) rad."""
    seen = chain.see(x, q)
    p, turns = np.array([s.p for s in seen]), np.array([_turn(s.R, seen[0].R) for s in seen])
    away_m, away_rad = ((v - v.mean(axis=0)) @ part.T for v, part in zip((p, turns), _parts(chain), strict=True))
    return _over_arms(away_m), _over_arms(away_rad)


def explained(chain: Chain, x: Vector, q: Sequence[Matrix]) -> tuple[float, float]:
    """Disagreement, rms over poses and arms (m, rad), of arms off by the chain's scale, read on the encoders' grid.

    Errors of different arms are independent, so what is left beside their mean is (N − 1) / N² of the sum of squares.
    """
    squares, arms = np.zeros(2), len(chain.links)
    for seen, scale in zip(chain.see(x, q), chain.parts(chain.scale), strict=True):
        errors = np.concatenate([seen.by_parameters * scale, seen.by_joints * JOINT_NOISE_RAD], axis=2)
        linear, angular = _parts(chain)
        squares += [np.sum((part @ of) ** 2) for part, of in ((linear, errors[:, :3]), (angular, errors[:, 3:]))]
    m, rad = np.sqrt((arms - 1) / arms**2 * squares / len(q[0]))
    return float(m), float(rad)


def _over_arms(away: Matrix) -> Vector:
    size: Vector = np.sqrt((away**2).sum(axis=2).mean(axis=0))
    return size


def rms(values: Vector) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def information(chain: Chain, x: Vector, q: Sequence[Matrix], spread: float) -> Matrix:
    """(p, p) what poses at reported angles q tell of the parameters, each scaled by its prior."""
    columns = (_equations(chain, x, q)[1] / spread * chain.scale).reshape(-1, chain.size)
    H: Matrix = columns.T @ columns
    return H


def _parts(chain: Chain) -> tuple[Matrix, Matrix]:
    return chain.basis[:, :3], chain.basis[:, 3:]


def _equations(chain: Chain, x: Vector, q: Sequence[Matrix]) -> tuple[Matrix, Matrix]:
    """Whitened disagreement (k, r) of all arms with the first, and its Jacobian (k, r, p)."""
    seen, P = chain.see(x, q), chain.basis
    m, others, count = len(P), len(seen) - 1, len(q[0])
    z, A = np.zeros((count, others * m)), np.zeros((count, others * m, chain.size))
    C = np.zeros((count, others * m, others * m))
    ends = np.cumsum([0, *(link.size for link in chain.links)])
    first, own = _covariance(P, seen[0]), slice(0, ends[1])
    for i, s in enumerate(seen[1:]):
        rows = slice(i * m, (i + 1) * m)
        away = np.concatenate([s.p - seen[0].p, _turn(s.R, seen[0].R)], axis=1)
        z[:, rows] = away @ P.T
        A[:, rows, ends[i + 1] : ends[i + 2]] = P @ s.by_parameters
        A[:, rows, own] = -P @ seen[0].by_parameters
        C[:, rows] += np.tile(first, others)
        C[:, rows, rows] += _covariance(P, s)
    L = np.linalg.cholesky(C)
    return np.linalg.solve(L, z[:, :, None])[:, :, 0], np.linalg.solve(L, A)


def _covariance(P: Matrix, seen: Seen) -> Matrix:
    J = P @ seen.by_joints
    floor = P @ np.diag([FLOOR_M**2] * 3 + [FLOOR_RAD**2] * 3) @ P.T
    C: Matrix = JOINT_NOISE_RAD**2 * J @ J.transpose(0, 2, 1) + floor
    return C


def _turn(R: Matrix, of: Matrix) -> Matrix:
    """Rotation vectors (k, 3), world axes, from attitudes `of` to R, both (k, 3, 3) and near each other."""
    D = R @ of.transpose(0, 2, 1)
    sines: Matrix = np.stack(
        [D[:, 2, 1] - D[:, 1, 2], D[:, 0, 2] - D[:, 2, 0], D[:, 1, 0] - D[:, 0, 1]], axis=1
    )  # twice those of the angle, which is small
    return 0.5 * sines


def _weighed(z: Matrix) -> tuple[float, Vector]:
    """Spread of most poses, and the weight of each."""
    size = np.sqrt((z**2).mean(axis=1))
    spread = max(float(np.median(size)), SPREAD_MIN)
    return spread, 1.0 / (1.0 + (size / (FAR * spread)) ** 2)
