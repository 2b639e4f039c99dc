"""What the control laws share: offline data of one agent, the terms of one tick, and the object's dynamics.

Everything here is a function of the agent's own (q, dq), the time and offline data, and changes no argument.
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
from agent.control.quaternion import Mat3, Vec3, cross, rotate, rotate_back, rotate_through
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
    J_inv_P: Matrix | None  # (n, 6) joint velocities of an object twist; None where the Jacobian was not inverted


def object_wrench(offline: Offline, k: Kinematics, errors: Errors) -> Vec6:
    """M_O v̇_r + C_O v_r + g_O about the object's centre, world axes."""
    R, inertia, m, g = k.R_world_object, offline.object_inertia, offline.object_mass_kg, offline.gravity
    v_ref, dv_ref = errors.v_ref, errors.dv_ref
    I_alpha = rotate_through(R, inertia, dv_ref[3:])
    gyro = cross(k.v_object[3:], rotate_through(R, inertia, v_ref[3:]))  # C_O = blockdiag(0, S(ω) I_O)
    return (  # eq:object dynamics
        m * (dv_ref[0] - g[0]),
        m * (dv_ref[1] - g[1]),
        m * (dv_ref[2] - g[2]),
        I_alpha[0] + gyro[0],
        I_alpha[1] + gyro[1],
        I_alpha[2] + gyro[2],
    )


def rotate_wrench(R: Mat3, w: Vec6) -> Vec6:
    """Wrench or twist in world axes of one in object axes."""
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = R
    x, y, z, a, b, c = w
    return (
        r0 * x + r1 * y + r2 * z,
        r3 * x + r4 * y + r5 * z,
        r6 * x + r7 * y + r8 * z,
        r0 * a + r1 * b + r2 * c,
        r3 * a + r4 * b + r5 * c,
        r6 * a + r7 * b + r8 * c,
    )


def rotate_wrench_back(R: Mat3, w: Vec6) -> Vec6:
    """Wrench or twist in object axes of one in world axes."""
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = R
    return rotate_wrench((r0, r3, r6, r1, r4, r7, r2, r5, r8), w)


def shift_to_ee(k: Kinematics, w: Vec6) -> Vec6:
    """J_O⁻ᵀ w: the wrench at the end effector with the same effect as w at the object's centre."""
    force = (w[0], w[1], w[2])
    moment = cross(k.p_ee_object, force)
    return (*force, w[3] + moment[0], w[4] + moment[1], w[5] + moment[2])  # eq:J_o_i_def


class Reference(NamedTuple):
    """What every law begins with: kinematics, errors, and the joint motion that the reference twist asks for."""

    kinematics: Kinematics
    errors: Errors
    dq_ref: Vector
    ddq_ref: Vector
    sigma_min: float


def reference(
    model: ArmModel, offline: Offline, q: Vector, dq: Vector, desired: Desired
) -> tuple[Reference, Matrix, Matrix]:
    """dq_r = J⁻¹ v_r and ddq_r = J⁻¹ (v̇_r − J̇ dq_r) at this arm's (q, dq); J⁻¹ (n, m), and J⁻¹ P (n, 6).

    J⁻¹ P gives the joint velocities of an object twist.  Raises SingularJacobian.
    """
    k = model.evaluate(q, dq)
    e = error_terms.evaluate(k.p_object, k.quat_object, k.v_object, desired, offline.gains)
    J_inv, sigma_min = invert_jacobian(k.J, k.B)
    P = model.task_basis
    J_inv_P = J_inv if len(P) == 6 else J_inv.dot(P)  # with six rows P is the identity
    dq_ref = J_inv_P.dot(e.v_ref)  # eq:J_o_i at the reference
    ddq_ref = J_inv_P.dot(e.dv_ref) - J_inv.dot(k.dJ.dot(dq_ref))  # eq:J_o_i_dot at the reference
    return Reference(k, e, dq_ref, ddq_ref, sigma_min), J_inv, J_inv_P


class Shared(NamedTuple):
    """Torques that both laws add to those of their model of the arm."""

    tau_feedback: Vector
    tau_object: Vector
    tau_internal: Vector | None
    tau_posture: Vector | None
    wrench_internal: Vec6  # at the end effector


def shared_torques(offline: Offline, k: Kinematics, e: Errors, load: Vec6, tau_posture: Vector | None) -> Shared:
    """Jᵀ (−k_v e_v − c_i e), Jᵀ of this arm's share of the object's wrench (`load`), Jᵀ f_int,i; world axes."""
    c, k_v, e_v, x, Jt = offline.load_share, offline.gains.k_v, e.e_v, e.e, k.Jt
    feedback = (
        -k_v[0] * e_v[0] - c * x[0],
        -k_v[1] * e_v[1] - c * x[1],
        -k_v[2] * e_v[2] - c * x[2],
        -k_v[3] * e_v[3] - c * x[3],
        -k_v[4] * e_v[4] - c * x[4],
        -k_v[5] * e_v[5] - c * x[5],
    )
    tau_feedback, tau_object = Jt.dot(feedback), Jt.dot(load)
    if offline.internal_wrench is None:
        return Shared(tau_feedback, tau_object, None, tau_posture, _NO_WRENCH)
    internal = rotate_wrench(k.R_world_object, offline.internal_wrench)
    return Shared(tau_feedback, tau_object, Jt.dot(internal), tau_posture, shift_to_ee(k, internal))


def law_torque(tau_model: Vector, shared: Shared) -> Vector:
    """Sum of the law's terms (n,), from those of its model of the arm; friction feed-forward is not among them."""
    tau: Vector = tau_model + shared.tau_feedback
    tau += shared.tau_object
    if shared.tau_internal is not None:
        tau += shared.tau_internal
    if shared.tau_posture is not None:
        tau += shared.tau_posture
    return tau


def wrench_at_ee(k: Kinematics, J_inv_P: Matrix, tau_law: Vector) -> Vec6:
    """u_i: what the law asks of the object side; friction feed-forward is spent inside the joints."""
    return shift_to_ee(k, J_inv_P.T.dot(tau_law).tolist())


# Torques by the law's model of the arm: inertia, Coriolis, gravity; adaptive.
ModelTorques = tuple[Vector | None, Vector | None, Vector | None, Vector | None]


def assemble(
    desired: Desired,
    ref: Reference,
    by_model: ModelTorques,
    shared: Shared,
    tau_friction: Vector | None,
    tau_cmd: Vector,
    wrench_cmd: Vec6,
    lyapunov: float,
    J_inv_P: Matrix | None,
) -> Terms:
    """Terms of a tick, in their order; the only place that lists them all."""
    tau_inertia, tau_coriolis, tau_gravity, tau_adaptive = by_model
    return Terms(
        desired,
        ref.kinematics,
        ref.errors,
        ref.dq_ref,
        ref.ddq_ref,
        tau_inertia,
        tau_coriolis,
        tau_gravity,
        tau_adaptive,
        shared.tau_feedback,
        shared.tau_object,
        shared.tau_internal,
        tau_friction,
        shared.tau_posture,
        tau_cmd,
        wrench_cmd,
        shared.wrench_internal,
        lyapunov,
        ref.sigma_min,
        J_inv_P,
    )


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
