"""Linear motion over one unit of time with its inputs held: e^A and ∫ e^(sA) ds B of a stack of small matrices.

Scaling and squaring, with the Taylor polynomial of degree 19 of φ(A) = ∫ e^(sA) ds, from which e^A = 1 + A φ(A).
`scipy.linalg.expm` takes a stack one matrix after the other; a stability sweep has hundreds of them, with inputs, which
would make the matrices larger by a third.  A quotient of polynomials needs fewer products, but to solve for it takes as
long as dozens of them where matrices are this small.
Method: N. J. Higham, "Functions of Matrices: Theory and Computation", SIAM 2008, sections 4.2, 10.3 and 10.7.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from agent.control.models import Matrix

TERMS: Final = 5  # of each of so many polynomials in A, which stand before the powers of its fifth
_TAYLOR: Final = np.array([1.0 / math.factorial(k + 1) for k in range(4 * TERMS)]).reshape(4, TERMS)


def exponential(A: Matrix, B: Matrix) -> tuple[Matrix, Matrix]:
    """F = e^A (..., n, n) and G = ∫₀¹ e^(sA) ds B (..., n, r): y(1) = F y(0) + G u for ẏ = A y + B u.

    Each is halved in time, and doubled again, as often as its own 1-norm asks for.
    """
    norm = np.abs(A).sum(axis=-2).max(axis=-1, initial=1.0)  # up to 1 the polynomial lacks less than 1 / 20!
    doublings = np.ceil(np.log2(norm)).astype(int)
    parts = 2.0 ** doublings[..., None, None]
    A, B, one = A / parts, B / parts, np.eye(A.shape[-1])
    powers = np.empty((TERMS, *A.shape))
    powers[0], powers[1] = one, A
    for k in range(2, TERMS):
        np.matmul(powers[k - 1], A, out=powers[k])
    fifth = powers[-1] @ A
    integral: Matrix
    *lower, integral = np.tensordot(_TAYLOR, powers, axes=1)
    for part in reversed(lower):
        integral = fifth @ integral + part
    F, G = one + A @ integral, integral @ B
    for k in range(int(doublings.max(initial=0))):
        again = doublings > k
        half = F[again]
        G[again] += half @ G[again]
        F[again] = half @ half
    return F, G
