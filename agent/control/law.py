"""What the control laws share: offline data of one agent, the terms of one tick, and the object's dynamics.

Everything here is a function of the agent's own (q, dq), the time and offline data, and changes no argument.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agent.control import errors as error_terms
from agent.control.adaptation import Adaptation
from agent.control.errors import Errors, Gains
from agent.control.friction import Friction
from agent.control.inverse import invert_jacobian
from agent.control.models import ArmModel, Kinematics, Matrix
from agent.control.posture import Posture
from agent.control.quaternion import Mat3, Vec3, rotate_through
from agent.control.terms import BY_WRENCHES, CMD, DDQ_REF, DQ_REF, FRICTION, JOINT_TERMS, LAW, SUMMANDS, SUMS, no_terms
from agent.control.trajectory import Desired, Vec6
from drivers.interface import Vector

NO_WRENCH: Vec6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_SUMS = np.array([[True, k != FRICTION] for k in range(len(JOINT_TERMS))[SUMMANDS]], dtype=np.float64).T.copy()


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


def object_wrench(offline: Offline, k: Kinematics, errors: Errors) -> Vec6:
    """M_O v̇_r + C_O v_r + g_O about the object's centre, world axes."""
    R, inertia, m, (gx, gy, gz) = k.R_world_object, offline.object_inertia, offline.object_mass_kg, offline.gravity
    _, _, _, wx, wy, wz = k.v_object
    _, _, _, ux, uy, uz = errors.v_ref
    ax, ay, az, bx, by, bz = errors.dv_ref
    hx, hy, hz = rotate_through(R, inertia, (ux, uy, uz))  # C_O = blockdiag(0, S(ω) I_O)
    nx, ny, nz = rotate_through(R, inertia, (bx, by, bz))
    return (  # eq:object dynamics
        m * (ax - gx),
        m * (ay - gy),
        m * (az - gz),
        nx + (wy * hz - wz * hy),
        ny + (wz * hx - wx * hz),
        nz + (wx * hy - wy * hx),
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
    fx, fy, fz, mx, my, mz = w
    x, y, z = k.p_ee_object
    return (fx, fy, fz, mx + (y * fz - z * fy), my + (z * fx - x * fz), mz + (x * fy - y * fx))  # eq:J_o_i_def


def reference(
    model: ArmModel, offline: Offline, q: Vector, dq: Vector, desired: Desired
) -> tuple[Kinematics, Errors, Matrix, float, Matrix, Matrix]:
    """dq_r = J⁻¹ v_r and ddq_r = J⁻¹ (v̇_r − J̇ dq_r) at this arm's (q, dq), each (n,), as the first rows of a block.

    Returns kinematics, errors, that block (agent.control.terms), the bound of the smallest singular value, J⁻¹ (n, m),
    and J⁻¹ P (n, 6), which gives the joint velocities of an object twist.  Raises SingularJacobian.
    """
    k = model.evaluate(q, dq)
    e = error_terms.evaluate(k.p_object, k.quat_object, k.v_object, desired, offline.gains)
    J_inv, sigma_min = invert_jacobian(k.J, k.B)
    joints = no_terms(model.n)
    v_ref, dv_ref = model.scratch.two(e.v_ref, e.dv_ref)
    if model.task_is_identity:
        J_inv_P = J_inv
    else:
        P = model.task_basis
        J_inv_P, dv_ref = J_inv.dot(P), P.dot(dv_ref)
    dq_ref = J_inv_P.dot(v_ref, joints[DQ_REF])  # eq:J_o_i at the reference
    J_inv.dot(dv_ref - k.dJ.dot(dq_ref), joints[DDQ_REF])  # eq:J_o_i_dot at the reference
    return k, e, joints, sigma_min, J_inv, J_inv_P


def add_wrenches(model: ArmModel, offline: Offline, k: Kinematics, e: Errors, load: Vec6, joints: Matrix) -> Vec6:
    """Torques of −k_v e_v − c_i e, of this arm's share of the object's wrench (`load`), and of f_int,i, into a block.

    All about the object's centre, world axes; returns f_int,i at the end effector.
    """
    c, wanted = offline.load_share, offline.internal_wrench
    (kx, ky, kz, ka, kb, kc), (vx, vy, vz, wx, wy, wz), (x, y, z, rx, ry, rz) = offline.gains.k_v, e.e_v, e.e
    feedback = (
        -kx * vx - c * x,
        -ky * vy - c * y,
        -kz * vz - c * z,
        -ka * wx - c * rx,
        -kb * wy - c * ry,
        -kc * wz - c * rz,
    )
    internal = NO_WRENCH if wanted is None else rotate_wrench(k.R_world_object, wanted)
    model.scratch.three(feedback, load, internal).dot(k.J6, joints[BY_WRENCHES])
    return NO_WRENCH if wanted is None else shift_to_ee(k, internal)


def add_sums(joints: Matrix) -> Vector:
    """Sums of the torques of a block as its last rows; returns the law's own, which friction feed-forward is not in."""
    _SUMS.dot(joints[SUMMANDS], joints[SUMS])
    tau_law: Vector = joints[LAW]
    return tau_law


def add_friction(joints: Matrix, tau: Vector) -> None:
    """Torques (n,) of joint friction that depends on the law's own torque, into a block that has its sums already."""
    joints[FRICTION] = tau
    joints[CMD] += joints[FRICTION]


def wrench_at_ee(k: Kinematics, J_inv_P: Matrix, tau_law: Vector) -> Vec6:
    """u_i: what the law asks of the object side; friction feed-forward is spent inside the joints."""
    return shift_to_ee(k, tau_law.dot(J_inv_P).tolist())


def lyapunov_share(offline: Offline, k: Kinematics, errors: Errors, dq_error: Vector) -> float:
    """This agent's part of the paper's V, such that the parts of all agents sum to V.

    c_i (½‖e_p‖² + 1 − e_η²) + ½ (dq − dq_r)ᵀ B (dq − dq_r) + ½ c_i e_vᵀ M_O e_v.
    """
    (x, y, z), e_eta, (vx, vy, vz, wx, wy, wz) = errors.e_p, errors.e_eta, errors.e_v
    hx, hy, hz = rotate_through(k.R_world_object, offline.object_inertia, (wx, wy, wz))
    kinetic = offline.object_mass_kg * (vx * vx + vy * vy + vz * vz) + wx * hx + wy * hy + wz * hz
    pose = 0.5 * (x * x + y * y + z * z) + 1.0 - e_eta * e_eta
    return offline.load_share * (pose + 0.5 * kinetic) + 0.5 * float(dq_error.dot(k.B.dot(dq_error)))
