"""What pulls an arm back against the motion, or down: the unexpected wrench along two directions, a number of each.

A neighbour that holds or is locked pulls against the motion and ever harder, whatever else it does, while friction,
encoders and calibration errors push to all sides.  So the power that the unexpected wrench takes from the desired
twist, over its speed,

    p = −(F·v + M·ω) / √(v² + (b ω)²),   b = 0.1 m; zero where the arms hardly move,

has a lower limit than four sizes.  It is also −r·J⁻¹v over that speed: a joint that hardly moves, whose friction is
known least, counts least.  Two conditions tell: the `level` of p without its own slow part,
low-passed; or a part of that level with a `climb`, the least of three increments of p over 0.15 s each, one after the
other, of means over 0.05 s.  A push rises once and not three times, so that one of 2 N stays below a limit that a
neighbour left behind at 10 mm/s reaches within half a second.

The others of a limp arm feel its weight, which nothing but gravity points at: F along gravity, without its own slow
part, is the `weight`.  Down and up it has limits of its own, shares of that of the level, for it is not low-passed; up
no less than what coarse readings shake it by.  (Down a limp neighbour in a slow motion shows little more than that.)
Where the joints are quick they and that of the level grow with the slip (agent.control.knock); that of a level which
climbs does not.  The state is part of `Memory`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

BLOCK_S: Final = 0.05
STEP: Final = 3  # blocks of an increment
MEANS: Final = 3 * STEP + 1  # kept, newest first
FLAT: Final = MEANS + 4  # numbers in the log field `memory`
LEVEL_AT, WEIGHT_AT = 106, 106 + FLAT - 1  # places there
TURN_M: Final = 0.1  # b
STILL_M_PER_S: Final = 2e-3
WITH_CLIMB: Final = 0.6  # of the limit of the level, where p climbs, or more
HANGS: Final = 1.05  # of that limit, for the weight
LIFTED: Final = 1.25  # and for a force upwards


class Pull(NamedTuple):
    """State between two ticks."""

    level_N: float = 0.0
    sum_N: float = 0.0  # of p in the block that is not finished
    ticks: float = 0.0  # in it
    means_N: tuple[float, ...] = (0.0,) * MEANS  # of the blocks before, the newest first
    weight_N: float = 0.0  # of the last tick, along gravity; below zero upwards

    @property
    def flat(self) -> tuple[float, ...]:
        """For the log field `memory`: FLAT numbers."""
        return (self.level_N, self.sum_N, self.ticks, *self.means_N, self.weight_N)

    @property
    def climb_N(self) -> float:
        """The least of three increments that follow each other."""
        m = self.means_N
        return min(m[0] - m[STEP], m[STEP] - m[2 * STEP], m[2 * STEP] - m[3 * STEP])


NO_PULL: Final = Pull()


def pull_of(flat: Sequence[float]) -> Pull:
    """Inverse of `Pull.flat`; nothing from a row of a log that is older than this sense, or than its weight."""
    if not flat:
        return NO_PULL
    return Pull(flat[0], flat[1], flat[2], tuple(flat[3 : 3 + MEANS]), sum(flat[3 + MEANS :]))


@dataclass(frozen=True, slots=True)
class Against:
    """Rates and limits of this sense for the arms of a cell."""

    period_s: float
    level_N: float
    climb_N: float
    down: tuple[float, float, float] = (0.0, 0.0, 0.0)  # gravity's direction, world axes; zero where there is none
    level_per_s: float = 15.0
    climbing_N: float = 0.0  # no less than this, where p climbs
    shaken_N: float = 0.0  # no less than this, up

    def advance(self, pull: Pull, wrench: Sequence[float], base: Sequence[float], v: Sequence[float]) -> Pull:
        """State after a tick; wrench: the unexpected one (6,), base: its slow part (6,), v: desired twist (6,)."""
        fx, fy, fz, mx, my, mz = wrench
        gx, gy, gz, kx, ky, kz = base
        x, y, z, a, b, c = v
        size = math.hypot(x, y, z, TURN_M * a, TURN_M * b, TURN_M * c)
        p = q = 0.0
        if size > STILL_M_PER_S:
            p = -(fx * x + fy * y + fz * z + mx * a + my * b + mz * c) / size
            q = p + (gx * x + gy * y + gz * z + kx * a + ky * b + kz * c) / size
        gain, (down_x, down_y, down_z) = self.period_s * self.level_per_s, self.down
        level = pull.level_N + gain * (q - pull.level_N)
        sunk = down_x * (fx - gx) + down_y * (fy - gy) + down_z * (fz - gz)
        total, ticks = pull.sum_N + p, pull.ticks + 1.0
        if ticks + 0.5 < BLOCK_S / self.period_s:
            return Pull(level, total, ticks, pull.means_N, sunk)
        return Pull(level, 0.0, 0.0, (total / ticks, *pull.means_N[:-1]), sunk)

    @property
    def hangs_N(self) -> float:
        """Limit of the weight where joints hardly move."""
        return HANGS * self.level_N

    @property
    def lifted_N(self) -> float:
        """Limit of a force upwards there."""
        return max(LIFTED * self.level_N, self.shaken_N)

    def drags(self, pull: Pull, slip: float) -> bool:
        """Whether the level is above its limit, or a part of that where it climbs; what is no number is."""
        climbs = not pull.climb_N <= self.climb_N
        part_N = max(WITH_CLIMB * self.level_N, self.climbing_N)
        return not pull.level_N <= self.level_N * slip or (climbs and pull.level_N > part_N)

    def weighs(self, pull: Pull, slip: float) -> bool:
        """Whether something hangs on the object; what is no number does."""
        return not pull.weight_N <= self.hangs_N * slip

    def lifts(self, pull: Pull, slip: float) -> bool:
        """Whether something lifts the object."""
        return pull.weight_N < -self.lifted_N * slip

    def tripped(self, pull: Pull, slip: float) -> bool:
        """Whether any of the three is so."""
        return self.drags(pull, slip) or self.weighs(pull, slip) or self.lifts(pull, slip)
