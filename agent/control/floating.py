"""Torques of an arm that a hand guides: its weight and part of its friction are carried, its motion is damped; pure.

    τ = λ (g + c_i Jᵀ g_O) + f(dq) − r(‖dq‖) B dq + wall(q, dq)

λ rises from 0 to 1 when the arm begins to float and falls when it is to sink.  f is below the Coulomb friction that
there is, whatever the sampling, so that it never moves a joint that rests.  r grows with the fastest joint from `drag`
to `brake`; when torques reach their bounds the whole damping is scaled, so it still takes energy out.  A wall acts
from `wall_rad` before a joint's limit on, or from where the joint began if that is nearer: it pushes back no farther.
Without a hand nothing but an error of the weight moves the arm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from agent.control import errors as error_terms
from agent.control.law import Offline, add_friction, add_sums, object_wrench
from agent.control.models import ArmModel, Kinematics, Matrix
from agent.control.terms import FEEDBACK, GRAVITY, OBJECT, Terms, no_terms
from agent.control.trajectory import STILL, at_rest
from agent.control.trajectory_rest import minimum_jerk
from drivers.interface import Vector

_UNKNOWN = (math.nan,) * 6
BEGIN_RAD_PER_S = 0.15  # below it no friction is compensated: what an error of the weight drives stays slow
FULL_RAD_PER_S = 0.4  # from here on all of the share is
RESIST_SHARE = 0.5  # of the largest speed, from which on the damping grows


@dataclass(frozen=True, slots=True)
class Floating:
    """What is carried, and how the arm is damped; arrays (n,), controlled joints."""

    low_rad: Vector  # limits of the joints
    high_rad: Vector
    tau_max_Nm: Vector
    friction_Nm: Vector  # that is compensated
    speed_max_rad_per_s: float
    drag_per_s: float  # times the arm's inertia
    brake_per_s: float  # the same from the largest speed on
    take_up_s: float = 0.05  # in which the weight is taken up
    wall_rad: float = 0.1
    wall_per_s: float = 20.0  # how stiff a wall is, times the inertia that the joint feels
    stand_per_s: float = 8.0
    stand_reach_rad: float = 0.1  # a joint that is pushed farther is pulled back no harder
    sink_s: float = 3.0  # in which the weight is let go
    sink_rad_per_s: float = 0.5  # at which all of it would be carried again

    def came_to_rest(self, q: Vector, dq: Vector) -> Vector:
        """Where joints at q that move with dq, each (n,), come to rest when the arm is to stand."""
        return q + dq / self.stand_per_s


def afloat(
    model: ArmModel, offline: Offline, floating: Floating, age: float, q_begun: Vector | None, q: Vector, dq: Vector
) -> Terms:
    """One tick at (q, dq), each (n,); age: s since it began to float, at q_begun (n,)."""
    k = model.evaluate(q, dq)
    wall = walls(floating, k.B, q if q_begun is None else q_begun, q, dq)
    carried, _, _ = minimum_jerk(age, floating.take_up_s)
    rate = damping(floating, floating.drag_per_s, dq)
    return _terms(model, offline, floating, k, dq, carried, rate, wall, friction(floating, dq))


def sinking(model: ArmModel, offline: Offline, floating: Floating, age: float, q: Vector, dq: Vector) -> Terms:
    """One tick of the way down, age s after it began: the faster a joint is, the more of the weight is carried."""
    gone, _, _ = minimum_jerk(age, floating.sink_s)
    slow = max(0.0, 1.0 - float(abs(dq).max()) / floating.sink_rad_per_s)
    k, nothing = model.evaluate(q, dq), np.zeros_like(q)
    return _terms(model, offline, floating, k, dq, 1.0 - gone * slow, floating.brake_per_s, nothing, nothing)


def standing(
    model: ArmModel, offline: Offline, floating: Floating, q_hold: Vector | None, q: Vector, dq: Vector
) -> Terms:
    """One tick of an arm that was stopped and stands at q_hold (n,), giving way to a hand that pushes harder."""
    k, w, reach = model.evaluate(q, dq), floating.stand_per_s, floating.stand_reach_rad
    away = np.zeros_like(q) if q_hold is None else (q - q_hold).clip(-reach, reach)
    rate = damping(floating, 2.0 * w, dq)
    return _terms(model, offline, floating, k, dq, 1.0, rate, -w * w * k.B.dot(away), np.zeros_like(q))


def damping(floating: Floating, least_per_s: float, dq: Vector) -> float:
    """What the inertia is damped with at joint velocities dq (n,), 1/s."""
    x = float(abs(dq).max()) / floating.speed_max_rad_per_s
    grown, _, _ = minimum_jerk(x - RESIST_SHARE, 1.0 - RESIST_SHARE)
    return least_per_s + grown * max(0.0, floating.brake_per_s - least_per_s)


def friction(floating: Floating, dq: Vector) -> Vector:
    """Torque (n,) along the motion at dq (n,); at rest none, and never more than `friction_Nm`."""
    width = FULL_RAD_PER_S - BEGIN_RAD_PER_S
    shares = [math.copysign(minimum_jerk(abs(v) - BEGIN_RAD_PER_S, width)[0], v) for v in dq.tolist()]
    carried: Vector = floating.friction_Nm * shares
    return carried


def walls(floating: Floating, B: Matrix, q_begun: Vector, q: Vector, dq: Vector) -> Vector:
    """Torque (n,) away from the limits: stiff into the wall, and damped on the way in."""
    below = np.minimum(floating.low_rad + floating.wall_rad, q_begun) - q
    above = q - np.maximum(floating.high_rad - floating.wall_rad, q_begun)
    if below.max() <= 0.0 and above.max() <= 0.0:
        return np.zeros_like(q)
    w, felt = floating.wall_per_s, 1.0 / np.diag(np.linalg.inv(B))
    deep = np.maximum(below, 0.0) - np.maximum(above, 0.0)
    inwards = np.where(deep * dq < 0.0, dq, 0.0)
    pushed: Vector = felt * (w * w * deep - 2.0 * w * inwards)
    return pushed


def _terms(
    model: ArmModel, offline: Offline, floating: Floating, k: Kinematics, dq: Vector, carried: float, rate: float,
    push: Vector, along: Vector,
) -> Terms:  # fmt: skip
    """The sum: `carried` of the weight, damping with `rate`, a push that is no damping, and `along` the motion."""
    desired = at_rest(k.p_object, k.quat_object)  # wherever it is, it is right
    e = error_terms.evaluate(k.p_object, k.quat_object, k.v_object, desired, offline.gains)
    load = object_wrench(offline, k, e._replace(v_ref=STILL, dv_ref=STILL))
    joints = no_terms(model.n)
    joints[GRAVITY] = carried * k.g
    joints[OBJECT] = k.Jt.dot([carried * offline.load_share * f for f in load])
    drag = -rate * k.B.dot(dq)
    rest = joints[GRAVITY] + joints[OBJECT] + along + push
    drag *= room(rest, drag, floating.tau_max_Nm)
    joints[FEEDBACK] = drag + push
    add_sums(joints)
    add_friction(joints, along)  # ddq_ref stays zero: what the hand does next is not known, and the observer asks
    return Terms(desired, k, e, joints, _UNKNOWN, _UNKNOWN, math.nan, math.nan, None)


def room(rest: Vector, more: Vector, tau_max: Vector) -> float:
    """The largest part of `more`, at most all, that keeps rest + part · more within ± tau_max; arrays (n,)."""
    part = 1.0
    for there, wanted, bound in zip(rest.tolist(), more.tolist(), tau_max.tolist(), strict=True):
        if abs(there + wanted) > bound and wanted:
            part = min(part, max(0.0, (math.copysign(bound, wanted) - there) / wanted))
    return part
