"""End stops of an arm's joints: a spring and a damper from a little before each joint limit on.

    τ = −K z⁺ − C ż,   K = I ω²,   C = 2 I ω

with z the way into the stop and I the joint's inertia at the start, so that it is critically damped there.  ω is of
the step, ω h = 0.2: a joint of 7 rad/s goes some 20 mrad into it, and stays.  z⁺ is the way at the end of the step,
so the spring gives back at most what it took.  A step that ends in the stop and began before it stores at most (ω h)²
of the joint's energy unpaid, less than the damper takes in the next.  Before its stops a joint feels nothing.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from drivers.interface import Vector

STIFFNESS: Final = 0.2  # ω h
BEFORE_RAD: Final = 0.01  # the limits: an arm that leans on a stop is within them, and its servos take it as it lies


class EndStops:
    """Of (J,) joints: limits rad, inertia kg·m² as each would turn by itself."""

    def __init__(self, low: Vector, high: Vector, inertia: Vector, step_s: float) -> None:
        self._low, self._high = low + BEFORE_RAD, high - BEFORE_RAD
        self._stiffness = inertia * (STIFFNESS / step_s) ** 2
        self._implicit = step_s * self._stiffness + 2.0 * inertia * STIFFNESS / step_s

    def torque(self, q: Vector) -> tuple[Vector, Vector] | None:
        """(D, f), each (J,): the stops' torque is −D (dq + dq⁺)/2 + f over the step from q (J,); None before all."""
        beyond = q - np.minimum(np.maximum(q, self._low), self._high)
        if not beyond.any():
            return None
        return np.where(beyond != 0.0, self._implicit, 0.0), -self._stiffness * beyond
