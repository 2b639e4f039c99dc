"""Profile Velocity and Profile Acceleration: the trajectory a servo makes of a goal position.

Pure functions of the time since the goal was written, in ticks and seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum


class ProfileType(IntEnum):
    """Bits 4 and 5 of Moving Status."""

    NONE = 0x00
    RECTANGULAR = 0x10
    TRIANGULAR = 0x20
    TRAPEZOIDAL = 0x30


@dataclass(frozen=True, slots=True)
class Profile:
    """A move from rest to rest: accelerate `ramp_s`, cruise, brake `ramp_s`; `total_s` zero is a step."""

    start: float  # tick
    goal: float  # tick
    ramp_s: float
    total_s: float
    kind: ProfileType

    @classmethod
    def step(cls, goal: float) -> Profile:
        """Return the profile of Profile Velocity zero: the goal at once."""
        return cls(goal, goal, 0.0, 0.0, ProfileType.NONE)

    @classmethod
    def by_velocity(cls, start: float, goal: float, speed: float, acceleration: float) -> Profile:
        """Velocity-based profile; speed in tick/s, acceleration in tick/s^2, zero meaning unlimited."""
        distance = abs(goal - start)
        if distance == 0.0 or speed <= 0.0:
            return cls.step(goal)
        if acceleration <= 0.0:
            return cls(start, goal, 0.0, distance / speed, ProfileType.RECTANGULAR)
        ramp_s = speed / acceleration
        if distance < speed * ramp_s:
            ramp_s = math.sqrt(distance / acceleration)
            return cls(start, goal, ramp_s, 2.0 * ramp_s, ProfileType.TRIANGULAR)
        return cls(start, goal, ramp_s, ramp_s + distance / speed, ProfileType.TRAPEZOIDAL)

    @classmethod
    def by_time(cls, start: float, goal: float, total_s: float, ramp_s: float) -> Profile:
        """Time-based profile; the ramp cannot exceed half of the total."""
        if start == goal or total_s <= 0.0:
            return cls.step(goal)
        kind = ProfileType.TRAPEZOIDAL if ramp_s > 0.0 else ProfileType.RECTANGULAR
        return cls(start, goal, min(ramp_s, total_s / 2.0), total_s, kind)

    def sample(self, since_s: float) -> tuple[float, float]:
        """Position (tick) and velocity (tick/s) at a time since the start."""
        if since_s >= self.total_s:
            return self.goal, 0.0
        travel = self.goal - self.start
        speed = travel / (self.total_s - self.ramp_s)
        if since_s < self.ramp_s:
            rate = speed / self.ramp_s
            return self.start + 0.5 * rate * since_s * since_s, rate * since_s
        left_s = self.total_s - since_s
        if left_s < self.ramp_s:
            rate = speed / self.ramp_s
            return self.goal - 0.5 * rate * left_s * left_s, rate * left_s
        return self.start + speed * (since_s - 0.5 * self.ramp_s), speed
