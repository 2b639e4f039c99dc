"""A motion that begins at rest: time itself starts smoothly, so that any motion may be the one that is eased.

With u = t / r and the time law τ(t) = r (5/2 u⁴ − 3 u⁵ + u⁶) up to the ramp's end r, t − r/2 behind it, speed τ̇ grows
from 0 to 1 with zero slope at both ends; position, velocity and acceleration stay continuous.
"""

from __future__ import annotations

from dataclasses import dataclass

from agent.control.trajectory import Desired, Trajectory, Vec6


@dataclass(frozen=True, slots=True)
class Eased:
    """`inner`, reached from rest within `ramp_s` > 0; half of the ramp later than it from then on."""

    inner: Trajectory
    ramp_s: float

    @property
    def period_s(self) -> float:
        """The inner motion's, and the half ramp by which it comes later."""
        return self.inner.period_s + 0.5 * self.ramp_s

    def at(self, t: float) -> Desired:
        """Desired motion at time t (s); at rest at its first pose before 0."""
        time_s, rate, rate_per_s = self._law(t)
        if rate == 1.0:
            return self.inner.at(time_s)
        p, quat, v, a = self.inner.at(time_s)
        x, y, z, rx, ry, rz = v
        slowed = (rate * x, rate * y, rate * z, rate * rx, rate * ry, rate * rz)
        k = rate * rate
        ax, ay, az, bx, by, bz = a
        eased: Vec6 = (
            k * ax + rate_per_s * x, k * ay + rate_per_s * y, k * az + rate_per_s * z,
            k * bx + rate_per_s * rx, k * by + rate_per_s * ry, k * bz + rate_per_s * rz,
        )  # fmt: skip
        return Desired(p, quat, slowed, eased)

    def _law(self, t: float) -> tuple[float, float, float]:
        """τ, τ̇ and τ̈ at t."""
        r = self.ramp_s
        if t >= r:
            return t - 0.5 * r, 1.0, 0.0
        if not t > 0.0:
            return 0.0, 0.0, 0.0
        u = t / r
        u2 = u * u
        return r * u2 * u2 * (2.5 - 3.0 * u + u2), u * u2 * (10.0 - 15.0 * u + 6.0 * u2), 30.0 * u2 * (1.0 - u) ** 2 / r
