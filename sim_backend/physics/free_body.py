"""The object of the plant on its own: the terms of its motion about its frame, whose origin need not be its centre."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from drivers.interface import Vector
from sim_backend.physics.spec import ObjectSpec


class FreeBody:
    """The object held by nothing, under gravity (3,) m/s²."""

    def __init__(self, spec: ObjectSpec, gravity: Vector) -> None:
        self._spec = spec
        self._gravity = np.array(gravity)
        self._mass = spec.mass_kg * np.eye(3)

    def terms(self, R: Vector, omega: Vector, M: Vector) -> Vector:
        """Bias (6,) at attitude R (3, 3) and angular velocity (3,), and its inertia into M (6, 6): world axes."""
        m, W, r = self._spec.mass_kg, pin.skew(omega), R.dot(self._spec.centre_m)
        S, inertia = m * pin.skew(r), R.dot(self._spec.inertia).dot(R.T)
        M[:3, :3], M[3:, 3:] = self._mass, inertia - S.dot(S) / m
        M[:3, 3:], M[3:, :3] = -S, S
        bias: Vector = np.empty(6)
        bias[:3] = m * W.dot(W.dot(r)) - m * self._gravity
        bias[3:] = S.dot(bias[:3]) / m + W.dot(inertia.dot(omega))
        return bias

    def potential(self, T: pin.SE3) -> float:
        """Potential energy at T, J."""
        return -self._spec.mass_kg * float(self._gravity @ T.act(self._spec.centre_m))
