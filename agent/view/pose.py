"""Poses as rows of seven numbers: position, then unit quaternion, scalar first; all functions work row by row."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agent.log.quaternions import product

Array = NDArray[np.float64]

_STILL: Final = 1e-12  # half angles below it have no axis


def poses(p: ArrayLike, quat: ArrayLike) -> Array:
    """Rows (k, 7) of positions (k, 3) and quaternions (k, 4), or of one (3,) and (4,)."""
    return np.hstack([np.atleast_2d(np.asarray(p, float)), np.atleast_2d(np.asarray(quat, float))])


def matrices(quat: Array) -> Array:
    """Rotation matrices (k, 3, 3) of unit quaternions (k, 4)."""
    w, x, y, z = quat.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def sizes(vectors: Array) -> Array:
    """Lengths (k,) of vectors (k, n); NaN where one is no number, infinite where it is beyond all."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.linalg.norm(vectors, axis=1))


def moved(pose: Array, points: ArrayLike) -> Array:
    """Points (n, 3) of a body in the world, (n, 3), for its pose (7,)."""
    return np.asarray(np.asarray(points, float) @ matrices(pose[None, 3:])[0].T + pose[:3])


def exaggerated(pose: Array, against: Array, factor: float) -> Array:
    """Poses (k, 7) whose distance and turn from `against` (k, 7) are `factor` times as large, at most half a turn."""
    if factor == 1.0:
        return pose
    p = against[:, :3] + factor * (pose[:, :3] - against[:, :3])
    turn = product(pose[:, 3:], against[:, 3:] * [1.0, -1.0, -1.0, -1.0])
    turn = np.where(turn[:, :1] < 0.0, -turn, turn)
    sine = np.linalg.norm(turn[:, 1:], axis=1, keepdims=True)
    half = np.minimum(factor * np.arctan2(sine, turn[:, :1]), 0.5 * np.pi)
    axis = np.divide(turn[:, 1:], sine, out=np.zeros_like(turn[:, 1:]), where=sine > _STILL)
    return np.hstack([p, product(np.hstack([np.cos(half), np.sin(half) * axis]), against[:, 3:])])
