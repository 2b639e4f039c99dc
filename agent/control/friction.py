"""Joint friction by one model, for feed-forward, estimates and identification; pure.

Friction of a joint that moves with dq under the motor's torque τ is sign(dq) Γ + F_v dq with

    Γ(dq, τ) = F_c + μ |τ| + (F_s + μ_s |τ|) exp(−(|dq| / v_s)^α) ,

Coulomb friction F_c, breakaway F_s above it, both with a part that grows with load.  Feed-forward is made of two
speeds.  The sign comes from the reference velocity, smoothly: measured velocity is quantised to 0.024 rad/s, and its
sign would chatter.  What breakaway is left comes from the joint's own speed, on which it depends gently.  The motor's
torque contains the feed-forward, which is solved for.  A factor of the friction (agent.control.friction_factor) is one
of all four parts of Γ, so the load in it is that of a torque which contains it times the factor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.interface import Vector

Matrix = NDArray[np.float64]

LOAD_MAX = 0.95  # of both load parameters together; at one no torque moves the joint
FASTEST = 1e3  # of v_s; there is no breakaway left beyond, and the power stays finite


class JointFriction(NamedTuple):
    """Parameters of one joint."""

    coulomb_Nm: float  # F_c
    viscous_Nm_s_per_rad: float  # F_v
    breakaway_Nm: float = 0.0  # F_s
    stribeck_rad_per_s: float = 1.0  # v_s
    stribeck_exponent: float = 1.0  # α
    load: float = 0.0  # μ, per N·m of the motor
    breakaway_load: float = 0.0  # μ_s

    @property
    def sticks(self) -> bool:
        """Whether it is more than Coulomb and viscous friction."""
        return self.breakaway_Nm > 0.0 or self.load > 0.0 or self.breakaway_load > 0.0

    def breakaway_left(self, dq: float) -> float:
        """exp(−(|dq| / v_s)^α): one at rest, zero at speed."""
        ratio = min(abs(dq) / self.stribeck_rad_per_s, FASTEST)
        return math.exp(-(ratio**self.stribeck_exponent))

    def bound(self, left: float, tau_rest: float, sign: float, factor: float = 1.0) -> float:
        """Γ at the motor's torque τ = tau_rest + factor sign Γ; left: of the breakaway; sign: −1 to 1.

        A factor by which the load parameters would be more than LOAD_MAX counts in τ only as far as they are not.
        """
        constant, load = self.coulomb_Nm + self.breakaway_Nm * left, self.load + self.breakaway_load * left
        counted = factor * sign
        if load > 0.0:
            most = max(abs(sign), LOAD_MAX / load)
            counted = min(max(counted, -most), most)
        return solved(constant, load, tau_rest, counted)


def solved(constant: float, load: float, tau_rest: float, sign: float) -> float:
    """Γ ≥ 0 with Γ = constant + load |tau_rest + sign Γ|; load times the size of sign below one."""
    if load == 0.0:
        return constant
    size = abs(tau_rest)
    along = sign if tau_rest >= 0.0 else -sign
    bound = (constant + load * size) / (1.0 - load * along)
    if size + along * bound >= 0.0:
        return bound
    return (constant - load * size) / (1.0 + load * along)  # friction alone turns the motor's torque round


def sticking_columns(
    shapes: Sequence[JointFriction], theta: Matrix, sign: Vector, dq: Vector, tau_rest: Vector
) -> Matrix:
    """Columns (3, n) of breakaway, load and breakaway load: with those of Coulomb, sign, they make sign Γ.

    theta (4, n): Coulomb, breakaway, load and breakaway load as believed, which the motor's torque tau_rest + sign Γ
    is made with; shapes: how breakaway falls off with dq (n,).
    """
    rows = []
    for p, (c, b, m, m_b), s, v, rest in zip(
        shapes, theta.T.tolist(), sign.tolist(), dq.tolist(), tau_rest.tolist(), strict=True
    ):
        left = p.breakaway_left(v)
        size = abs(rest + s * solved(c + b * left, m + m_b * left, rest, s))
        rows.append((s * left, s * size, s * left * size))
    return np.array(rows).T


@dataclass(frozen=True, slots=True)
class Friction:
    """Feed-forward of the friction of the controlled joints."""

    joints: tuple[JointFriction, ...]
    smooth_rad_per_s: float  # speed at which the smooth sign reaches tanh(1) = 0.76
    sticks: bool = field(init=False)
    _pairs: tuple[tuple[float, float], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "sticks", any(joint.sticks for joint in self.joints))
        object.__setattr__(self, "_pairs", tuple((p.coulomb_Nm, p.viscous_Nm_s_per_rad) for p in self.joints))

    def gliding(self, dq_ref: Sequence[float], factor: float = 1.0) -> list[float]:
        """Torques (n,) that friction takes at dq_ref (n,) where no joint sticks; factor: of all that is not viscous."""
        s, tanh = 1.0 / self.smooth_rad_per_s, math.tanh
        return [factor * c * tanh(v * s) + d * v for (c, d), v in zip(self._pairs, dq_ref, strict=True)]

    def torque(self, dq_ref: Vector, dq: Vector, tau_law: Vector, factor: float = 1.0) -> Vector:
        """Torque that friction takes, to be added to the law's tau_law; arrays (n,).  factor: as of `gliding`."""
        if not self.sticks:
            return np.array(self.gliding(dq_ref.tolist(), factor))
        s = 1.0 / self.smooth_rad_per_s
        taken = []
        for p, v_ref, v, tau in zip(self.joints, dq_ref.tolist(), dq.tolist(), tau_law.tolist(), strict=True):
            sign, drag = math.tanh(v_ref * s), p.viscous_Nm_s_per_rad * v_ref
            taken.append(factor * sign * p.bound(p.breakaway_left(v), tau + drag, sign, factor) + drag)
        return np.array(taken)
