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
        self._weight = np.concatenate([-spec.mass_kg * gravity, np.zeros(3)])
        self._off_centre = bool(np.any(spec.centre_m))

    def terms(self, R: Vector, omega: Vector, M: Vector) -> Vector:
        """Bias (6,) at attitude R (3, 3) and angular velocity (3,), and its inertia into M (6, 6): world axes.

        The first three rows of M hold the mass already and are not written unless the centre is off.
        """
        spec, W = self._spec, pin.skew(omega)
        inertia = R.dot(spec.inertia).dot(R.T)
        M[3:, 3:] = inertia
        bias: Vector = self._weight.copy()
        bias[3:] = W.dot(inertia.dot(omega))
        if self._off_centre:
            r = R.dot(spec.centre_m)
            S = pin.skew(r)
            bias[:3] += spec.mass_kg * W.dot(W.dot(r))
            bias[3:] += S.dot(bias[:3])
            M[3:, 3:] -= spec.mass_kg * S.dot(S)
            M[:3, 3:], M[3:, :3] = -spec.mass_kg * S, spec.mass_kg * S
        return bias

    def potential(self, T: pin.SE3) -> float:
        """Potential energy at T, J."""
        return -self._spec.mass_kg * float(self._gravity @ T.act(self._spec.centre_m))
