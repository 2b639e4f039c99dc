"""Matrix exponential of a stack of small matrices; scaling and squaring with the Taylor polynomial of degree 19.

`scipy.linalg.expm` takes a stack one matrix after the other; a stability sweep has hundreds of them.  A quotient of
polynomials needs fewer products, but to solve for it takes as long as dozens of them where matrices are this small.
Method: N. J. Higham, "Functions of Matrices: Theory and Computation", SIAM 2008, sections 4.2 and 10.3.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from agent.control.models import Matrix

TERMS: Final = 5  # of each of so many polynomials in A, which stand before the powers of its fifth
_TAYLOR: Final = np.array([1.0 / math.factorial(k) for k in range(4 * TERMS)]).reshape(4, TERMS)


def exponential(A: Matrix) -> Matrix:
    """e^A of every matrix (..., n, n), each squared as often as its own 1-norm asks for."""
    norm = np.abs(A).sum(axis=-2).max(axis=-1, initial=1.0)  # up to 1 the polynomial lacks less than 1 / 20!
    squarings = np.ceil(np.log2(norm)).astype(int)
    A = A / 2.0 ** squarings[..., None, None]
    powers = np.empty((TERMS, *A.shape))
    powers[0] = np.eye(A.shape[-1])
    for k in range(1, TERMS):
        np.matmul(powers[k - 1], A, out=powers[k])
    fifth = powers[-1] @ A
    result: Matrix
    *lower, result = np.tensordot(_TAYLOR, powers, axes=1)
    for part in reversed(lower):
        result = fifth @ result + part
    for k in range(int(squarings.max(initial=0))):
        again = squarings > k
        result[again] = result[again] @ result[again]
    return result
