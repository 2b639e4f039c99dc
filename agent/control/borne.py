"""What pulls an arm down where the friction feed-forward bears it: a load that the unexpected wrench does not show.

The feed-forward goes by dq_r (agent.control.friction), which an error of a tenth of a millimetre turns round: joints
that go down with a heavier object are pushed up by as much as their friction, and rub as much themselves.  The residual
takes the feed-forward for spent on that friction, so of a limp neighbour that three and more arms hold on to, twice
their joints' friction is hidden from it.  What is spent beside the friction of the speed that there is,

    h = −ĝᵀ J⁻ᵀ (clip(τ_friction(dq_r), ±|τ_friction(dq)|) − τ_friction(dq)),   ĝ gravity's direction,

without its own slow part and together with the force down (agent.control.against), low-passed, is the whole load.  Of
a joint that sticks nobody knows what it bears, up to all of its friction: it counts as nothing, and so does what the
feed-forward has beyond the friction of a slow joint.  (Counted, it made loads of 2 N in slow motions where nobody had
failed.)  The load is not as exact as the force alone, for friction is what is known least: its limit is twice as high,
and it finds what that misses.  The state is part of `Memory`.
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
BORNE: Final = 2  # numbers in the log field `memory`
LOAD_AT: Final = 134  # of `load_N` there


class Borne(NamedTuple):
    """State between two ticks."""

    usual_N: float = 0.0  # of h, its slow part
    load_N: float = 0.0  # what hangs on this arm, friction and all, low-passed


NOT_BORNE: Final = Borne()


def borne_of(flat: Sequence[float]) -> Borne:
    """From the log field `memory`; nothing from a row of a log that is older than this sense."""
    return Borne(*flat[:BORNE])


@dataclass(frozen=True, slots=True)
class Bearing:
    """Friction and limit of this sense for one arm of a cell."""

    period_s: float
    limit_N: float
    friction: Friction  # of the feed-forward, of joints that do not stick
    down: tuple[float, float, float]  # gravity's direction, world axes

    def advance(
        self, borne: Borne, weight_N: float, J_inv_P: Matrix, tau_friction: Vector, dq: Vector, *, ready: bool
    ) -> Borne:
        """State after a tick; ready: before the start, when nothing but what is usual is learnt.

        weight_N: the force down beside it; J_inv_P: (n, 6) joint velocities of an object twist; tau_friction: the
        feed-forward at dq_r (n,); dq: joint velocities (n,).
        """
        rubs = self.friction.gliding(dq.tolist())
        most = np.abs(rubs)
        spent = np.minimum(np.maximum(tau_friction, -most), most) - rubs
        x, y, z, _, _, _ = J_inv_P.T.dot(spent).tolist()
        down_x, down_y, down_z = self.down
        beside = -(down_x * x + down_y * y + down_z * z) - borne.usual_N
        usual_N = borne.usual_N + self.period_s * USUAL_PER_S * beside
        if ready:
            return Borne(usual_N, 0.0)
        return Borne(usual_N, borne.load_N + self.period_s * LOAD_PER_S * (weight_N + beside - borne.load_N))

    def tripped(self, borne: Borne) -> bool:
        """Whether so much hangs on the object; what is no number does."""
        return not borne.load_N <= self.limit_N
