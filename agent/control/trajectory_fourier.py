"""Band-limited excitation: a sum of sinusoids per task axis, from rest to rest; pure, and at rest outside its time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from agent.control.quaternion import Quat, Vec3, from_axis_angle, multiply
from agent.control.trajectory import Desired
from agent.control.trajectory_rest import minimum_jerk


class Term(NamedTuple):
    """amplitude · sin(2π harmonic t / base period + phase)."""

    harmonic: int
    amplitude: float  # m or rad
    phase_rad: float


@dataclass(frozen=True, slots=True)
class Fourier:
    """Displacements x, y, z from `p_centre`, and roll, pitch, yaw of R_z R_y R_x in front of `quat_centre`.

    Each of the six is a sum of terms under one window, that rises from 0 to 1 within `fade_s` and falls again before
    `motion_s`, each time as a minimum-jerk motion.  So the motion begins and ends at the centre with neither velocity
    nor acceleration, whatever the terms are.
    """

    p_centre: Vec3
    quat_centre: Quat
    axes: tuple[Sequence[Term], Sequence[Term], Sequence[Term], Sequence[Term], Sequence[Term], Sequence[Term]]
    base_period_s: float
    fade_s: float
    motion_s: float

    @property
    def period_s(self) -> float:
        """Time at which the motion is over."""
        return self.motion_s

    def at(self, t: float) -> Desired:
        """Desired motion at time t (s)."""
        window = self._window(t)
        w = 2.0 * math.pi / self.base_period_s
        x, y, z, roll, pitch, yaw = (_windowed(terms, w, t, window) for terms in self.axes)
        omega, alpha = _turning(roll, pitch, yaw)
        quat = multiply(
            from_axis_angle((0.0, 0.0, 1.0), yaw[0]),
            multiply(from_axis_angle((0.0, 1.0, 0.0), pitch[0]), from_axis_angle((1.0, 0.0, 0.0), roll[0])),
        )
        c = self.p_centre
        return Desired(
            p=(c[0] + x[0], c[1] + y[0], c[2] + z[0]),
            quat=multiply(quat, self.quat_centre),
            v=(x[1], y[1], z[1], *omega),
            a=(x[2], y[2], z[2], *alpha),
        )

    def _window(self, t: float) -> Vec3:
        """Window with its two derivatives."""
        s, ds, dds = minimum_jerk(t, self.fade_s)
        if t <= self.motion_s - self.fade_s:
            return s, ds, dds
        s, ds, dds = minimum_jerk(t - (self.motion_s - self.fade_s), self.fade_s)
        return 1.0 - s, -ds, -dds


def _windowed(terms: Sequence[Term], w: float, t: float, window: Vec3) -> Vec3:
    """Sum of the terms times the window, with its two derivatives."""
    f = df = ddf = 0.0
    for harmonic, amplitude, phase in terms:
        rate = harmonic * w
        s, c = amplitude * math.sin(rate * t + phase), amplitude * math.cos(rate * t + phase)
        f += s
        df += rate * c
        ddf -= rate * rate * s
    g, dg, ddg = window
    return g * f, dg * f + g * df, ddg * f + 2.0 * dg * df + g * ddf


def _turning(roll: Vec3, pitch: Vec3, yaw: Vec3) -> tuple[Vec3, Vec3]:
    """ω = yaw' e_z + R_z (pitch' e_y + R_y roll' e_x) and its derivative, from the angles and their derivatives."""
    (_, r1, r2), (p, p1, p2), (y, y1, y2) = roll, pitch, yaw
    sy, cy, sp, cp = math.sin(y), math.cos(y), math.sin(p), math.cos(p)
    omega = (-p1 * sy + r1 * cy * cp, p1 * cy + r1 * sy * cp, y1 - r1 * sp)
    alpha = (
        -p2 * sy - p1 * y1 * cy + r2 * cy * cp - r1 * y1 * sy * cp - r1 * p1 * cy * sp,
        p2 * cy - p1 * y1 * sy + r2 * sy * cp + r1 * y1 * cy * cp - r1 * p1 * sy * sp,
        y2 - r2 * sp - r1 * p1 * cp,
    )
    return omega, alpha
