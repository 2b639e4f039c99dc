"""How much a finger pad damps; the one home of it, for the simulated plant and for what counts with such pads."""

from __future__ import annotations

from typing import Final

import numpy as np

from drivers.interface import Vector

DAMPING_RATIO: Final = 0.25  # of an arm that swings on its pad, where nothing else is said
_PARTS = slice(0, 3), slice(3, 6)  # force and moment


def swinging_inertia(mobility: Vector) -> Vector:
    """(6,) kg, kg·m² with which an arm swings on its pad: inverse mean mobility of its end effector.

    mobility: J M⁻¹ Jᵀ (6, 6) of the end effector at its origin, linear first, in axes of any direction.  Zero where it
    has none.
    """
    out = np.zeros(6)
    for part in _PARTS:
        block = mobility[part, part]
        rank = int(np.linalg.matrix_rank(block, 1e-9))
        if rank > 0:
            out[part] = rank / float(np.trace(block))
    return out


def damping(stiffness: Vector, swinging: Vector, ratio: float) -> Vector:
    """N·s/m, N·m·s/rad of pads of this stiffness (…, 6) that let the arm swing with this damping ratio."""
    found: Vector = 2.0 * ratio * np.sqrt(stiffness * swinging)
    return found
