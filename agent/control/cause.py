"""What may be behind an unexpected wrench on an arm: told by the direction of its force, as far as that can tell.

The neighbours of a limp arm feel its weight; those of one that holds or is locked are pulled back against the motion;
an arm whose gripper lost the object lacks its share of the weight and feels a lift, and so may one whose neighbour lets
go of what both strained.  A hand can do all of that, and a limp arm also pulls aside, so what fits is named, the best
first, and no more is claimed.  Where a channel shows a moment and hardly any force, the force is that of the other one
where that is above its limit, too; else the moment may still be that of a weight on the far side of the object.

An arm whose reference jumps as the motion begins, because it sees the object elsewhere and follows no shift for it,
strikes itself (agent.verify.noticing).  Its own terms say how hard, which tells this from all else.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from agent.control.borne import NOT_BORNE
from agent.control.quaternion import cross
from agent.control.residual import Channels, Residual, Sense
from agent.control.terms import Terms
from drivers.interface import Vector

LEAST_COSINE: Final = 0.45  # between the force and a direction that it fits
STILL_M_PER_S: Final = 1e-3  # a motion slower than this has no direction
NO_FORCE: Final = 0.5  # of the channel's limit: a force below it is not what tripped
ASLANT: Final = 0.06  # cosine between the force and down, from which on it may be a weight that also turns
LEVER_M: Final = 1e-3  # a weight nearer to the object's centre than this turns nothing
BEGIN_S: Final = 0.02  # behind the start: before anybody's push is noticed
UNLIKE: Final = 0.5  # of the unexpected wrench, what may be left beside that of the jump


class Cause(enum.StrEnum):
    """In words for the person who has to look."""

    WEIGHT = "a neighbour is limp or let go of the object, or something presses down"
    BACK = "a neighbour holds or is locked, or something is in the way"
    LIFT = "this arm's gripper lost the object, a neighbour is limp or let go of it, or something lifts it"
    TWIST = "a neighbour or something else twists the object"
    PUSH = "a neighbour or something else pushes or pulls the object"
    BEGIN = "the motion does not begin where this arm sees the object, or not at rest"


def told(
    residual: Residual, sense: Sense, sensed: Sequence[float], terms: Terms, gravity: Sequence[float], t: float
) -> str:
    """What may be behind what made an arm hold, for a person.

    sensed: the unexpected wrench (6), N and N·m, sizes of its channels (4); terms: of the tick at t, s since the
    motion's begin; gravity: as for `causes`.
    """
    wrench, found, v = np.array(sensed[:6]), Channels(*sensed[6:]), terms.desired.v
    if 0.0 <= t < BEGIN_S and jumped(residual, wrench - sense.base, terms):
        return described((Cause.BEGIN,), found)
    if not residual.tripped(found, sense, wrench):
        weighs, drags = residual.weighed(sense), residual.dragged(sense)
        fits = behind((wrench - sense.base)[:3], v, gravity, weighs=weighs, drags=drags)
        return f"{described(fits, found)}, {felt(sense)}"
    x, y, z = gravity
    beyond = cross(terms.kinematics.p_ee_object, (x, y, z))
    return described(named(parts(residual, sense, wrench), v, gravity, beyond), found)


def jumped(residual: Residual, wrench: Vector, terms: Terms) -> bool:
    """Whether the sudden wrench (6,) is what the residual makes of a reference that jumped from rest to where it is."""
    if terms.J_inv_P is None:
        return False
    limits = np.repeat([residual.limits.fast_N, residual.limits.fast_Nm], 3)
    own = -residual.rate_per_s * terms.J_inv_P.T.dot(terms.kinematics.B.dot(terms.dq_ref))
    return bool(np.linalg.norm((wrench - own) / limits) <= UNLIKE * np.linalg.norm(wrench / limits))


def parts(residual: Residual, sense: Sense, wrench: Vector) -> list[tuple[Vector, float]]:
    """Fast and slow part (6,) of the wrench and the limit of its force, N; farthest above one of its limits first."""
    limits, (fast_N, fast_Nm, slow_N, slow_Nm) = residual.limits, residual.channels(sense, wrench)
    fast, slow = (wrench - sense.base, limits.fast_N), (sense.slow - sense.rest, limits.slow_N)
    quick = max(fast_N / limits.fast_N, fast_Nm / limits.fast_Nm)
    return [fast, slow] if quick >= max(slow_N / limits.slow_N, slow_Nm / limits.slow_Nm) else [slow, fast]


def named(
    found: Sequence[tuple[Vector, float]], v: Sequence[float], gravity: Sequence[float], beyond: Sequence[float]
) -> tuple[Cause, ...]:
    """What fits of both `parts`, the best first; a twist only where neither of them has a force worth naming.

    v, gravity: as for `causes`; beyond (3,): (p_O − p_E) × gravity, the way of the moment of a weight on the far side
    of the object.
    """
    (first, first_N), (other, other_N) = found
    fits, more = causes(first[:3], first_N, v, gravity), tuple[Cause, ...]()
    if float(np.linalg.norm(other[:3])) > other_N:
        more = causes(other[:3], other_N, v, gravity)
    turned = fits == (Cause.TWIST,)
    hangs = _cosine(first[3:], beyond, LEVER_M * math.hypot(*gravity)) >= LEAST_COSINE
    if turned and not more:
        return (Cause.WEIGHT, Cause.TWIST) if hangs else fits
    by_moment = float(np.linalg.norm(first[:3])) <= first_N and Cause.LIFT not in fits  # whose words name it
    if hangs and (by_moment or _cosine(first[:3], gravity, 0.0) >= ASLANT):
        more = (*more, Cause.WEIGHT)
    return tuple(dict.fromkeys(more if turned else (*fits, *(c for c in more if c is not Cause.PUSH))))


def causes(f: Vector, limit_N: float, v: Sequence[float], gravity: Sequence[float]) -> tuple[Cause, ...]:
    """What fits the unexpected force f (3,), the best first; never nothing.

    limit_N: of its channel; v: velocity of the desired motion, m/s; gravity: m/s²; all in world axes.
    """
    size = float(np.linalg.norm(f))
    if not size >= NO_FORCE * limit_N:
        return (Cause.TWIST,)
    down, along = _cosine(f, gravity, 0.0), _cosine(f, v[:3], STILL_M_PER_S)
    fits = {Cause.WEIGHT: down, Cause.BACK: -along, Cause.LIFT: -down}
    found = sorted((cause for cause, cosine in fits.items() if cosine >= LEAST_COSINE), key=lambda c: -fits[c])
    return tuple(found) or (Cause.PUSH,)


def behind(f: Vector, v: Sequence[float], gravity: Sequence[float], *, weighs: bool, drags: bool) -> tuple[Cause, ...]:
    """What fits where something pulls down (`weighs`), against the motion (`drags`), up, or strikes the object.

    The unexpected force f (3,) tells what else it may be.
    """
    found = tuple(c for c in causes(f, 0.0, v, gravity) if c is not Cause.PUSH)
    if weighs:
        found = (Cause.WEIGHT, *(c for c in found if c is not Cause.WEIGHT))
    if drags and Cause.BACK not in found:
        found = (*found, Cause.BACK)
    return found or (Cause.PUSH,)


def _cosine(f: Vector, direction: Sequence[float], least: float) -> float:
    """Of the angle between them; zero where the direction is no longer than `least`."""
    length, size = math.hypot(*direction), float(np.linalg.norm(f))
    return float(f @ np.array(direction)) / (size * length) if length > least and size > 0.0 else 0.0


def described(found: Sequence[Cause], x: Channels) -> str:
    """For the log and the operator."""
    sizes = f"{x.fast_N:.2g} N, {x.fast_Nm:.2g} N·m at once; {x.slow_N:.2g} N, {x.slow_Nm:.2g} N·m that stay"
    return f"{'; or '.join(found)} ({sizes})"


def felt(sense: Sense) -> str:
    """What arms of three and more feel beside it, for the same."""
    pull, knock_N = sense.pull, sense.struck.knock_N
    bears = ""
    if sense.borne != NOT_BORNE:
        bears = (
            f" ({sense.borne.load_N:.2g} N with what friction bears, {sense.borne.stuck_N:.2g} N of joints that stick)"
        )
    down = f"{pull.weight_N:.2g} N down{bears}"
    return f"{pull.level_N:.2g} N against the motion, {down}, {knock_N:.2g} N of a blow"
