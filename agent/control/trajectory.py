"""Desired object motion as a function of time: position, attitude, twist, acceleration; pure and continuous."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final, NamedTuple, Protocol

from agent.control.quaternion import Quat, Vec3, multiply

Vec6 = tuple[float, float, float, float, float, float]

STILL: Final[Vec6] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # twist or acceleration of what does not move


class Desired(NamedTuple):
    """Desired pose, twist and acceleration of the object's centre of mass; world axes, linear first."""

    p: Vec3  # m
    quat: Quat
    v: Vec6  # m/s, rad/s
    a: Vec6  # m/s², rad/s²


def at_rest(p: Vec3, quat: Quat) -> Desired:
    """That pose, to be kept."""
    return Desired(p, quat, STILL, STILL)


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
    _rad_per_s: float = field(init=False)
    _amplitude: Vec6 = field(init=False)  # m, rad
    _quat_turned: Quat = field(init=False)  # quat_centre turned by π about the axis

    def __post_init__(self) -> None:
        p, n, phi = self.p_amplitude, self.axis, self.angle_rad
        object.__setattr__(self, "_rad_per_s", 2.0 * math.pi / self.period_s)
        object.__setattr__(self, "_amplitude", (*p, n[0] * phi, n[1] * phi, n[2] * phi))
        object.__setattr__(self, "_quat_turned", multiply((0.0, *n), self.quat_centre))

    def at(self, t: float) -> Desired:
        """Desired motion at time t (s)."""
        w = self._rad_per_s
        s, c = math.sin(w * t), w * math.cos(w * t)
        dd = -w * w * s
        (px, py, pz), (x, y, z, rx, ry, rz) = self.p_centre, self._amplitude
        (qw, qx, qy, qz), (nw, nx, ny, nz) = self.quat_centre, self._quat_turned
        half = 0.5 * self.angle_rad * s
        a, b = math.cos(half), math.sin(half)  # (a, b n) ⊗ ξ = a ξ + b (0, n) ⊗ ξ
        return Desired(
            (px + x * s, py + y * s, pz + z * s),
            (a * qw + b * nw, a * qx + b * nx, a * qy + b * ny, a * qz + b * nz),
            (x * c, y * c, z * c, rx * c, ry * c, rz * c),
            (x * dd, y * dd, z * dd, rx * dd, ry * dd, rz * dd),
        )
