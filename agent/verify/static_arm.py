"""One arm of a cell at many places: its weights, what its law and its estimates give for errors, its friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agent.config.cell import Arm, Cell
from agent.control.adaptation_bound import ReferenceTwist, adaptation_matrix
from agent.control.errors import HALF_ANGLE
from agent.control.law import NO_WRENCH, Offline
from agent.control.models import ArmModel, Matrix
from agent.control.quaternion import to_matrix
from agent.control.trajectory import Desired
from agent.verify.rubbing import Rubbing
from drivers.interface import Vector

STILL_RAD_PER_S, STILL_RAD = 1e-6, 1e-9
PRESLIDING_RAD = 1e-3  # way of a joint on which its friction builds up


@dataclass(frozen=True, eq=False)
class StaticArm:
    """One arm at all places (T, …), on the task rows (m)."""

    Jt: Matrix  # (T, n, m)
    J_inv: Matrix  # (T, n, m)
    g: Matrix  # (T, n)
    S: Matrix  # (m, m) stiffness of its law
    D: Matrix  # (T, m, m) what its law gives for a velocity that the object lacks, through the arm's inertia too
    G: Matrix | None  # (T, m, m) what its estimates come to give per second and unit of e_v; None: it learns nothing
    leak_per_s: float  # by which they forget
    KH: Matrix  # (m, m)
    load: Matrix  # (T, m) c_i W_O + f_int,i
    held: Matrix  # (T, n) what holds arm and load, which presses on its gears
    stall: Vector  # (n,)
    rub: Rubbing
    smooth_rad_per_s: float | None  # of the friction feed-forward; None: there is none

    def wrench(self, tau: Matrix) -> Matrix:
        """J⁻ᵀ τ, (T, m) of joint torques (T, n)."""
        return applied(np.swapaxes(self.J_inv, -1, -2), tau)

    def law(self, x: Matrix) -> tuple[Matrix, Matrix]:
        """τ (T, n) in HOLD with the object at x (T, m), and a slope (T, n, m) of −τ over x with which steps to where it
        is balanced do not overshoot: of the smooth sign not its own slope, but that of the line to the origin."""
        tau, slope = self.g + applied(self.Jt, self.load - x @ self.S.T), self.Jt @ self.S
        if self.smooth_rad_per_s is None:
            return tau, slope
        dq_ref = -applied(self.J_inv, x @ self.KH.T)
        turning = np.where(np.abs(dq_ref) < STILL_RAD_PER_S, STILL_RAD_PER_S, dq_ref)
        sign, viscous = np.tanh(turning / self.smooth_rad_per_s), self.rub.viscous
        steep = self.rub.fed(self.held, sign) * sign / turning
        steep = steep + viscous
        return tau + steep * dq_ref, slope + steep[..., None] * (self.J_inv @ self.KH)

    def rubs(self, x: Matrix, bound: Matrix) -> tuple[Matrix, Matrix]:
        """Friction (T, n), up to its bound (T, n), of joints that the object's way x (T, m) took along, and a slope as
        of `law`."""
        turned = applied(self.J_inv, x)
        turned = np.where(np.abs(turned) < STILL_RAD, STILL_RAD, turned)
        steep = bound * np.tanh(turned / PRESLIDING_RAD) / turned
        return -steep * turned, steep[..., None] * self.J_inv


def static_arm(
    cell: Cell, arm: Arm, model: ArmModel, along: Sequence[Vector], desired: Sequence[Desired], weight: Vector
) -> StaticArm:
    """The arm with joints along[k] (n,) where the object is desired[k]; weight: (m,) its W_O."""
    offline, P = cell.offline(arm), model.task_basis
    R = np.reshape([to_matrix(d.quat) for d in desired], (-1, 3, 3))
    gains = offline.gains
    J = np.array([P @ model.task_basis.T @ model.jacobian(q) for q in along])
    B_inv = np.linalg.inv([model.inertia(q) for q in along])
    Jt = np.swapaxes(J, -1, -2)
    inertia = np.linalg.inv(J @ B_inv @ Jt)
    KH, KH_rate = (
        P @ np.diag(np.array(k) * HALF_ANGLE) @ P.T
        for k in ((*gains.k_p, *gains.k_eps), (*gains.k_p_rate, *gains.k_eps_rate))
    )
    k_v = P @ np.diag(gains.k_v) @ P.T
    S = k_v @ KH + offline.load_share * P @ np.diag(HALF_ANGLE) @ P.T
    g = np.array([model.evaluate(q, np.zeros(model.n)).g for q in along])
    asked = np.reshape(offline.internal_wrench or NO_WRENCH, (2, 3))
    load = offline.load_share * weight + np.reshape(asked @ np.swapaxes(R, -1, -2), (-1, 6)) @ P.T
    return StaticArm(
        Jt=Jt,
        J_inv=B_inv @ Jt @ inertia,
        g=g,
        S=S,
        D=k_v + inertia @ KH_rate,
        G=_learnt(model, offline, along, desired),
        leak_per_s=0.0 if offline.adaptation is None else offline.adaptation.leak_per_s,
        KH=KH,
        load=load,
        held=g + applied(Jt, load),
        stall=arm.tau_stall_Nm,
        rub=Rubbing.of(arm.servos, cell.tolerance),
        smooth_rad_per_s=None if offline.friction is None else offline.friction.smooth_rad_per_s,
    )


def _learnt(model: ArmModel, offline: Offline, along: Sequence[Vector], desired: Sequence[Desired]) -> Matrix | None:
    if offline.adaptation is None:
        return None
    references = [ReferenceTwist(np.array(d.v), np.array(d.a)) for d in desired]
    each = zip(along, references, strict=True)
    return np.array([adaptation_matrix(model, offline, q, reference, model.task_basis) for q, reference in each])


def applied(matrix: Matrix, vectors: Matrix) -> Matrix:
    """(T, a) of matrices (…, a, b) and vectors (T, b)."""
    result: Matrix = (matrix @ vectors[..., None])[..., 0]
    return result
