"""Desired object motion as a function of time: position, attitude, twist, acceleration; pure and continuous."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from agent.control.quaternion import Quat, Vec3, from_axis_angle, multiply

Vec6 = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class Desired:
    """Desired pose, twist and acceleration of the object's centre of mass; world axes, linear first."""

    p: Vec3  # m
    quat: Quat
    v: Vec6  # m/s, rad/s
    a: Vec6  # m/s², rad/s²


class Trajectory(Protocol):
    """A twice differentiable motion; `at` is defined for every t ≥ 0."""

    @property
    def period_s(self) -> float:
        """Time after which nothing new happens: the period, or the duration; checks sample over it."""
        ...

    def at(self, t: float) -> Desired:
        """Desired motion at time t (s)."""
        ...


@dataclass(frozen=True, slots=True)
class Sinusoid:
    """p = centre + amplitude sin(ωt); attitude = rotation by angle sin(ωt) about a fixed axis, then `quat_centre`.

    The paper's experiment (section "Experimental Evaluation") is centre [0.3, 0.12, 0], amplitude
    [0.05, 0, 0], angle −π/30 about z, period 15 s.
    """

    p_centre: Vec3
    p_amplitude: Vec3
    quat_centre: Quat
    axis: Vec3  # unit, world axes
    angle_rad: float
    period_s: float

    def at(self, t: float) -> Desired:
        """Desired motion at time t (s)."""
        w = 2.0 * math.pi / self.period_s
        s, c = math.sin(w * t), w * math.cos(w * t)
        dd = -w * w * s
        p, a, n, phi = self.p_centre, self.p_amplitude, self.axis, self.angle_rad
        return Desired(
            p=(p[0] + a[0] * s, p[1] + a[1] * s, p[2] + a[2] * s),
            quat=multiply(from_axis_angle(n, phi * s), self.quat_centre),
            v=(a[0] * c, a[1] * c, a[2] * c, n[0] * phi * c, n[1] * phi * c, n[2] * phi * c),
            a=(a[0] * dd, a[1] * dd, a[2] * dd, n[0] * phi * dd, n[1] * phi * dd, n[2] * phi * dd),
        )
