"""Null-space posture of arms with more joints than task rows: pulls towards a posture without touching the object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agent.control.models import Matrix
from drivers.interface import Vector


@dataclass(frozen=True, slots=True)
class Posture:
    """The wanted posture; sequences of length n."""

    q_rad: tuple[float, ...]
    stiffness_Nm_per_rad: float
    damping_Nm_s_per_rad: float

    def torque(self, q: Vector, dq: Vector, J: Matrix, J_inv: Matrix) -> Vector:
        """τ = (I − Jᵀ J̄ᵀ) τ_0, τ_0 = k (q_p − q) − d dq, with the dynamically consistent inverse J̄.

        q, dq: (n,); J: (m, n); J_inv: J̄ (n, m).  It neither adds to the wrench at the object (J̄ᵀτ = 0) nor
        accelerates it (J B⁻¹ τ = 0).  The damping is what stops motion inside the null space.
        """
        tau_0 = self.stiffness_Nm_per_rad * (np.array(self.q_rad) - q) - self.damping_Nm_s_per_rad * dq
        tau: Vector = tau_0 - J.T.dot(J_inv.T.dot(tau_0))
        return tau
