"""Object and arms as one moving body under any joint torques, `eq:coupled dynamics`, in reduced coordinates.

The independent simulation of the closed-loop proofs: the object's twist is the only velocity, the arms follow
through their Jacobians, integrated by Runge–Kutta 4.  It shares nothing with the product's simulator.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from drivers.interface import Vector
from tests.support.control import oracle
from tests.support.control.strategies import RandomCell


@dataclass(frozen=True)
class Motion:
    """State of the coupled body; `work` is any integral that rides along."""

    p: Vector  # (3,)
    quat: Vector  # (4,) scalar first
    v: Vector  # (m,) twist in the rows of P
    q: tuple[Vector, ...]
    work: float = 0.0

    def plus(self, rate: Motion, h: float) -> Motion:
        """Euler step; the quaternion leaves the sphere until `normalised`."""
        return Motion(
            self.p + h * rate.p,
            self.quat + h * rate.quat,
            self.v + h * rate.v,
            tuple(a + h * b for a, b in zip(self.q, rate.q, strict=True)),
            self.work + h * rate.work,
        )

    def normalised(self) -> Motion:
        """The same state with the quaternion back on the unit sphere."""
        return Motion(self.p, self.quat / np.linalg.norm(self.quat), self.v, self.q, self.work)


@dataclass(frozen=True)
class Instant:
    """What a torque function may look at: every arm's own joints, and the coupled terms for the judges."""

    t: float
    motion: Motion
    dq: tuple[Vector, ...]
    terms: oracle.Coupled


# torques of all arms and the rate of `work`
Torques = Callable[[Instant], tuple[Sequence[Vector], float]]


def start(cell: RandomCell) -> Motion:
    """The cell's own state as a motion."""
    T = cell.T_world_object
    quat = pin.Quaternion(T.rotation).coeffs()[[3, 0, 1, 2]]
    return Motion(T.translation.copy(), quat, cell.P @ cell.v_object, tuple(a.q for a in cell.arms))


def observe(cell: RandomCell, t: float, motion: Motion) -> Instant:
    """Joint velocities and coupled terms that belong to a state."""
    v_object = cell.P.T @ motion.v
    R = pin.Quaternion(*motion.quat.tolist()).normalized().matrix()
    dq = []
    for arm, q in zip(cell.arms, motion.q, strict=True):
        J = cell.P @ arm.model.task_basis.T @ arm.model.jacobian(q)
        dq.append(np.linalg.solve(J, motion.v))
    terms = oracle.coupled(cell, list(motion.q), dq, R, v_object[3:])
    return Instant(t, motion, tuple(dq), terms)


def rate(cell: RandomCell, now: Instant, torques: Torques) -> Motion:
    """Time derivative of the state."""
    tau, work = torques(now)
    c, motion = now.terms, now.motion
    wrench = sum(s.J_O.T @ s.J_inv.T @ tau_i for s, tau_i in zip(c.arms, tau, strict=True))  # Gᵀ u
    dv = np.linalg.solve(c.M, wrench - c.C @ motion.v - c.g)
    v_object = cell.P.T @ motion.v
    return Motion(v_object[:3], 0.5 * oracle.E(motion.quat) @ v_object[3:], dv, now.dq, work)


def step(cell: RandomCell, now: Instant, torques: Torques, h: float) -> Motion:
    """One Runge–Kutta 4 step from an observed state; the torques are evaluated at every stage (continuous control)."""
    t, motion = now.t, now.motion
    k1 = rate(cell, now, torques)
    k2 = rate(cell, observe(cell, t + 0.5 * h, motion.plus(k1, 0.5 * h)), torques)
    k3 = rate(cell, observe(cell, t + 0.5 * h, motion.plus(k2, 0.5 * h)), torques)
    k4 = rate(cell, observe(cell, t + h, motion.plus(k3, h)), torques)
    after = motion.plus(k1, h / 6).plus(k2, h / 3).plus(k3, h / 3).plus(k4, h / 6)
    return after.normalised()
