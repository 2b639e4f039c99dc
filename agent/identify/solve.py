"""Weighted least squares of the equations of a recording, with standard errors from whole blocks of time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.identify.recording import IdentifyError
from drivers.interface import Vector

Matrix = NDArray[np.float64]

BLOCK_ROWS: Final = 2048  # taken into the least squares at a time
BLOCK_S: Final = 1.0
CONDITION_MAX: Final = 500.0


@dataclass(frozen=True)
class Part:
    """Equations of a stretch of time: columns @ parameters = tau where used."""

    t: Vector  # (k,) s
    columns: Matrix  # (k, n, b)
    tau: Matrix  # (k, n) N·m, the object's share taken out
    used: NDArray[np.bool_]  # (k, n)


def least_squares(part: Part, condition_max: float = CONDITION_MAX) -> tuple[Vector, Vector, float]:
    """Parameters (b,), their standard errors (b,), and the condition number of the scaled columns.

    Joints are weighted by how well they fit.  Raises IdentifyError when the motion leaves a parameter undetermined.
    """
    count, n, b = part.columns.shape
    weight = np.ones(n)
    for _ in range(3):
        triangle = _triangle(part, weight)
        scale = np.maximum(np.linalg.norm(triangle[:, :b], axis=0), 1e-300)
        condition = float(np.linalg.cond(triangle[:, :b] / scale))
        _refuse_condition(condition, condition_max)
        value = np.linalg.lstsq(triangle[:, :b] / scale, triangle[:, b], rcond=None)[0] / scale
        residual = (part.tau - part.columns @ value) * part.used
        used_weight, weight = weight, np.sqrt(part.used.sum(axis=0) / np.maximum((residual**2).sum(axis=0), 1e-300))
    scores = np.empty((count, b))
    for some in _blocks(count):
        scores[some] = np.einsum("kjb,kj->kb", part.columns[some], residual[some] * used_weight * weight)
    root = np.linalg.inv(triangle[:b, :b] / scale) / scale[:, None]
    inverse = root @ root.T
    return value, np.sqrt(np.diag(inverse @ _covariance(scores, part.t) @ inverse)), condition


def _triangle(part: Part, weight: Vector) -> Matrix:
    """R (b + 1, b + 1) of the equations [columns, tau], weighted by joint (n,): all that least squares needs."""
    found: Matrix = np.empty((0, part.columns.shape[2] + 1))
    for some in _blocks(len(part.t)):
        rows = np.concatenate([part.columns[some], part.tau[some, :, None]], axis=2)
        rows *= (part.used[some] * weight)[:, :, None]
        found = np.asarray(np.linalg.qr(np.concatenate([found, rows.reshape(-1, rows.shape[2])]), mode="r"))
    return found


def _blocks(count: int) -> list[slice]:
    return [slice(at, at + BLOCK_ROWS) for at in range(0, count, BLOCK_ROWS)]


def _covariance(scores: Matrix, t: Vector) -> Matrix:
    """Of the sum of all scores (k, b), from the sums over blocks of time, which are all but independent."""
    block = np.floor((t - t[0]) / BLOCK_S).astype(int)
    sums: Matrix = np.stack([np.bincount(block, column) for column in scores.T], axis=1)
    count = len(sums)
    covariance: Matrix = sums.T @ sums * (count / (count - 1))
    return covariance


def _refuse_condition(condition: float, condition_max: float) -> None:
    if not condition <= condition_max:
        raise IdentifyError(
            "excitation",
            found=f"columns with a condition number of {condition:.3g}",
            expected=f"at most {condition_max:g}",
            remedy='record a trajectory with more frequencies on more axes (kind = "fourier")',
        )
