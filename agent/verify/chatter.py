"""How much the torques of an arm shake because servos report angles and velocities in steps: what one hears.

At rest the law makes of errors of the angles and velocities that it takes

    τ = −Jᵀ S J q̂ − ((B J⁻¹ + c Jᵀ M_O) K' H + Jᵀ k_v) J dq̂,     S = (k_v + V̂) K H + c H.

Readings are off by errors of their own, uniform over one step of their grids.  What an observer
(agent.control.estimator) whose expected acceleration is the true one makes of them has the covariance
Σ = A Σ Aᵀ + Q, the same for every joint.  Without an observer q̂ and dq̂ are off as the readings are.
"""

from __future__ import annotations

import math

import numpy as np

from agent.control.errors import Gains
from agent.control.estimator import Observer
from agent.control.law import Offline
from agent.control.models import ArmModel, Matrix
from drivers.dynamixel.servo.counts import TICKS_PER_TURN, VELOCITY_UNIT_RAD_PER_S
from drivers.interface import Vector

READINGS = np.diag([(2.0 * math.pi / TICKS_PER_TURN) ** 2 / 12.0, VELOCITY_UNIT_RAD_PER_S**2 / 12.0])  # covariance


class Shaking:
    """One arm at one pose: what of its torque noise does not depend on the gains, computed once."""

    def __init__(self, model: ArmModel, offline: Offline, viscous: Vector, q: Vector) -> None:
        """viscous: (n,) N·m·s/rad of the joints, by the arm's file."""
        self._P, self._share, self.J = model.task_basis, offline.load_share, model.jacobian(q)
        B, R = model.inertia(q), model.object_pose(q).rotation
        M_object = np.zeros((6, 6))
        M_object[:3, :3] = offline.object_mass_kg * np.eye(3)
        M_object[3:, 3:] = R @ np.reshape(offline.object_inertia, (3, 3)) @ R.T
        self._J_inv = np.linalg.pinv(self.J)
        self._inertia = B @ self._J_inv + self._share * self.J.T @ self._P @ M_object @ self._P.T
        fed = 0.0 if offline.friction is None else viscous[:, None]
        self._fed = self.J.T @ self._J_inv.T @ (fed * self._J_inv)

    def feedback(self, gains: Gains) -> tuple[Matrix, Matrix]:
        """Torque (n,) per angle and per velocity that the law takes, (n, n) each, signs left out."""
        P, J = self._P, self.J
        K = P @ np.diag([*gains.k_p, *(0.5 * k for k in gains.k_eps)]) @ P.T
        K_rate = self._accelerated(gains)
        k_v, H = P @ np.diag(gains.k_v) @ P.T, P @ np.diag([1.0, 1.0, 1.0, 0.5, 0.5, 0.5]) @ P.T
        by_angle = J.T @ (k_v @ K + self._share * H) + self._fed @ K
        return by_angle @ J, (self._inertia @ K_rate + J.T @ k_v) @ J

    def torque_Nm(self, gains: Gains, observer: Observer | None) -> float:
        """Largest rms torque of a joint; infinite where the observer runs away."""
        by_angle, by_velocity = self.feedback(gains)
        (aa, av), (_, vv) = READINGS if observer is None else estimates(observer)
        if math.isinf(aa):
            return math.inf
        square = aa * by_angle**2 + 2.0 * av * by_angle * by_velocity + vv * by_velocity**2
        return math.sqrt(float(square.sum(axis=1).max()))

    def _accelerated(self, gains: Gains) -> Matrix:
        found: Matrix = self._P @ np.diag([*gains.k_p_rate, *(0.5 * k for k in gains.k_eps_rate)]) @ self._P.T
        return found


def estimates(observer: Observer) -> Matrix:
    """Σ (2, 2) of the errors of an estimated angle and velocity; infinite where the observer does not forget them."""
    A, read = surprises(observer)
    if np.abs(np.linalg.eigvals(A)).max() >= 1.0:
        return np.full((2, 2), math.inf)
    summed = np.linalg.solve(np.eye(4) - np.kron(A, A), (read @ READINGS @ read.T).ravel())
    found: Matrix = np.asarray(summed, float).reshape(2, 2)
    return found


def surprises(observer: Observer) -> tuple[Matrix, Matrix]:
    """How errors (angle, velocity) follow from those of the tick before, and from the readings'; (2, 2) each."""
    (angle, velocity), zero = np.eye(2), np.zeros(2)
    A = np.stack(observer.follow(angle, velocity, zero, zero, zero, zero))
    return A, np.stack(observer.follow(zero, zero, zero, zero, angle, velocity))


def forgetting(observer: Observer | None) -> float:
    """Spectral radius of an observer's errors while the expected acceleration is the true one; 0 without observer."""
    return 0.0 if observer is None else float(np.abs(np.linalg.eigvals(surprises(observer)[0])).max())
