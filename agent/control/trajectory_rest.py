"""Rest-to-rest motion between two poses, minimum jerk; pure, and at rest outside its time."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from agent.control.quaternion import Quat, Vec3, conjugate, from_axis_angle, multiply
from agent.control.trajectory import STILL, Desired


@dataclass(frozen=True, slots=True)
class RestToRest:
    """Straight line and fixed rotation axis (world), both timed by s = 10τ³ − 15τ⁴ + 6τ⁵, and back if asked.

    That s minimises ∫ jerk² between two states of rest.  The rotation takes the shorter way round.
    """

    p_from: Vec3
    quat_from: Quat
    p_to: Vec3
    quat_to: Quat
    move_s: float
    wait_s: float  # before each motion
    and_back: bool
    _way: Vec3 = field(init=False)  # m
    _axis: Vec3 = field(init=False)  # unit, world axes
    _angle: float = field(init=False)  # rad, 0 … π

    def __post_init__(self) -> None:
        a, b = self.p_from, self.p_to
        w, x, y, z = multiply(self.quat_to, conjugate(self.quat_from))
        size = math.sqrt(x * x + y * y + z * z)
        sign = -1.0 if w < 0.0 else 1.0
        axis = (sign * x / size, sign * y / size, sign * z / size) if size > 0.0 else (1.0, 0.0, 0.0)
        object.__setattr__(self, "_way", (b[0] - a[0], b[1] - a[1], b[2] - a[2]))
        object.__setattr__(self, "_axis", axis)
        object.__setattr__(self, "_angle", 2.0 * math.atan2(size, abs(w)))

    @property
    def period_s(self) -> float:
        """Time at which the last motion ends."""
        return (self.wait_s + self.move_s) * (2.0 if self.and_back else 1.0)

    def at(self, t: float) -> Desired:
        """Desired motion at time t (s)."""
        leg = self.wait_s + self.move_s
        back = self.and_back and t >= leg
        s, ds, dds = minimum_jerk((t - leg if back else t) - self.wait_s, self.move_s)
        if back:
            s, ds, dds = 1.0 - s, -ds, -dds
        p, d, n, angle = self.p_from, self._way, self._axis, self._angle
        w = (angle * n[0], angle * n[1], angle * n[2])
        return Desired(
            p=(p[0] + s * d[0], p[1] + s * d[1], p[2] + s * d[2]),
            quat=multiply(from_axis_angle(n, s * angle), self.quat_from),
            v=(ds * d[0], ds * d[1], ds * d[2], ds * w[0], ds * w[1], ds * w[2]) if ds else STILL,
            a=(dds * d[0], dds * d[1], dds * d[2], dds * w[0], dds * w[1], dds * w[2]) if dds else STILL,
        )


def minimum_jerk(t: float, duration: float) -> tuple[float, float, float]:
    """s, ds/dt, d²s/dt² at time t of a motion that lasts `duration`."""
    x = t / duration
    if x <= 0.0:
        return 0.0, 0.0, 0.0
    if x >= 1.0:
        return 1.0, 0.0, 0.0
    s = x * x * x * (10.0 + x * (6.0 * x - 15.0))
    ds = 30.0 * x * x * (1.0 - x) * (1.0 - x) / duration
    dds = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / (duration * duration)
    return s, ds, dds
