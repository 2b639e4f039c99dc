"""Which matrices of a stack have a spectral radius below a bound, shown by their powers: quicker than by eigenvalues.

With any norm ρ(A) ≤ ‖Aᵏ‖^(1/k), so that ρ(A) < b where ‖(A/b)ᵏ‖ < 1 for some k; squaring gives k = 1, 2, 4, …

Rounding is counted: a product of two powers of norm M or less is off by n ε M² (N. J. Higham, "Accuracy and Stability
of Numerical Algorithms", 2nd ed., SIAM 2002, section 3.5), which stands between two other powers in (A/b)ᵏ, at k places
in all.  M is taken as the largest norm among the powers that are computed.
"""

from __future__ import annotations

from itertools import count
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.control.models import Matrix
from drivers.interface import Vector

SQUARINGS: Final = 10  # with which radii that are apart by half a per cent are told apart
BALANCING: Final = 4  # rounds
ENOUGH: Final = 4  # matrices of a stack to balance all
APART: Final = 1e-6  # of the bound, by which a radius must be below it; eigenvalues are not exact either
_ROUNDING: Final = float(np.finfo(np.float64).eps)


def below(A: Matrix, bound: float) -> NDArray[np.bool_]:
    """(K,) whether the spectral radius of a matrix (K, s, s) is seen to be below the bound; False says nothing."""
    seen = np.zeros(len(A), dtype=np.bool_)
    if not (bound > 0.0 and len(A)):
        return seen
    scale = _balance(A)
    power, open_ = A * (scale / scale[:, None] / (bound * (1.0 - APART))), np.arange(len(A))
    size = _norm(power)
    largest = np.maximum(size, 1.0)
    for k in count():
        off = 2.0**k * len(scale) * _ROUNDING * largest**4
        small = size + off < 1.0
        seen[open_[small]] = True
        on = ~small & (off < 1.0)
        if k == SQUARINGS or not on.any():
            break
        if not on.all():
            power, open_, largest = power[on], open_[on], largest[on]
        power = power @ power
        size = _norm(power)
        largest = np.maximum(largest, size)
    return seen


def _balance(A: Matrix) -> Vector:
    """A diagonal D (s,) of powers of two for all matrices, with which D⁻¹ A D has a small norm and the same radius.

    What stands on the diagonal keeps rounds, in which all states are scaled at once, from going too far.
    """
    sizes: Matrix = np.abs(A[:: 1 + len(A) // ENOUGH]).max(axis=0)
    scale: Vector = np.ones(len(sizes))
    for _ in range(BALANCING):
        rows, columns = sizes.sum(axis=1), sizes.sum(axis=0)
        coupled = (rows > 0.0) & (columns > 0.0)
        ratio = np.divide(rows, columns, out=np.ones_like(rows), where=coupled)
        step = np.exp2(np.round(0.5 * np.log2(ratio)))
        sizes *= step / step[:, None]
        scale *= step
    return scale


def _norm(A: Matrix) -> Vector:
    """Frobenius norm (K,) of matrices (K, s, s)."""
    flat = A.reshape(len(A), -1)
    found: Vector = np.sqrt(np.einsum("ki,ki->k", flat, flat))
    return found
