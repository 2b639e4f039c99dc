"""Takes an arm along a motion of its joints, or brakes it, while it holds nothing; pure.

    τ = B (ddq_d − 2ω (dq − dq_d) − ω² e) + C dq + g + τ_friction(dq_d),   e = q − q_d, bounded by ±`soft_rad`

The arm alone: no share of any object is in it.  The bound on e is what makes it soft: whatever is in the way, the
joint pushes with no more than B ω² soft_rad beside what its own motion takes.
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from agent.control import errors as error_terms
from agent.control.joint_path import JointDesired
from agent.control.law import Offline, add_friction, add_sums
from agent.control.models import ArmModel
from agent.control.terms import CORIOLIS, DDQ_REF, DQ_REF, FRICTION, GRAVITY, INERTIA, Terms, no_terms
from agent.control.trajectory import at_rest
from drivers.interface import Vector

_UNKNOWN = (math.nan,) * 6


def torque(
    model: ArmModel,
    offline: Offline,
    q: Vector,
    dq: Vector,
    wanted: JointDesired,
    rate_rad_per_s: float,
    soft_rad: float,
) -> Terms:
    """One tick at this arm's (q, dq), each (n,); rate_rad_per_s: ω.

    The pose errors are those of the object that the arm would hold.  No wrench is known here: NaN.
    """
    x, y, z, qx, qy, qz, qw = pin.SE3ToXYZQUATtuple(model.object_pose(wanted.q))
    k = model.evaluate(q, dq)
    desired = at_rest((x, y, z), (qw, qx, qy, qz))
    e = error_terms.evaluate(k.p_object, k.quat_object, k.v_object, desired, offline.gains)
    off = np.clip(q - wanted.q, -soft_rad, soft_rad)
    joints = no_terms(model.n)
    joints[DQ_REF] = wanted.dq
    joints[DDQ_REF] = wanted.ddq - 2.0 * rate_rad_per_s * (dq - wanted.dq) - rate_rad_per_s**2 * off
    joints[INERTIA] = k.B.dot(joints[DDQ_REF])
    joints[CORIOLIS] = k.C.dot(dq)
    joints[GRAVITY] = k.g
    friction = offline.friction
    if friction is not None and not friction.sticks:
        joints[FRICTION] = friction.gliding(wanted.dq.tolist())
    tau = add_sums(joints)
    if friction is not None and friction.sticks:
        add_friction(joints, friction.torque(wanted.dq, dq, tau))
    return Terms(desired, k, e, joints, _UNKNOWN, _UNKNOWN, math.nan, math.nan, None)


def still(q: Vector) -> JointDesired:
    """At rest at q (n,)."""
    nothing = np.zeros_like(q)
    return JointDesired(q, nothing, nothing)
