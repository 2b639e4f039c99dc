"""What pulls an arm down where the friction feed-forward bears it: a load that the unexpected wrench does not show.

The feed-forward goes by dq_r (agent.control.friction), which an error of a tenth of a millimetre turns round: joints
that go down with a heavier object are pushed up by as much as their friction, and rub as much themselves.  The residual
takes the feed-forward for spent on that friction, so of a limp neighbour that three and more arms hold on to, twice
their joints' friction is hidden from it.  What is spent beside the friction of the speed that there is,

    h = −ĝᵀ J⁻ᵀ (clip(τ_friction(dq_r), ±|τ_friction(dq)|) − τ_friction(dq)),   ĝ gravity's direction,

without its own slow part and together with the force down (agent.control.against), low-passed, is the load.  Of a
joint that sticks nobody knows what it bears, up to all of its friction: it counts as nothing, and so does what the
feed-forward has beyond the friction of a slow joint.  Without the clip h has that, too: the load with joints that
stick, whose limit is what all joints' friction makes along gravity, beside a touch.  It alone finds a limp neighbour in
slow motions.  Neither is as exact as the force alone, for friction is what is known least; they find what that misses.
The state is part of `Memory`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from agent.control.friction import Friction
from agent.control.models import Matrix
from drivers.interface import Vector

USUAL_PER_S: Final = 0.5
LOAD_PER_S: Final = 15.0
BORNE: Final = 4  # numbers in the log field `memory`
BORNE_OF_OLD: Final = 2  # in logs from before joints that stick had a count of their own
LOAD_AT, STUCK_AT = 134, 136  # places of `load_N` and `stuck_N` there


class Borne(NamedTuple):
    """State between two ticks."""

    usual_N: float = 0.0  # of h, its slow part
    load_N: float = 0.0  # what hangs on this arm with friction of joints that move, low-passed
    usual_stuck_N: float = 0.0  # of h with joints that stick, its slow part
    stuck_N: float = 0.0  # what hangs on this arm with them, low-passed


NOT_BORNE: Final = Borne()


def borne_of(flat: Sequence[float]) -> Borne:
    """From the log field `memory`; nothing from a row of a log that is older than this sense."""
    return Borne(*flat[:BORNE])


@dataclass(frozen=True, slots=True)
class Bearing:
    """Friction and limit of this sense for one arm of a cell."""

    period_s: float
    limit_N: float  # of the load
    stuck_limit_N: float  # of that with joints that stick
    friction: Friction  # of the feed-forward, of joints that do not stick
    down: tuple[float, float, float]  # gravity's direction, world axes

    def advance(
        self, borne: Borne, weight_N: float, J_inv_P: Matrix, tau_friction: Vector, dq: Vector, factor: float = 1.0,
        *, ready: bool,
    ) -> Borne:  # fmt: skip
        """State after a tick; ready: before the start, when nothing but what is usual is learnt.

        weight_N: the force down beside it; J_inv_P: (n, 6) joint velocities of an object twist; tau_friction: the
        feed-forward at dq_r (n,); dq: joint velocities (n,); factor: of friction, as the feed-forward has it.
        """
        rubs = self.friction.gliding(dq.tolist(), factor)
        most = np.abs(rubs)
        moving = np.minimum(np.maximum(tau_friction, -most), most)
        per_joint = -J_inv_P[:, :3].dot(self.down)  # (n,) N of a force up, of a torque
        beside = per_joint.dot(moving - rubs) - borne.usual_N
        beside_stuck = per_joint.dot(tau_friction - rubs) - borne.usual_stuck_N
        slow, gain = self.period_s * USUAL_PER_S, self.period_s * LOAD_PER_S
        usual_N, usual_stuck_N = borne.usual_N + slow * beside, borne.usual_stuck_N + slow * beside_stuck
        if ready:
            return Borne(float(usual_N), 0.0, float(usual_stuck_N), 0.0)
        load_N = borne.load_N + gain * (weight_N + beside - borne.load_N)
        stuck_N = borne.stuck_N + gain * (weight_N + beside_stuck - borne.stuck_N)
        return Borne(float(usual_N), float(load_N), float(usual_stuck_N), float(stuck_N))

    def tripped(self, borne: Borne) -> bool:
        """Whether so much hangs on the object; what is no number does."""
        return not borne.load_N <= self.limit_N or not borne.stuck_N <= self.stuck_limit_N
