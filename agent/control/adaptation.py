"""The estimates of the adaptive law: their layout, gains and bounds, and one step of adaptation; pure.

Layout of the arm's vector (16 n), as logged: ten inertial parameters of each body, then of each joint reflected rotor
inertia, viscous and Coulomb friction, breakaway, load and breakaway load (agent.control.friction).  A parameter that
is not estimated has gain zero and keeps its configured value, so the law has one form whatever is unknown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from agent.control.friction import LOAD_MAX, JointFriction
from agent.control.projection import to_box, to_physical
from agent.control.regressor import BODY_PARAMETERS
from drivers.interface import Vector

JOINT_PARAMETERS = 6  # rotor inertia, viscous, Coulomb, breakaway, load, breakaway load
ARM_PARAMETERS_PER_JOINT = BODY_PARAMETERS + JOINT_PARAMETERS
MAX_INTERVALS = 4.0  # adaptation over a longer pause than this many periods is not made up for


class Estimate(NamedTuple):
    """θ̂ of one agent between two ticks; arrays are never written to again."""

    arm: Vector  # (16 n,)
    object: Vector  # (10,)


class Gradient(NamedTuple):
    """What the adaptation laws follow downhill, before the gains."""

    arm: Vector  # (16 n,) Y_qᵀ (dq − dq_r)
    object: Vector  # (10,) c_i Y_Oᵀ e_v


@dataclass(frozen=True, slots=True)
class Adaptation:
    """Offline data of the adaptive law of one agent.  lower ≤ start ≤ upper, and gains of zero pin a parameter.

    Raises ValueError where joints stick and the upper bounds allow load friction that no torque overcomes.
    """

    start: Estimate
    nominal: Estimate  # as configured; what the logged Lyapunov value calls the truth
    lower: Estimate
    upper: Estimate
    gain: Estimate  # Γ: γ_i on the arm, γ_O on the object
    smooth_rad_per_s: float  # of the sign in the Coulomb column
    friction: bool  # whether any friction parameter can be other than zero
    physical: bool  # keep principal moments physical
    period_s: float
    sticking: tuple[JointFriction, ...] = ()  # how breakaway falls off, joint by joint; empty: no joint has it or load
    leak_per_s: float = 0.0  # rate at which estimates forget towards what is configured
    weight: Estimate = field(init=False)  # Γ⁻¹, zero where nothing is estimated
    # What a tick works with, object and arm in one array (10 + 16 n,), so that all bodies stand side by side:
    _nominal: Vector = field(init=False)
    _gain: Vector = field(init=False)
    _leaks: Vector = field(init=False)  # one where anything is estimated
    _weight: Vector = field(init=False)
    _lower: Vector = field(init=False)
    _upper: Vector = field(init=False)
    _alarm: Vector = field(init=False)  # lower bounds but for those of zero: a mass at zero is physics, no alarm

    def __post_init__(self) -> None:
        load = self.upper.arm.reshape(-1, len(self.upper.arm) // ARM_PARAMETERS_PER_JOINT)[-2:].sum(axis=0)
        if self.sticking and (load > LOAD_MAX).any():
            raise ValueError(f"bounds of load friction: {load.tolist()}, at most {LOAD_MAX} in sum")
        object.__setattr__(self, "start", Estimate(*divided(_together(self.start))))
        nominal, gain, lower, upper = (_together(x) for x in (self.nominal, self.gain, self.lower, self.upper))
        weight, alarm = _inverse(gain), np.where(lower == 0.0, -np.inf, lower)
        leaks = np.sign(gain)
        joined = {
            "nominal": nominal,
            "gain": gain,
            "leaks": leaks,
            "weight": weight,
            "lower": lower,
            "upper": upper,
            "alarm": alarm,
        }
        for name, array in joined.items():
            object.__setattr__(self, f"_{name}", array)
        for array in (*self.start, *self.nominal, *self.lower, *self.upper, *self.gain, *joined.values()):
            array.flags.writeable = False
        object.__setattr__(self, "weight", Estimate(*divided(weight)))

    def advance(self, estimate: Estimate, gradient: Gradient, dt: float) -> tuple[Estimate, bool]:
        """θ̂ after dt seconds of θ̂̇ = −Γ gradient − σ (θ̂ − nominal), projected; and whether a configured bound held it.

        Being held at zero from below is not reported.  A gradient that is not finite changes nothing and is
        reported as held back.
        """
        dt = min(max(dt, 0.0), MAX_INTERVALS * self.period_s)
        before = _joined(estimate)
        theta = before - dt * self._gain * _joined(gradient)  # eq:adaptation laws
        if self.leak_per_s > 0.0:
            theta += math.expm1(-self.leak_per_s * dt) * self._leaks * (before - self._nominal)
        if not math.isfinite(theta.dot(theta)):
            return estimate, True
        inside = to_box(theta, self._lower, self._upper)
        # bytes are compared in a fifth of the time of numbers
        held = inside.tobytes() != theta.tobytes() and _outside(theta, self._alarm, self._upper)
        if self.physical:
            n = (len(inside) - BODY_PARAMETERS) // ARM_PARAMETERS_PER_JOINT
            bodies = inside[: BODY_PARAMETERS * (n + 1)].reshape(-1, BODY_PARAMETERS)  # the object's, then the links'
            possible = to_physical(bodies)
            if possible is not bodies:
                bodies[:] = possible
        return Estimate(*divided(inside)), held

    def parameter_error(self, estimate: Estimate) -> float:
        """½ e_θᵀ Γ⁻¹ e_θ with e_θ = nominal − θ̂, over the parameters that are estimated."""
        error = self._nominal - _joined(estimate)  # eq:adaptation errors
        return 0.5 * float((error * error).dot(self._weight))


def from_row(theta_arm: Vector, theta_object: Vector, n: int) -> Estimate:
    """The estimate in the fields `theta_arm` and `theta_object` of a log row of an arm with n joints."""
    return Estimate(np.array(theta_arm[: ARM_PARAMETERS_PER_JOINT * n]), np.array(theta_object))


def divided(joined: Vector) -> tuple[Vector, Vector]:
    """The parts of arm (16 n,) and object (10,) as views of one array, in which the object stands first."""
    return joined[BODY_PARAMETERS:], joined[:BODY_PARAMETERS]


def _together(parts: Estimate | Gradient) -> Vector:
    """Object and arm in one new array."""
    return np.concatenate((parts.object, parts.arm))


def _joined(parts: Estimate | Gradient) -> Vector:
    """Object and arm in one array: the one that `divided` made them from, where that is how they came about."""
    arm, body = parts
    whole = arm.base
    if whole is not None and whole is body.base and len(whole) == len(arm) + len(body):
        return whole
    return _together(parts)


def _outside(theta: Vector, lower: Vector, upper: Vector) -> bool:
    return bool((theta > upper).any()) or bool((theta < lower).any())


def _inverse(gain: Vector) -> Vector:
    return np.divide(1.0, gain, out=np.zeros_like(gain), where=gain > 0.0)
