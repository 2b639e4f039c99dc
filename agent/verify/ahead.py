"""By how much the motion of a cell goes on from one instant to others."""

from __future__ import annotations

import numpy as np

from agent.config.cell import Cell
from agent.control.models import Matrix


def ahead(cell: Cell, times: Matrix) -> Matrix:
    """(T, A, 6) m and rotation vectors from the first of every row of times (T, A), s; each instant is asked once."""
    needed, of = np.unique(times, return_inverse=True)
    desired = [cell.trajectory().at(t) for t in needed.tolist()]
    p, quat = (np.array([d[part] for d in desired])[np.reshape(of, times.shape)] for part in (0, 1))
    return np.concatenate([p - p[:, :1], turned(quat)], axis=-1)


def turned(quat: Matrix) -> Matrix:
    """Rotation vectors (T, A, 3) from the first attitude of every row (T, A, 4) on."""
    w, v = quat[..., :1], quat[..., 1:]
    w_0, v_0 = w[:, :1], v[:, :1]
    along, cosine = w_0 * v - w * v_0 - np.cross(v, v_0), w * w_0 + np.sum(v * v_0, axis=-1, keepdims=True)
    sine = np.linalg.norm(along, axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, np.abs(cosine)) * np.sign(cosine)
    found: Matrix = np.divide(angle, sine, out=np.zeros_like(sine), where=sine > 0.0) * along
    return found
