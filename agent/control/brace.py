"""How an arm that holds the object keeps the others from carrying it on: a pull back, so that they notice.

An arm in HOLD is as soft as the others are, and of three and more the rest carries it on: the force between them grows
with the way since then, which of a slow motion takes long.  An arm that was following when it began to hold, and finds
the object carried on along the motion, therefore pulls it back, ever harder, as one whose joints are locked would.
With e_p its position error, d the direction of the motion when the hold began, and u what is usual of e_pᵀ d,

    Ḟ = min(RATE, GROWTH max(0, e_pᵀ d − u − SLACK)) − FADES F,   0 ≤ F ≤ limit,   u̇ = USUAL (e_pᵀ d − u),

is a force −F d on the object about its centre, beside what the law gives at the frozen pose.  Where all hold nothing is
carried on; what they come to rest by may make them pull for a moment.  Once the others have noticed, u follows and F
fades within a second or two, so that arms that disagree do not wind up: F grows to one side alone and fades slowly, and
so does not swing.  The state is part of `Memory`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from agent.control.against import STILL_M_PER_S
from agent.control.law import NO_WRENCH, Offline
from agent.control.quaternion import Quat, Vec3, rotate_back, to_matrix

SLACK_M: Final = 2e-4  # what observer and encoders make of a pose that stays
GROWTH_N_PER_S_M: Final = 6e4
RATE_N_PER_S: Final = 20.0
FADES_PER_S: Final = 2.0
USUAL_PER_S: Final = 2.0
BRACED: Final = 5  # numbers in the log field `memory`


class Braced(NamedTuple):
    """State between two ticks."""

    x: float = 0.0  # d, world axes; zero: an arm that was not following
    y: float = 0.0
    z: float = 0.0
    usual_m: float = 0.0  # u
    force_N: float = 0.0  # F

    @property
    def pull(self) -> Vec3:
        """−F d, N, world axes."""
        f = self.force_N
        return -f * self.x, -f * self.y, -f * self.z


NOT_BRACED: Final = Braced()


def braced_of(flat: Sequence[float]) -> Braced:
    """From the log field `memory`; nothing from a row of a log that is older than this."""
    return Braced(*flat[:BRACED])


def begun(v: Sequence[float], e_p: Vec3) -> Braced:
    """At the begin of a hold; v: desired twist (6,) that was followed, e_p: position error at it, world axes."""
    speed = math.hypot(*v[:3])
    if not speed > STILL_M_PER_S:
        return NOT_BRACED
    x, y, z = (component / speed for component in v[:3])
    return Braced(x, y, z, usual_m=e_p[0] * x + e_p[1] * y + e_p[2] * z)


def braced_with(offline: Offline, braced: Braced, quat: Quat) -> Offline:
    """The same with that pull beside what is wanted of the internal wrench; quat: attitude that is held."""
    px, py, pz = rotate_back(to_matrix(quat), braced.pull)
    x, y, z, a, b, c = offline.internal_wrench or NO_WRENCH
    return replace(offline, internal_wrench=(x + px, y + py, z + pz, a, b, c))


@dataclass(frozen=True, slots=True)
class Brace:
    """Limit of this pull for the arms of a cell."""

    period_s: float
    limit_N: float

    def advance(self, braced: Braced, e_p: Vec3) -> Braced:
        """State after a tick of a hold by the law; e_p: position error, world axes."""
        x, y, z, usual, force = braced
        if not (x or y or z):
            return braced
        T, ahead = self.period_s, e_p[0] * x + e_p[1] * y + e_p[2] * z - usual
        grows = min(RATE_N_PER_S, GROWTH_N_PER_S_M * max(0.0, ahead - SLACK_M))
        force = min(self.limit_N, force + T * (grows - FADES_PER_S * force))
        return Braced(x, y, z, usual + T * USUAL_PER_S * ahead, force)
