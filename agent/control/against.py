"""What pulls an arm back against the motion: the unexpected wrench along the desired twist, one number a tick.

A neighbour that holds or is locked pulls against the motion and ever harder, whatever else it does, while friction,
encoders and calibration errors push to all sides.  So with W the unexpected wrench and v the desired twist

    p = −(F·v + (M/a)·(b ω)) / √(v² + (b ω)²),   a = 0.2 m, b = 0.1 m; zero where the arms hardly move,

one number has a lower limit than four sizes.  Two conditions tell: the `level` of p without its own slow part,
low-passed; or half of that level with a `climb`, the least of three increments of p over 0.15 s each, one after the
other, of means over 0.05 s.  A push rises once and not three times, so that one of 2 N stays below a limit that a
neighbour left behind at 10 mm/s reaches within half a second.  The state is part of `Memory`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

BLOCK_S: Final = 0.05
STEP: Final = 3  # blocks of an increment
MEANS: Final = 3 * STEP + 1  # kept, newest first
MOMENT_M: Final = 0.2  # a
TURN_M: Final = 0.1  # b
STILL_M_PER_S: Final = 2e-3
WITH_CLIMB: Final = 0.5  # of the limit of the level, where p climbs


class Pull(NamedTuple):
    """State between two ticks."""

    level_N: float = 0.0
    sum_N: float = 0.0  # of p in the block that is not finished
    ticks: float = 0.0  # in it
    means_N: tuple[float, ...] = (0.0,) * MEANS  # of the blocks before, the newest first

    @property
    def flat(self) -> tuple[float, ...]:
        """For the log field `memory`: 3 + MEANS numbers."""
        return (self.level_N, self.sum_N, self.ticks, *self.means_N)

    @property
    def climb_N(self) -> float:
        """The least of three increments that follow each other."""
        m = self.means_N
        return min(m[0] - m[STEP], m[STEP] - m[2 * STEP], m[2 * STEP] - m[3 * STEP])


NO_PULL: Final = Pull()


def pull_of(flat: Sequence[float]) -> Pull:
    """Inverse of `Pull.flat`; nothing from a row of a log that is older than this sense."""
    if not flat:
        return NO_PULL
    return Pull(flat[0], flat[1], flat[2], tuple(flat[3 : 3 + MEANS]))


@dataclass(frozen=True, slots=True)
class Against:
    """Rates and limits of this sense for the arms of a cell."""

    period_s: float
    level_N: float
    climb_N: float
    level_per_s: float = 15.0

    def advance(self, pull: Pull, wrench: Sequence[float], base: Sequence[float], v: Sequence[float]) -> Pull:
        """State after a tick; wrench: the unexpected one (6,), base: its slow part (6,), v: desired twist (6,)."""
        size = math.hypot(*v[:3], *(TURN_M * w for w in v[3:]))
        p = q = 0.0
        if size > STILL_M_PER_S:
            weight = TURN_M / MOMENT_M
            along = (v[0], v[1], v[2], weight * v[3], weight * v[4], weight * v[5])
            p = -sum(a * b for a, b in zip(wrench, along, strict=True)) / size
            q = p + sum(a * b for a, b in zip(base, along, strict=True)) / size
        level = pull.level_N + self.period_s * self.level_per_s * (q - pull.level_N)
        total, ticks = pull.sum_N + p, pull.ticks + 1.0
        if ticks + 0.5 < BLOCK_S / self.period_s:
            return Pull(level, total, ticks, pull.means_N)
        return Pull(level, 0.0, 0.0, (total / ticks, *pull.means_N[:-1]))

    def tripped(self, pull: Pull) -> bool:
        """Whether the level is above its limit, or above half of it and climbs; what is no number is."""
        climbs = not pull.climb_N <= self.climb_N
        return not pull.level_N <= (WITH_CLIMB * self.level_N if climbs else self.level_N)
