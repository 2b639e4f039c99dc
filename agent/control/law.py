"""What both control laws share: offline data of one agent, the terms of one tick, and the object's dynamics.

Functions of the agent's own (q, dq), the time and offline data; `add_extra` adds to the torque it is given.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from agent.control import errors as error_terms
from agent.control.adaptation import Adaptation
from agent.control.errors import Errors, Gains
from agent.control.friction import Friction
from agent.control.inverse import invert_jacobian
from agent.control.models import ArmModel, Kinematics, Matrix
from agent.control.posture import Posture
from agent.control.quaternion import Mat3, Vec3, cross, rotate, rotate_back
from agent.control.trajectory import Desired, Vec6
from drivers.interface import Vector

_NO_WRENCH: Vec6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Offline:
    """All that one agent knows beside its own arm: identical data on every host, fixed before the start."""

    gains: Gains
    load_share: float  # c_i
    object_mass_kg: float
    object_inertia: Mat3  # about the centre of mass, object axes, kg·m²
    gravity: Vec3  # world axes
    friction: Friction | None = None  # feed-forward, None = off
    posture: Posture | None = None  # of an arm with more joints than task rows
    internal_wrench: Vec6 | None = None  # f_int,i about the object's centre, object axes; None = none wanted
    adaptation: Adaptation | None = None  # the adaptive law's own data; None = the non-adaptive law runs


class Terms(NamedTuple):
    """Every intermediate result of one tick; the torque is the sum of the named terms.

    A named tuple, because a frozen dataclass takes three times as long to make, and one is made on every tick.
    """

    desired: Desired
    kinematics: Kinematics
    errors: Errors
    dq_ref: Vector
    ddq_ref: Vector
    tau_inertia: Vector | None
    tau_coriolis: Vector | None
    tau_gravity: Vector | None
    tau_adaptive: Vector | None
    tau_feedback: Vector
    tau_object: Vector
    tau_internal: Vector | None
    tau_friction: Vector | None
    tau_posture: Vector | None
    tau_cmd: Vector
    wrench_cmd: Vec6  # u_i at the end effector
    wrench_internal: Vec6  # at the end effector
    lyapunov: float
    sigma_min: float


def object_wrench(offline: Offline, k: Kinematics, errors: Errors) -> Vec6:
    """M_O v̇_r + C_O v_r + g_O about the object's centre, world axes (`eq:object dynamics`)."""
    R = k.R_world_object
    v_ref, dv_ref, m, g = errors.v_ref, errors.dv_ref, offline.object_mass_kg, offline.gravity
    inertia = offline.object_inertia
    I_alpha = rotate(R, rotate(inertia, rotate_back(R, (dv_ref[3], dv_ref[4], dv_ref[5]))))
    I_omega = rotate(R, rotate(inertia, rotate_back(R, (v_ref[3], v_ref[4], v_ref[5]))))
    gyro = cross((k.v_object[3], k.v_object[4], k.v_object[5]), I_omega)  # C_O = blockdiag(0, S(ω) I_O)
    return (
        m * (dv_ref[0] - g[0]),
        m * (dv_ref[1] - g[1]),
        m * (dv_ref[2] - g[2]),
        I_alpha[0] + gyro[0],
        I_alpha[1] + gyro[1],
        I_alpha[2] + gyro[2],
    )


def rotate_wrench(R: Mat3, w: Vec6) -> Vec6:
    """Wrench in world axes of a wrench in object axes."""
    return (*rotate(R, (w[0], w[1], w[2])), *rotate(R, (w[3], w[4], w[5])))


def shift_to_ee(k: Kinematics, w: Vec6) -> Vec6:
    """J_O⁻ᵀ w: the wrench at the end effector with the same effect as w at the object's centre."""
    force = (w[0], w[1], w[2])
    moment = cross(k.p_ee_object, force)
    return (*force, w[3] + moment[0], w[4] + moment[1], w[5] + moment[2])


class Reference(NamedTuple):
    """What both laws begin with: kinematics, errors, and the joint motion that the reference twist asks for."""

    kinematics: Kinematics
    errors: Errors
    J_inv: Matrix  # (n, m)
    J_inv_P: Matrix  # (n, 6) joint velocities of an object twist
    dq_ref: Vector
    ddq_ref: Vector
    sigma_min: float


def reference(model: ArmModel, offline: Offline, q: Vector, dq: Vector, desired: Desired) -> Reference:
    """dq_r = J⁻¹ v_r and ddq_r = J⁻¹ (v̇_r − J̇ dq_r) at this arm's (q, dq).  Raises SingularJacobian."""
    k = model.evaluate(q, dq)
    e = error_terms.evaluate(k.p_object, k.quat_object, k.v_object, desired, offline.gains)
    J_inv, sigma_min = invert_jacobian(k.J, k.B)
    J_inv_P = J_inv.dot(model.task_basis)
    dq_ref = J_inv_P.dot(e.v_ref)
    ddq_ref = J_inv_P.dot(e.dv_ref) - J_inv.dot(k.dJ.dot(dq_ref))
    return Reference(k, e, J_inv, J_inv_P, dq_ref, ddq_ref, sigma_min)


def feedback_torque(offline: Offline, k: Kinematics, e: Errors) -> Vector:
    """Jᵀ (−k_v e_v − c_i e)."""
    c, k_v = offline.load_share, offline.gains.k_v
    tau: Vector = k.Jt.dot([-g * v - c * x for g, v, x in zip(k_v, e.e_v, e.e, strict=True)])
    return tau


class Extra(NamedTuple):
    """What both laws can add to the paper's torque: internal force and null-space posture."""

    tau_internal: Vector | None
    wrench_internal: Vec6  # at the end effector
    tau_posture: Vector | None


def add_extra(tau_law: Vector, offline: Offline, k: Kinematics, q: Vector, dq: Vector, J_inv: Matrix) -> Extra:
    """Torques of the desired internal wrench and of the posture, where configured; adds them to tau_law in place."""
    tau_internal, wrench_internal, tau_posture = None, _NO_WRENCH, None
    if offline.internal_wrench is not None:
        internal = rotate_wrench(k.R_world_object, offline.internal_wrench)
        tau_internal = k.Jt.dot(internal)
        wrench_internal = shift_to_ee(k, internal)
        tau_law += tau_internal
    if offline.posture is not None:
        tau_posture = offline.posture.torque(q, dq, k.J, J_inv)
        tau_law += tau_posture
    return Extra(tau_internal, wrench_internal, tau_posture)


def lyapunov_share(offline: Offline, k: Kinematics, errors: Errors, dq_error: Vector) -> float:
    """This agent's part of the paper's V, such that the parts of all agents sum to V.

    c_i (½‖e_p‖² + 1 − e_η²) + ½ (dq − dq_r)ᵀ B (dq − dq_r) + ½ c_i e_vᵀ M_O e_v.
    """
    e_p, e_eta, e_v = errors.e_p, errors.e_eta, errors.e_v
    R = k.R_world_object
    w = rotate_back(R, (e_v[3], e_v[4], e_v[5]))
    Iw = rotate(offline.object_inertia, w)
    kinetic = offline.object_mass_kg * (e_v[0] * e_v[0] + e_v[1] * e_v[1] + e_v[2] * e_v[2])
    kinetic += w[0] * Iw[0] + w[1] * Iw[1] + w[2] * Iw[2]
    pose = 0.5 * (e_p[0] * e_p[0] + e_p[1] * e_p[1] + e_p[2] * e_p[2]) + 1.0 - e_eta * e_eta
    return offline.load_share * (pose + 0.5 * kinetic) + 0.5 * float(dq_error.dot(k.B.dot(dq_error)))
