"""Backlash of the joints: while a motor crosses the gap of its gear, none of its torque reaches the joint.

With x the angle by which the motor is ahead of the joint, |x| ≤ ½ backlash, J its reflected inertia and a substep h,

    u ← u + h (τ / J − ddq),   x ← x + h u;

at an end of the gap the teeth meet without bouncing: the joint gets τ + J u₋ / h, the torque and the momentum that the
motor brought along, and u is zero.  Inside the gap the joint gets nothing.  The motor crosses without friction, and its
inertia stays with the joint meanwhile.  Encoders sit at the joint.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from drivers.interface import Vector
from sim_backend.physics.spec import PlantSpec

LEAST_INERTIA: Final = 1e-5  # kg·m²; a motor that has less crosses the gap in a substep


class Gears:
    """Gears of all joints (J,) of a plant."""

    def __init__(self, backlash_rad: Vector, inertia: Vector, substep_s: float) -> None:
        self._half = 0.5 * backlash_rad
        self._inertia = np.maximum(inertia, LEAST_INERTIA)
        self._h = substep_s
        self.x: Vector = np.zeros(len(backlash_rad))  # motor ahead of joint, rad
        self._u: Vector = np.zeros(len(backlash_rad))
        self._dq: Vector | None = None  # of the substep before

    def passed(self, motor: Vector, dq: Vector) -> Vector:
        """Torque (J,) that reaches the joints in this substep; motor: of the motors, dq: of the joints at its begin."""
        h, before = self._h, self._u
        ddq = 0.0 if self._dq is None else (dq - self._dq) / h
        self._dq = dq.copy()
        u = before + h * (motor / self._inertia - ddq)
        x = self.x + h * u
        meet = np.abs(x) >= self._half
        self.x = np.clip(x, -self._half, self._half)
        self._u = np.where(meet, 0.0, u)
        return np.where(meet, motor + self._inertia * before / h, 0.0)


def gears(spec: PlantSpec) -> Gears | None:
    """Of all arms of the plant; None where no joint has backlash."""
    backlash = np.concatenate([np.zeros(0), *(arm.actuator.backlash_rad for arm in spec.arms)])
    if not backlash.any():
        return None
    return Gears(backlash, np.concatenate([arm.rotor_inertia for arm in spec.arms]), spec.substep_s)
