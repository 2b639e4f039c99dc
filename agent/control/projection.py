"""Keeps parameter estimates inside their bounds and physically possible; pure.

Two convex sets.  The box is the exact projection in the norm of the Lyapunov function (any diagonal gain), so it
never raises V.  The cone keeps every body's second moment Σ = ½ tr(I) E − I positive semidefinite, which says
that the principal moments are not negative and that none exceeds the sum of the others; it is the nearest point
in the norm of Σ, not in that of the gain.  The first moment is left out of the cone on purpose: from an empty
estimate it would buy every newton of weight with invented inertia, and invented inertia makes the loop unstable.
"""

from __future__ import annotations

import numpy as np

from agent.control import lapack
from agent.control.models import Matrix
from drivers.interface import Vector

CONE_TOLERANCE = 1e-12  # kg·m², below any body's second moment

# Σ row by row from (Ixx, Ixy, Iyy, Ixz, Iyz, Izz), and back
_SIGMA_OF_INERTIA = np.zeros((6, 9))
_SIGMA_OF_INERTIA[[0, 2, 5], 0] = -0.5, 0.5, 0.5
_SIGMA_OF_INERTIA[[0, 2, 5], 4] = 0.5, -0.5, 0.5
_SIGMA_OF_INERTIA[[0, 2, 5], 8] = 0.5, 0.5, -0.5
_SIGMA_OF_INERTIA[1, [1, 3]] = _SIGMA_OF_INERTIA[3, [2, 6]] = _SIGMA_OF_INERTIA[4, [5, 7]] = -1.0
_INERTIA_OF_SIGMA = np.zeros((9, 6))
_INERTIA_OF_SIGMA[[4, 8], 0] = _INERTIA_OF_SIGMA[[0, 8], 2] = _INERTIA_OF_SIGMA[[0, 4], 5] = 1.0
_INERTIA_OF_SIGMA[1, 1] = _INERTIA_OF_SIGMA[2, 3] = _INERTIA_OF_SIGMA[5, 4] = -1.0
# Σ of all bodies is one matrix of 3×3 blocks on the diagonal; in LAPACK's band storage each block takes nine numbers
_LOWER_BAND = [0, 3, 6, 4, 7, 8]  # of Σ row by row: first column, second column from its diagonal on, third
_BAND_OF_INERTIA = np.zeros((6, 9))
_BAND_OF_INERTIA[:, [0, 1, 2, 3, 4, 6]] = _SIGMA_OF_INERTIA[:, _LOWER_BAND]
_BAND_OF_TOLERANCE = CONE_TOLERANCE * np.array([1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0])


def to_box(theta: Vector, lower: Vector, upper: Vector) -> Vector:
    """Nearest point (k,) with lower ≤ theta ≤ upper, a new array."""
    inside: Vector = np.minimum(np.maximum(theta, lower), upper)
    return inside


def second_moments(bodies: Matrix) -> Matrix:
    """Σ (b, 3, 3) of bodies (b, 10) about their frames' origins, kg·m²."""
    sigma: Matrix = bodies[:, 4:].dot(_SIGMA_OF_INERTIA).reshape(-1, 3, 3)
    return sigma


def to_physical(bodies: Matrix) -> Matrix:
    """Bodies (b, 10) with every Σ positive semidefinite; the same array when nothing had to change."""
    if _are_physical(bodies):
        return bodies
    moments, axes = np.linalg.eigh(second_moments(bodies))
    bad = np.flatnonzero(moments[:, 0] < -CONE_TOLERANCE)
    moments, axes = moments[bad], axes[bad]
    nearest = (axes * np.maximum(moments, 0.0)[:, None, :]) @ axes.transpose(0, 2, 1)
    physical = bodies.copy()
    physical[bad, 4:] = nearest.reshape(-1, 9).dot(_INERTIA_OF_SIGMA)
    return physical


def _are_physical(bodies: Matrix) -> bool:
    """Whether Σ + tolerance has a Cholesky factor for every body; one LAPACK call, a third of the eigenvalues' time."""
    band = bodies[:, 4:].dot(_BAND_OF_INERTIA)
    band += _BAND_OF_TOLERANCE
    return bool(lapack.dpbtrf(band.reshape(-1, 3).T, 1)[1] == 0)
