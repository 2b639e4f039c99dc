"""The motion that all arms follow, from the rows of one: what it follows less its own shift (agent.control.alignment).

The shift is how the arm sees the object beside where the cell has it, of which the true pose knows nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.log.quaternions import Array, product


def unshifted(p: NDArray[Any], quat: NDArray[Any], shift: NDArray[Any]) -> tuple[Array, Array]:
    """Desired pose (k, 3) and (k, 4), scalar first, without a shift (k, 6): place and rotation vector, world axes."""
    rho = shift[:, 3:]
    angle = np.linalg.norm(rho, axis=1, keepdims=True)
    back = np.hstack([np.cos(0.5 * angle), -0.5 * np.sinc(angle / (2.0 * np.pi)) * rho])
    return np.asarray(p - shift[:, :3]), product(back, quat)
