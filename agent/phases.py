"""Torques of an arm on its way from rest to the object and back, by mode; pure.

Alone, the arm follows its joints (`agent.control.joint_track`).  Between that and the law of the object the torque
goes over by s(age / take_up_s) of the minimum-jerk law: in READY towards the law, in RELEASE back.
"""

from __future__ import annotations

from dataclasses import dataclass

from agent.control import joint_track
from agent.control.alignment import Shift
from agent.control.joint_path import JointDesired
from agent.control.joint_track import still
from agent.control.law import Offline
from agent.control.life import Life
from agent.control.memory import Memory
from agent.control.models import ArmModel
from agent.control.terms import Terms
from agent.control.trajectory import Desired
from agent.control.trajectory_rest import RestToRest, minimum_jerk
from agent.modes import Mode
from agent.safety import Limits
from drivers.interface import Vector

ALONE = frozenset({Mode.REST, Mode.APPROACH, Mode.GRASP, Mode.PARK, Mode.HALT})


@dataclass(frozen=True, slots=True)
class Session:
    """What an agent needs to go from its rest to the object and back."""

    life: Life
    limits: Limits  # while it holds nothing
    start_blend_s: float  # in which a motion that begins beside the start pose comes to its own


def wanted(life: Life, mode: Mode, memory: Memory, q: Vector) -> JointDesired:
    """What the joints are to do in a mode of `ALONE`; q (n,): where they are, for a tick that has nothing to hold."""
    q_from = q if memory.q_hold is None else memory.q_hold
    if mode is Mode.APPROACH:
        return life.journey(q_from, forward=True).at(memory.age)
    if mode is Mode.PARK:
        return life.journey(q_from, forward=False).at(memory.age)
    if mode is Mode.GRASP:
        return still(life.path.at(life.path.seconds).q)
    return still(q_from)


def alone(model: ArmModel, offline: Offline, life: Life, mode: Mode, memory: Memory, q: Vector, dq: Vector) -> Terms:
    """One tick at this arm's (q, dq), each (n,), in a mode of `ALONE`."""
    return _joints(model, offline, life, wanted(life, mode, memory, q), q, dq)


def off(life: Life, mode: Mode, memory: Memory, q: Vector) -> float:
    """How far the farthest joint at q (n,) is from where it should be, rad."""
    return float(abs(q - wanted(life, mode, memory, q).q).max())


def handing_over(life: Life, mode: Mode, memory: Memory) -> float:
    """The law's part of the torque: 1 but for an arm that takes its load up (READY) or gives it back (RELEASE)."""
    if mode is not Mode.READY and mode is not Mode.RELEASE:
        return 1.0
    s, _, _ = minimum_jerk(memory.age, life.take_up_s)
    return s if mode is Mode.READY else 1.0 - s


def handed_over(
    model: ArmModel, offline: Offline, life: Life, memory: Memory, part: float, law: Terms | None, q: Vector, dq: Vector
) -> Terms:
    """The torque between that of an arm that stands at `memory.q_hold` and that of the law, of which `part` counts."""
    q_hold = q if memory.q_hold is None else memory.q_hold
    standing = _joints(model, offline, life, still(q_hold), q, dq)
    if law is None:
        return standing
    joints = (1.0 - part) * standing.joints + part * law.joints
    return law._replace(joints=joints, J_inv_P=None)  # nothing can be sensed through the object yet


def lowering(life: Life, memory: Memory, place: Desired) -> Desired:
    """The way down in LOWER: from the pose that was held to `place`, by minimum jerk."""
    if memory.hold is None:
        return place
    p, quat = memory.hold[:3], memory.hold[3:]
    way = RestToRest(p, quat, place.p, place.quat, life.lower_s, 0.0, and_back=False)  # type: ignore[arg-type]
    return way.at(memory.age)


def blended(shift: Shift, t: float, period_s: float, blend_s: float) -> Shift:
    """The shift of the tick after one at t: it goes away by 1 − s(t / blend_s), whatever else acts on it."""
    if not 0.0 <= t < blend_s:
        return shift
    now, after = (1.0 - minimum_jerk(time, blend_s)[0] for time in (t, t + period_s))
    k = after / now if now > 0.0 else 0.0
    return (k * shift[0], k * shift[1], k * shift[2], k * shift[3], k * shift[4], k * shift[5])


def arrived(life: Life, mode: Mode, memory: Memory) -> bool:
    """Whether what the mode does by itself is done: the way gone, the load taken up, the object lowered."""
    q_hold, age = memory.q_hold, memory.age
    if mode is Mode.APPROACH or mode is Mode.PARK:
        return q_hold is not None and age >= life.journey(q_hold, forward=mode is Mode.APPROACH).seconds()
    if mode is Mode.READY or mode is Mode.RELEASE:
        return age >= life.take_up_s
    return mode is not Mode.LOWER or age >= life.lower_s


def _joints(model: ArmModel, offline: Offline, life: Life, to: JointDesired, q: Vector, dq: Vector) -> Terms:
    return joint_track.torque(model, offline, q, dq, to, life.rate_rad_per_s, life.soft_rad)
