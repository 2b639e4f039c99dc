"""Matrix exponential of a stack of small matrices; scaling and squaring with the Padé approximant of degree 13.

`scipy.linalg.expm` takes a stack one matrix after the other; a stability sweep has hundreds of them.
Method: N. J. Higham, "The scaling and squaring method for the matrix exponential revisited", SIAM J. Matrix Anal.
Appl. 26 (2005), section 2.
"""

from __future__ import annotations

import math

import numpy as np

from agent.control.models import Matrix

_PADE = [float(math.factorial(26 - k) // (math.factorial(k) * math.factorial(13 - k))) for k in range(14)]
_NORM_MAX = 5.371920351148152  # up to this 1-norm the approximant is exact to rounding


def exponential(A: Matrix) -> Matrix:
    """e^A of every matrix (..., n, n), each squared as often as its own 1-norm asks for."""
    norm = np.abs(A).sum(axis=-2).max(axis=-1)
    squarings = np.ceil(np.log2(np.maximum(norm / _NORM_MAX, 1.0))).astype(int)
    b, one = _PADE, np.eye(A.shape[-1])
    A = A / 2.0 ** squarings[..., None, None]
    A2 = A @ A
    A4 = A2 @ A2
    A6 = A4 @ A2
    odd = A @ (A6 @ (b[13] * A6 + b[11] * A4 + b[9] * A2) + b[7] * A6 + b[5] * A4 + b[3] * A2 + b[1] * one)
    even = A6 @ (b[12] * A6 + b[10] * A4 + b[8] * A2) + b[6] * A6 + b[4] * A4 + b[2] * A2 + b[0] * one
    result: Matrix = np.asarray(np.linalg.solve(even - odd, even + odd), dtype=np.float64)
    for k in range(int(squarings.max(initial=0))):
        again = squarings > k
        result[again] = result[again] @ result[again]
    return result
