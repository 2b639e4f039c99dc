"""Holds an arm at joint angles, for poses where the object Jacobian has no safe inverse; pure.

    τ = B (−2ω dq − ω² (q − q_hold)) + C dq + g + c_i Jᵀ g_O

Both laws divide by the Jacobian, and near a singular pose that turns millimetres into turns of a joint.  Here only its
transpose is left, the arm's share of the object's weight.  With an exact model each joint error falls as a critically
damped second-order system; B, C and g are those of the described arm under both laws.
"""

from __future__ import annotations

import math

from agent.control import errors as error_terms
from agent.control.inverse import SingularJacobian, invert_jacobian
from agent.control.law import Offline, add_sums, object_wrench
from agent.control.models import ArmModel
from agent.control.terms import CORIOLIS, DDQ_REF, GRAVITY, INERTIA, OBJECT, Terms, no_terms
from agent.control.trajectory import STILL, at_rest
from drivers.interface import Vector

_UNKNOWN = (math.nan,) * 6


def sigma_min(model: ArmModel, q: Vector) -> float:
    """Lower bound of the smallest singular value of the object Jacobian at q (n,); 0 where it has no inverse."""
    try:
        return invert_jacobian(model.jacobian(q), model.inertia(q))[1]
    except SingularJacobian:
        return 0.0


def weight(model: ArmModel, offline: Offline, q: Vector, *, carries: bool) -> Vector:
    """(n,) g + c_i Jᵀ g_O at q (n,): what keeps an arm there that nobody sees, as far as the model is right.

    carries: whether it has its part of the object; else g alone.
    """
    k = model.evaluate(q, 0.0 * q)
    if not carries:
        return k.g
    carried, (gx, gy, gz) = -offline.load_share * offline.object_mass_kg, offline.gravity
    tau: Vector = k.g + k.Jt.dot([carried * gx, carried * gy, carried * gz, 0.0, 0.0, 0.0])
    return tau


def torque(
    model: ArmModel,
    offline: Offline,
    q: Vector,
    dq: Vector,
    q_hold: Vector,
    rate_rad_per_s: float,
    reach_rad: float = math.inf,
) -> Terms:
    """One tick at this arm's (q, dq), each (n,), to stay at q_hold (n,).

    rate_rad_per_s: ω; reach_rad: a joint farther from q_hold is pulled as one that is so far from it.  The errors
    are those to the object's pose at q_hold.  The wrench at the end effector is not known here: NaN.
    """
    held = model.evaluate(q_hold, 0.0 * q_hold)
    k = model.evaluate(q, dq)
    desired = at_rest(held.p_object, held.quat_object)
    e = error_terms.evaluate(k.p_object, k.quat_object, k.v_object, desired, offline.gains)
    still = e._replace(v_ref=STILL, dv_ref=STILL)
    joints = no_terms(model.n)
    joints[DDQ_REF] = -2.0 * rate_rad_per_s * dq - rate_rad_per_s**2 * (q - q_hold).clip(-reach_rad, reach_rad)
    joints[INERTIA] = k.B.dot(joints[DDQ_REF])
    joints[CORIOLIS] = k.C.dot(dq)
    joints[GRAVITY] = k.g
    joints[OBJECT] = k.Jt.dot([offline.load_share * f for f in object_wrench(offline, k, still)])
    add_sums(joints)
    return Terms(desired, k, e, joints, _UNKNOWN, _UNKNOWN, math.nan, sigma_min(model, q), None)
