"""The motion that all arms follow, from the rows of one: what it follows less its own shift (agent.control.alignment).

The shift is how the arm sees the object beside where the cell has it, of which the true pose knows nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def unshifted(p: NDArray[Any], quat: NDArray[Any], shift: NDArray[Any]) -> tuple[Array, Array]:
    """Desired pose (k, 3) and (k, 4), scalar first, without a shift (k, 6): place and rotation vector, world axes."""
    rho = shift[:, 3:]
    angle = np.linalg.norm(rho, axis=1, keepdims=True)
    w, u = np.cos(0.5 * angle), -0.5 * np.sinc(angle / (2.0 * np.pi)) * rho  # the rotation back
    eta, eps = quat[:, :1], quat[:, 1:]
    back = np.hstack([w * eta - np.sum(u * eps, axis=1, keepdims=True), w * eps + eta * u + np.cross(u, eps)])
    return np.asarray(p - shift[:, :3]), back
