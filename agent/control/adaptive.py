"""The paper's adaptive law in joint space; its torque depends on estimates, not on the masses of arm or object.

    τ   = Y_q(q, dq, dq_r, ddq_r) θ̂_i + Jᵀ( −k_v e_v − c_i e + c_i Y_O θ̂_O ) + τ_int
    θ̂̇_i = −γ_i Y_qᵀ (dq − dq_r),   θ̂̇_O = −γ_O c_i Y_Oᵀ e_v

because Y_iᵀ e_v = Y_qᵀ J⁻¹ e_v = Y_qᵀ (dq − dq_r).  J is the Jacobian of the object frame, as in
agent.control.known.  Y_q has six more columns per joint than the inertial ones: reflected rotor inertia (ddq_r),
viscous friction (dq_r), Coulomb friction (a smooth sign of dq_r), and that sign times what is left of breakaway, the
motor's torque, and both; all but the first make `tau_friction`.  The motor's torque is the one that is sent.
"""

from __future__ import annotations

import numpy as np

from agent.control.adaptation import JOINT_PARAMETERS, Adaptation, Estimate, Gradient, divided
from agent.control.friction import sticking_columns
from agent.control.law import (
    Offline,
    add_friction,
    add_sums,
    add_wrenches,
    lyapunov_share,
    reference,
    rotate_wrench,
    rotate_wrench_back,
    wrench_at_ee,
)
from agent.control.models import ArmModel, Matrix
from agent.control.quaternion import Mat3
from agent.control.regressor import BODY_PARAMETERS, joint_regressor, object_regressor
from agent.control.terms import ADAPTIVE, DDQ_REF, DQ_REF, LAW, POSTURE, Terms
from agent.control.trajectory import Desired, Vec6
from drivers.interface import Vector


def torque(
    model: ArmModel,
    offline: Offline,
    adaptation: Adaptation,
    estimate: Estimate,
    q: Vector,
    dq: Vector,
    desired: Desired,
) -> tuple[Terms, Gradient]:
    """One tick of the law at this arm's (q, dq), each (n,), with the estimate of before this tick.

    The second result is what `Adaptation.advance` takes.  Raises SingularJacobian.
    """
    k, e, joints, sigma_min, J_inv, J_inv_P = reference(model, offline, q, dq, desired)
    dq_ref, ddq_ref = joints[DQ_REF], joints[DDQ_REF]
    dq_error = dq - dq_ref

    n = model.n
    inertial, of_joints = BODY_PARAMETERS * n, estimate.arm[BODY_PARAMETERS * n :].reshape(JOINT_PARAMETERS, n)
    Y = joint_regressor(model, q, dq, dq_ref, ddq_ref)
    joints[ADAPTIVE] = Y.dot(estimate.arm[:inertial]) + of_joints[0] * ddq_ref

    c, e_v, P = offline.load_share, e.e_v, model.task_basis
    R = k.R_world_object
    Y_object = _object_regressor(offline, R, k.v_object, e.v_ref, e.dv_ref)
    load = rotate_wrench(R, (c * Y_object.dot(estimate.object)).tolist())
    # only what lies in the task space does work on this arm's side
    e_v_task = e_v if len(P) == 6 else P.T.dot(P.dot(e_v)).tolist()
    e_v_object = rotate_wrench_back(R, e_v_task)

    wrench_internal = add_wrenches(model, offline, k, e, load, joints)
    if offline.posture is not None:
        joints[POSTURE] = offline.posture.torque(q, dq, k.J, J_inv)
    tau_law = add_sums(joints)  # eq:adaptive control vector form
    arm_gradient, object_gradient = divided(np.zeros(len(estimate.arm) + BODY_PARAMETERS))
    by_joint = arm_gradient[inertial:].reshape(JOINT_PARAMETERS, n)
    _fill_joint_columns(by_joint, adaptation, of_joints, joints, dq)
    if adaptation.friction:
        tau_friction = of_joints[1] * by_joint[1] + of_joints[2] * by_joint[2]
        if adaptation.sticking:
            tau_friction += (of_joints[3:] * by_joint[3:]).sum(axis=0)
        add_friction(joints, tau_friction)
    by_joint *= dq_error
    dq_error.dot(Y, arm_gradient[:inertial])  # eq:adaptation laws, into the gradient
    np.multiply(c, np.dot(e_v_object, Y_object), object_gradient)  # eq:adaptation laws
    terms = Terms(
        desired,
        k,
        e,
        joints,
        wrench_at_ee(k, J_inv_P, tau_law),
        wrench_internal,
        lyapunov_share(offline, k, e, dq_error) + adaptation.parameter_error(estimate),
        sigma_min,
        J_inv_P,
    )
    return terms, Gradient(arm_gradient, object_gradient)


def _fill_joint_columns(columns: Matrix, adaptation: Adaptation, of_joints: Matrix, joints: Matrix, dq: Vector) -> None:
    """Into zeros (6, n): of rotor inertia, viscous and Coulomb friction, breakaway, load and breakaway load.

    of_joints (6, n): their estimates; joints: the block of this tick with its sums.
    """
    dq_ref = columns[1] = joints[DQ_REF]
    columns[0] = joints[DDQ_REF]
    sign = columns[2] = np.tanh(dq_ref / adaptation.smooth_rad_per_s)
    if adaptation.sticking:
        tau_rest = joints[LAW] + of_joints[1] * dq_ref
        columns[3:] = sticking_columns(adaptation.sticking, of_joints[2:], sign, dq, tau_rest)


def _object_regressor(offline: Offline, R: Mat3, v: Vec6, v_ref: Vec6, dv_ref: Vec6) -> Matrix:
    """Y_O (6, 10) in object axes from world axes."""
    g = offline.gravity
    x, y, z, wx, wy, wz = dv_ref
    v, v_ref = rotate_wrench_back(R, v), rotate_wrench_back(R, v_ref)
    a = rotate_wrench_back(R, (x - g[0], y - g[1], z - g[2], wx, wy, wz))
    return object_regressor(v[:3], v[3:], v_ref[:3], v_ref[3:], a[:3], a[3:])
