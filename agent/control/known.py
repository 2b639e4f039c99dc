"""The paper's non-adaptive law in joint space, with one small inverse per tick.

    dq_r = J⁻¹ v_r,   ddq_r = J⁻¹ (v̇_r − J̇ dq_r)
    τ = B ddq_r + C dq_r + g + Jᵀ( −k_v e_v − c_i e + c_i (M_O v̇_r + C_O v_r + g_O) ) + τ_int + τ_friction

J is the Jacobian of the object frame (see agent.control.models), so this is the paper's task-space form
u_i mapped by J_Eᵀ; the tests compare the two to 1e-9.
"""

from __future__ import annotations

from agent.control.law import (
    Offline,
    Terms,
    assemble,
    law_torque,
    lyapunov_share,
    object_wrench,
    reference,
    shared_torques,
    wrench_at_ee,
)
from agent.control.models import ArmModel
from agent.control.trajectory import Desired
from drivers.interface import Vector


def torque(model: ArmModel, offline: Offline, q: Vector, dq: Vector, desired: Desired) -> Terms:
    """One tick of the law at this arm's (q, dq), each (n,).  Raises SingularJacobian."""
    ref, J_inv, J_inv_P = reference(model, offline, q, dq, desired)
    k, e, dq_ref, ddq_ref, _ = ref
    c, f = offline.load_share, object_wrench(offline, k, e)
    load = (c * f[0], c * f[1], c * f[2], c * f[3], c * f[4], c * f[5])
    tau_posture = None if offline.posture is None else offline.posture.torque(q, dq, k.J, J_inv)
    shared = shared_torques(offline, k, e, load, tau_posture)
    tau_inertia, tau_coriolis = k.B.dot(ddq_ref), k.C.dot(dq_ref)  # eq:manipulator dynamics at the reference, and k.g
    tau_law = law_torque(tau_inertia + tau_coriolis + k.g, shared)  # eq:control law
    tau_cmd, tau_friction = tau_law, None
    if offline.friction is not None:
        tau_friction = offline.friction.torque(dq_ref, dq, tau_law)
        tau_cmd = tau_law + tau_friction
    return assemble(
        desired,
        ref,
        (tau_inertia, tau_coriolis, k.g, None),
        shared,
        tau_friction,
        tau_cmd,
        wrench_at_ee(k, J_inv_P, tau_law),
        lyapunov_share(offline, k, e, dq - dq_ref),
        J_inv_P,
    )
