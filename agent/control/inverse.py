"""Inverse of the task-space Jacobian; square arms by LU, redundant arms by the dynamically consistent inverse."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from agent.control import lapack
from agent.control.models import Matrix

_IDENTITY = tuple(np.eye(n, order="F") for n in range(7))  # by the rows of a task space, at most six

SINGULAR: Final = 1e-15  # of the largest singular value: what is no more than rounding


class SingularJacobian(ArithmeticError):
    """The object Jacobian cannot be inverted at this configuration."""


def invert_jacobian(J: Matrix, B: Matrix) -> tuple[Matrix, float]:
    """J̄ (n, m) with J J̄ = I, and a lower bound 1/‖J̄‖_F of the smallest singular value of J (m, n).

    Square J: J⁻¹.  More joints than task rows: B⁻¹Jᵀ(J B⁻¹ Jᵀ)⁻¹, which keeps null-space torques from
    accelerating the object.  LAPACK is called directly: numpy's wrapper costs four times the inversion.
    Raises SingularJacobian when no inverse exists.
    """
    m, n = J.shape
    if m == n:
        inverse = _invert(J)
    else:
        B_inv_Jt = lapack.dposv(B, J.T)[1]
        inverse = B_inv_Jt.dot(_invert(J.dot(B_inv_Jt)))
    flat = inverse.ravel(order="K")
    return inverse, 1.0 / math.sqrt(flat.dot(flat))


def _invert(A: Matrix) -> Matrix:
    inverse: Matrix
    _, _, inverse, info = lapack.dgesv(A, _IDENTITY[len(A)])
    if info != 0 or not math.isfinite(inverse[0, 0]):
        raise SingularJacobian
    return inverse


def pseudo_inverse(J: Matrix) -> Matrix:
    """Pseudo-inverse (n, m) of a Jacobian (m, n), m ≤ n: numpy's to the bit, for half of what its wrappers cost."""
    U, sigma, Vt = np.linalg.svd(J, full_matrices=False)
    if not sigma[-1] > SINGULAR * sigma[0]:
        return np.asarray(np.linalg.pinv(J, rcond=SINGULAR))
    found: Matrix = Vt.T @ ((1.0 / sigma)[:, None] * U.T)
    return found
