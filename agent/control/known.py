"""The non-adaptive law (`eq:control law`) in joint space; pure, one small inverse per tick.

    dq_r = J⁻¹ v_r,   ddq_r = J⁻¹ (v̇_r − J̇ dq_r)
    τ = B ddq_r + C dq_r + g + Jᵀ( −k_v e_v − c_i e + c_i (M_O v̇_r + C_O v_r + g_O) ) + τ_int + τ_friction

J is the Jacobian of the object frame (see agent.control.models), so this is the paper's task-space form
u_i mapped by J_Eᵀ; the tests compare the two to 1e-9.
"""

from __future__ import annotations

from agent.control import errors as error_terms
from agent.control.inverse import invert_jacobian
from agent.control.law import Offline, Terms, extra_torques, lyapunov_share, object_wrench, shift_to_ee
from agent.control.models import ArmModel
from agent.control.trajectory import Desired
from drivers.interface import Vector


def torque(model: ArmModel, offline: Offline, q: Vector, dq: Vector, desired: Desired) -> Terms:
    """One tick of the law at this arm's (q, dq), each (n,).  Raises SingularJacobian."""
    k = model.evaluate(q, dq)
    e = error_terms.evaluate(k.p_object, k.quat_object, k.v_object, desired, offline.gains)
    J_inv, sigma_min = invert_jacobian(k.J, k.B)
    J_inv_P = J_inv.dot(model.task_basis)  # joint velocities of an object twist
    dq_ref = J_inv_P.dot(e.v_ref)
    ddq_ref = J_inv_P.dot(e.dv_ref) - J_inv.dot(k.dJ.dot(dq_ref))

    c, k_v, e_v, e_pose = offline.load_share, offline.gains.k_v, e.e_v, e.e
    feedback = [-k * v - c * x for k, v, x in zip(k_v, e_v, e_pose, strict=True)]
    share = [c * f for f in object_wrench(offline, k, e)]
    tau_inertia = k.B.dot(ddq_ref)
    tau_coriolis = k.C.dot(dq_ref)
    tau_feedback = k.Jt.dot(feedback)
    tau_object = k.Jt.dot(share)
    tau_law = tau_inertia + tau_coriolis + k.g + tau_feedback + tau_object
    extra = extra_torques(offline, k, q, dq, J_inv)
    if extra.tau_internal is not None:
        tau_law += extra.tau_internal
    if extra.tau_posture is not None:
        tau_law += extra.tau_posture
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
