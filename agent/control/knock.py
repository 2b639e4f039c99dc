"""What strikes an object that three and more arms share: a force that comes at once, and how much of a force they feel.

Each arm bears its share of a push, and friction in joints that hardly move hides a part of that.  So what is felt of
the same force grows with the speed of the joints, and limits grow with

    slip = max(1, ‖J⁻¹ v‖ / ω),   ω = 0.06 rad/s, v the desired twist,

low-passed at 20/s from 4 on, because the residual of an arm that begins on its way is a jump.

A push of 10 N comes within 50 ms, while one of 2 N needs 0.1 to 0.25 s to come through friction and pads: the size of
the sudden force without its own part low-passed at 20/s, the `knock`, tells one from the other to all sides, as the
sudden force itself, which grows with both and more slowly, does not.  The state is part of `Memory`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

RATE_PER_S: Final = 20.0
SLIPS_RAD_PER_S: Final = 0.06  # ω
STRUCK = 5  # numbers in the log field `memory`
KNOCK_AT, SLIP_AT = 131, 132  # places there


class Struck(NamedTuple):
    """State between two ticks."""

    x_N: float = 0.0  # of the sudden force, world axes, low-passed
    y_N: float = 0.0
    z_N: float = 0.0
    knock_N: float = 0.0
    slip: float = 4.0  # low-passed


NOT_STRUCK: Final = Struck()


def struck_of(flat: Sequence[float]) -> Struck:
    """From the log field `memory`; nothing from a row of a log that is older than this sense."""
    return Struck(*flat[:STRUCK])


def slip(speeds: Sequence[float]) -> float:
    """How much more of a force is felt than where joints hardly move; speeds: of the joints on the way, rad/s."""
    return max(1.0, math.hypot(*speeds) / SLIPS_RAD_PER_S)


@dataclass(frozen=True, slots=True)
class Knock:
    """Rate and limit of this sense for the arms of a cell."""

    period_s: float
    limit_N: float  # where joints hardly move

    def advance(self, struck: Struck, force: Sequence[float], speeds: Sequence[float]) -> Struck:
        """State after a tick; force: the sudden one (3,), world axes, speeds: of the joints on the way, rad/s."""
        gain, (x, y, z) = self.period_s * RATE_PER_S, force
        a = struck.x_N + gain * (x - struck.x_N)
        b = struck.y_N + gain * (y - struck.y_N)
        c = struck.z_N + gain * (z - struck.z_N)
        return Struck(a, b, c, math.hypot(x - a, y - b, z - c), struck.slip + gain * (slip(speeds) - struck.slip))

    def tripped(self, struck: Struck) -> bool:
        """Whether something strikes harder than a touch; what is no number does."""
        return not struck.knock_N <= self.limit_N * struck.slip
