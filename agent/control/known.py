"""The paper's non-adaptive law in joint space, with one small inverse per tick.

    dq_r = J⁻¹ v_r,   ddq_r = J⁻¹ (v̇_r − J̇ dq_r)
    τ = B ddq_r + C dq_r + g + Jᵀ( −k_v e_v − c_i e + c_i (M_O v̇_r + C_O v_r + g_O) ) + τ_int + τ_friction

J is the Jacobian of the object frame (see agent.control.models), so this is the paper's task-space form
u_i mapped by J_Eᵀ; the tests compare the two to 1e-9.
"""

from __future__ import annotations

from agent.control.law import (
    Offline,
    add_friction,
    add_sums,
    add_wrenches,
    lyapunov_share,
    object_wrench,
    reference,
    wrench_at_ee,
)
from agent.control.models import ArmModel
from agent.control.terms import CORIOLIS, DDQ_REF, DQ_REF, FRICTION, GRAVITY, INERTIA, POSTURE, Terms
from agent.control.trajectory import Desired
from drivers.interface import Vector


def torque(
    model: ArmModel, offline: Offline, q: Vector, dq: Vector, desired: Desired, friction_factor: float = 1.0
) -> Terms:
    """One tick of the law at this arm's (q, dq), each (n,).  Raises SingularJacobian.

    friction_factor: of the feed-forward (agent.control.friction_factor).
    """
    k, e, joints, sigma_min, J_inv, J_inv_P = reference(model, offline, q, dq, desired)
    dq_ref, ddq_ref = joints[DQ_REF], joints[DDQ_REF]
    c, f = offline.load_share, object_wrench(offline, k, e)
    load = (c * f[0], c * f[1], c * f[2], c * f[3], c * f[4], c * f[5])
    k.B.dot(ddq_ref, joints[INERTIA])  # eq:manipulator dynamics at the reference, into the block
    k.C.dot(dq_ref, joints[CORIOLIS])  # eq:manipulator dynamics
    joints[GRAVITY] = k.g  # eq:manipulator dynamics
    wrench_internal = add_wrenches(model, offline, k, e, load, joints)
    friction = offline.friction
    if friction is not None and not friction.sticks:
        joints[FRICTION] = friction.gliding(dq_ref.tolist(), friction_factor)
    if offline.posture is not None:
        joints[POSTURE] = offline.posture.torque(q, dq, k.J, J_inv)
    tau_law = add_sums(joints)  # eq:control law
    if friction is not None and friction.sticks:
        add_friction(joints, friction.torque(dq_ref, dq, tau_law, friction_factor))
    return Terms(
        desired,
        k,
        e,
        joints,
        wrench_at_ee(k, J_inv_P, tau_law),
        wrench_internal,
        lyapunov_share(offline, k, e, dq - dq_ref),
        sigma_min,
        J_inv_P,
    )
