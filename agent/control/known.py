"""The non-adaptive law (`eq:control law`) in joint space; pure, one small inverse per tick.

    dq_r = J⁻¹ v_r,   ddq_r = J⁻¹ (v̇_r − J̇ dq_r)
    τ = B ddq_r + C dq_r + g + Jᵀ( −k_v e_v − c_i e + c_i (M_O v̇_r + C_O v_r + g_O) ) + τ_int + τ_friction

J is the Jacobian of the object frame (see agent.control.models), so this is the paper's task-space form
u_i mapped by J_Eᵀ; the tests compare the two to 1e-9.
"""

from __future__ import annotations

from agent.control.law import (
    Offline,
    Terms,
    add_extra,
    feedback_torque,
    lyapunov_share,
    object_wrench,
    reference,
    shift_to_ee,
)
from agent.control.models import ArmModel
from agent.control.trajectory import Desired
from drivers.interface import Vector


def torque(model: ArmModel, offline: Offline, q: Vector, dq: Vector, desired: Desired) -> Terms:
    """One tick of the law at this arm's (q, dq), each (n,).  Raises SingularJacobian."""
    k, e, J_inv, J_inv_P, dq_ref, ddq_ref, sigma_min = reference(model, offline, q, dq, desired)
    share = [offline.load_share * f for f in object_wrench(offline, k, e)]
    tau_inertia = k.B.dot(ddq_ref)
    tau_coriolis = k.C.dot(dq_ref)
    tau_feedback = feedback_torque(offline, k, e)
    tau_object = k.Jt.dot(share)
    tau_law = tau_inertia + tau_coriolis + k.g + tau_feedback + tau_object
    extra = add_extra(tau_law, offline, k, q, dq, J_inv)
    # u_i: what the law asks of the object side; friction feed-forward is spent inside the joints
    u_object = J_inv_P.T.dot(tau_law).tolist()
    tau_cmd, tau_friction = tau_law, None
    if offline.friction is not None:
        tau_friction = offline.friction.torque(dq_ref)
        tau_cmd = tau_law + tau_friction
    return Terms(
        desired=desired,
        kinematics=k,
        errors=e,
        dq_ref=dq_ref,
        ddq_ref=ddq_ref,
        tau_inertia=tau_inertia,
        tau_coriolis=tau_coriolis,
        tau_gravity=k.g,
        tau_adaptive=None,
        tau_feedback=tau_feedback,
        tau_object=tau_object,
        tau_internal=extra.tau_internal,
        tau_friction=tau_friction,
        tau_posture=extra.tau_posture,
        tau_cmd=tau_cmd,
        wrench_cmd=shift_to_ee(k, u_object),
        wrench_internal=extra.wrench_internal,
        lyapunov=lyapunov_share(offline, k, e, dq - dq_ref),
        sigma_min=sigma_min,
    )
