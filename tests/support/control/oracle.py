"""The paper's law in its printed task-space form, and the coupled dynamics, written out as matrices.

The independent side of the property tests: nothing of agent.control computes a number here.  J_O, its
derivative, M_i, C_i and g_i come straight from pinocchio's end-effector quantities; slow, and never used in
the product.  A planar arm uses the same formulas with the rows of the task basis P.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pinocchio as pin

from agent.control.models import ArmModel
from agent.control.trajectory import Desired
from drivers.interface import Vector
from tests.support.control.strategies import Holder, RandomCell

AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


def rate_of(f: Callable[[float], Vector], h: float = 2e-4) -> Vector:
    """Derivative of f at zero by central differences of fourth order."""
    return (8.0 * (f(h) - f(-h)) - (f(2.0 * h) - f(-2.0 * h))) / (12.0 * h)


def rate_at(f: Callable[[float], Vector], t: float, h: float = 1e-4) -> Vector:
    """The same at t."""
    return rate_of(lambda s: f(t + s), h)


def skew(a: Vector) -> Vector:
    """S(a) (3, 3)."""
    x, y, z = a.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def E(quat: Vector) -> Vector:
    """(4, 3) map of `eq:propagation rule_1`: dξ/dt = ½ E(ξ) ω, ω in world axes."""
    eta, eps = quat[0], quat[1:]
    return np.vstack([-eps, eta * np.eye(3) - skew(eps)])


def quaternion_product(a: Vector, b: Vector) -> Vector:
    """`eq:quat_prod` with vectors."""
    return np.concatenate([[a[0] * b[0] - a[1:] @ b[1:]], a[0] * b[1:] + b[0] * a[1:] + skew(a[1:]) @ b[1:]])


@dataclass(frozen=True)
class TaskSpace:
    """One arm in the paper's notation; all matrices in the task rows (m = 6, or 3 in a plane)."""

    T_world_object: pin.SE3
    J: Vector  # (m, n) of the end effector
    J_inv: Vector  # (n, m), dynamically consistent when n > m
    J_O: Vector  # (m, m), `eq:J_o_i_def`
    dJ_O: Vector
    M: Vector  # M_i
    C: Vector  # C_i
    g: Vector  # g_i


@lru_cache(maxsize=8)  # arms of a cell, at every stage of an integrator
def _scratch(model: ArmModel) -> pin.Data:
    return model.model.createData()


def task_space(arm: Holder, q: Vector, dq: Vector, P: Vector) -> TaskSpace:
    """The arm's quantities at (q, dq), each (n,), in the rows of P (m, 6)."""
    model = arm.model.model
    data = _scratch(arm.model)
    pin.computeJointJacobiansTimeVariation(model, data, q, dq)
    pin.updateFramePlacements(model, data)
    ee = arm.model.ee_id
    T_world_ee = data.oMf[ee]
    T_world_object = T_world_ee * arm.T_object_ee.inverse()
    J6 = pin.getFrameJacobian(model, data, ee, AXES)
    J, dJ = P @ J6, P @ pin.getFrameJacobianTimeVariation(model, data, ee, AXES)
    omega = J6[3:] @ dq
    p_ee_object = T_world_object.translation - T_world_ee.translation
    J_O, dJ_O = np.eye(6), np.zeros((6, 6))
    J_O[:3, 3:] = skew(p_ee_object)
    dJ_O[:3, 3:] = skew(skew(omega) @ p_ee_object)
    B = pin.crba(model, data, q).copy()
    C = pin.computeCoriolisMatrix(model, data, q, dq).copy()
    g = pin.rnea(model, data, q, np.zeros_like(q), np.zeros_like(q)).copy()
    B_inv = np.linalg.inv(B)
    M = np.linalg.inv(J @ B_inv @ J.T)
    J_inv = B_inv @ J.T @ M
    return TaskSpace(
        T_world_object=T_world_object,
        J=J,
        J_inv=J_inv,
        J_O=P @ J_O @ P.T,
        dJ_O=P @ dJ_O @ P.T,
        M=M,
        C=J_inv.T @ C @ J_inv - M @ dJ @ J_inv,
        g=J_inv.T @ g,
    )


@dataclass(frozen=True)
class ObjectDynamics:
    """M_O, C_O (6, 6) and g_O (6,) of `eq:object dynamics` about the centre of mass."""

    M: Vector
    C: Vector
    g: Vector


def object_dynamics(arm: Holder, R: Vector, omega: Vector) -> ObjectDynamics:
    """The object's terms at attitude R (3, 3) and angular velocity omega (3,)."""
    m = arm.offline.object_mass_kg
    inertia = R @ np.array(arm.offline.object_inertia).reshape(3, 3) @ R.T
    M, C = np.zeros((6, 6)), np.zeros((6, 6))
    M[:3, :3], M[3:, 3:] = m * np.eye(3), inertia
    C[3:, 3:] = skew(omega) @ inertia
    return ObjectDynamics(M, C, np.concatenate([-m * np.array(arm.offline.gravity), np.zeros(3)]))


@dataclass(frozen=True)
class ErrorSignals:
    """Errors and references of the paper, with the corrected signs of docs/controller.md."""

    e_p: Vector
    e_eta: float
    e_eps: Vector
    e: Vector
    v_ref: Vector
    dv_ref: Vector
    e_v: Vector


def error_signals(arm: Holder, p: Vector, quat: Vector, v: Vector, desired: Desired) -> ErrorSignals:
    """From the object's pose and twist (6,) to the errors, by matrices."""
    gains = arm.offline.gains
    quat_des, v_des, a_des = np.array(desired.quat), np.array(desired.v), np.array(desired.a)
    e_p = p - np.array(desired.p)
    e_xi = quaternion_product(quat_des, quat * np.array([1.0, -1.0, -1.0, -1.0]))  # eq:quat_error
    e_eta, e_eps = e_xi[0], e_xi[1:]
    e_omega = v[3:] - v_des[3:]
    de_p = v[:3] - v_des[:3]  # eq:error_dynamics
    de_eta = 0.5 * e_eps @ e_omega
    de_eps = -0.5 * (e_eta * np.eye(3) + skew(e_eps)) @ e_omega - skew(e_eps) @ v_des[3:]
    K = np.diag([*gains.k_p, *gains.k_eps])
    K_rate = np.diag([*gains.k_p_rate, *gains.k_eps_rate])
    e = np.concatenate([e_p, -e_eta * e_eps])
    de = np.concatenate([de_p, -de_eta * e_eps - e_eta * de_eps])
    v_ref = v_des - K @ e  # eq:reference signals, last form
    return ErrorSignals(e_p, float(e_eta), e_eps, e, v_ref, a_des - K_rate @ de, v - v_ref)


def task_wrench(arm: Holder, q: Vector, dq: Vector, desired: Desired, P: Vector) -> tuple[Vector, TaskSpace]:
    """u_i (m,) of `eq:control law` as printed, with the internal force of the remark; and the arm's terms."""
    s = task_space(arm, q, dq, P)
    v = P.T @ np.linalg.solve(s.J_O, s.J @ dq)  # eq:J_o_i
    R = s.T_world_object.rotation
    quat = pin.Quaternion(R).coeffs()[[3, 0, 1, 2]]
    e = error_signals(arm, s.T_world_object.translation, quat, v, desired)
    o = object_dynamics(arm, R, v[3:])
    c, k_v = arm.offline.load_share, np.diag(arm.offline.gains.k_v)
    v_ref, dv_ref = P @ e.v_ref, P @ e.dv_ref
    J_O_inv_T = np.linalg.inv(s.J_O).T
    mu = s.g + (s.C @ s.J_O + s.M @ s.dJ_O) @ v_ref + s.M @ s.J_O @ dv_ref
    mu -= J_O_inv_T @ P @ (k_v @ e.e_v + c * e.e)
    f_d = c * J_O_inv_T @ P @ (o.M @ e.dv_ref + o.C @ e.v_ref + o.g)
    f_int = np.zeros(len(P))
    if arm.offline.internal_wrench is not None:
        w = np.array(arm.offline.internal_wrench)
        f_int = J_O_inv_T @ P @ np.concatenate([R @ w[:3], R @ w[3:]])
    return mu + f_d + f_int, s


@dataclass(frozen=True)
class Coupled:
    """`eq:coupled terms` in the rows of P, and the grasp matrix G (N m, m)."""

    M: Vector
    C: Vector
    g: Vector
    G: Vector
    arms: tuple[TaskSpace, ...]


def coupled(cell: RandomCell, q: list[Vector], dq: list[Vector], R: Vector, omega: Vector) -> Coupled:
    """Object and arms as one body at (q, dq) of every arm and the object's attitude and angular velocity."""
    P = cell.P
    o = object_dynamics(cell.arms[0], R, omega)
    spaces = tuple(task_space(a, q_i, dq_i, P) for a, q_i, dq_i in zip(cell.arms, q, dq, strict=True))
    M, C, g = P @ o.M @ P.T, P @ o.C @ P.T, P @ o.g
    for s in spaces:
        M = M + s.J_O.T @ s.M @ s.J_O
        C = C + s.J_O.T @ (s.C @ s.J_O + s.M @ s.dJ_O)
        g = g + s.J_O.T @ s.g
    return Coupled(M, C, g, np.vstack([s.J_O for s in spaces]), spaces)


def lyapunov(e: ErrorSignals, M: Vector, P: Vector) -> float:
    """The paper's V with its attitude part corrected to 1 − e_η²; M is the coupled inertia."""
    e_v = P @ e.e_v
    return float(0.5 * e.e_p @ e.e_p + 1.0 - e.e_eta**2 + 0.5 * e_v @ M @ e_v)
