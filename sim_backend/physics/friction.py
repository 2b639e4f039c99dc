"""Dry friction of servo gearboxes with presliding: breakaway, Stribeck, a part that grows with load; still at rest.

A joint sticks to a bristle that bends like a damped spring until its torque reaches the bound

    Γ(dq, τ) = F_c + μ |τ| + (F_s + μ_s |τ|) exp(−(|dq| / v_s)^α),

τ the motor's torque; then it slides against Γ.  Viscous friction F_v dq comes on top.  The form is that of the
Stribeck load-dependent model (M4) of Duclusaud, Passault, Padois and Ly, "Extended Friction Models for the Physics
Simulation of Servo Actuators" (2024), identified on Dynamixel servos.  Its load |τ_m − τ_e| is 2 |τ| where motor and
external torque balance, so its load figures count twice here.

The torque over a step is −D (dq + dq⁺)/2 + f with D ≥ 0, so that an integrator takes it in implicitly.  While a joint
sticks this is −K z⁺ − C ż with the bend z⁺ at the end of the step: the bristle gives back at most what it took, at any
step.  A sliding joint that turns round within one step keeps the old direction's friction to its end; that gives
under 2e-6 J per turn at steps of 1 ms, and grows with their square.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drivers.interface import Vector
from sim_backend.physics.actuator import ActuatorError, ActuatorSpec

PRESLIDING_RAD: Final = 2e-4  # bend of the bristle at breakaway without load
BRISTLE_DAMPING_RATIO: Final = 1.0  # of bristle and rotor
LEAST_BREAKAWAY_Nm: Final = 1e-3  # what a bristle's stiffness is made from where friction is all load's
LEAST_INERTIA_kg_m2: Final = 1e-5


@dataclass(frozen=True, eq=False)
class FrictionSpec:
    """Friction of some joints; arrays (n,).  Raises ActuatorError."""

    coulomb_Nm: Vector  # F_c
    breakaway_Nm: Vector  # F_s: what sticking holds above Coulomb
    stribeck_rad_s: Vector  # v_s
    stribeck_exponent: Vector  # α
    load: Vector  # μ, of the motor's torque
    breakaway_load: Vector  # μ_s
    viscous_Nms_rad: Vector  # F_v

    def __post_init__(self) -> None:
        for f in fields(self):
            value = np.array(getattr(self, f.name), dtype=np.float64)
            value.flags.writeable = False
            object.__setattr__(self, f.name, value)
            positive = f.name in ("stribeck_rad_s", "stribeck_exponent")
            if not np.all(np.isfinite(value) & ((value > 0.0) if positive else (value >= 0.0))):
                raise ActuatorError(
                    f"friction: {f.name}",
                    found=value.tolist(),
                    expected="finite positive numbers" if positive else "finite numbers, none negative",
                    remedy="correct the friction of the servos",
                )
        if np.any(self.load + self.breakaway_load >= 1.0):
            raise ActuatorError(
                "friction: load",
                found=(self.load + self.breakaway_load).tolist(),
                expected="below 1 in sum, above which no torque ever moves the joint",
                remedy="correct the friction of the servos",
            )

    @classmethod
    def smooth(cls, servos: ActuatorSpec) -> FrictionSpec:
        """Coulomb and viscous friction of servos that are described by no more."""
        zero, one = np.zeros(servos.joint_count), np.ones(servos.joint_count)
        return cls(servos.coulomb_Nm, zero, one, one, zero, zero, servos.viscous_Nms_rad)

    @property
    def dry(self) -> NDArray[np.bool_]:
        """(n,) bool: joints that stick at all."""
        return np.asarray((self.coulomb_Nm + self.breakaway_Nm + self.load + self.breakaway_load) > 0.0)


class DryFriction:
    """Friction of (J,) joints, with the bend of every bristle as its state.

    In every step: `load`, `torque`, then `step`.  Returned arrays are not written to again.
    """

    def __init__(self, spec: FrictionSpec, rotor_inertia: Vector, step_s: float) -> None:
        """rotor_inertia: (J,) kg·m², what the bristles' damping is tuned to."""
        self._spec = spec
        self._h = step_s
        static = spec.coulomb_Nm + spec.breakaway_Nm
        self._dry = spec.dry
        self._stiffness = np.where(self._dry, np.maximum(static, LEAST_BREAKAWAY_Nm) / PRESLIDING_RAD, 0.0)
        inertia = np.maximum(rotor_inertia, LEAST_INERTIA_kg_m2)
        damping = 2.0 * BRISTLE_DAMPING_RATIO * np.sqrt(self._stiffness * inertia)
        self._viscous = np.array(spec.viscous_Nms_rad)
        self._bristle = step_s * self._stiffness + damping
        self._bend = np.zeros_like(static)  # rad
        self._bound = static.copy()
        self.load(np.zeros_like(static))
        self.sliding = np.zeros(len(static), dtype=bool)

    def load(self, tau_motor_Nm: Vector) -> None:
        """The motors' torques (J,) that press the gears from now on."""
        size, s = np.abs(tau_motor_Nm), self._spec
        self._kinetic = s.coulomb_Nm + s.load * size
        self._extra = s.breakaway_Nm + s.breakaway_load * size

    def torque(self, dq: Vector) -> tuple[Vector, Vector]:
        """(D, f), each (J,): the friction torque is −D (dq + dq⁺)/2 + f over the step that begins at dq (J,)."""
        s = self._spec
        self.sliding &= (dq * self._bend) > 0.0
        self._bound = self._kinetic + self._extra * np.exp(-((np.abs(dq) / s.stribeck_rad_s) ** s.stribeck_exponent))
        D = self._viscous + np.where(self.sliding, 0.0, self._bristle)
        f = np.where(self.sliding, -np.sign(self._bend) * self._bound, -self._stiffness * self._bend)
        return D, f

    def step(self, dq_mean: Vector) -> None:
        """The step is over; dq_mean (J,): its mean velocity."""
        bend = self._bend + self._h * dq_mean
        room = self._bound / np.where(self._dry, self._stiffness, 1.0)
        self._bend = np.minimum(np.maximum(bend, -room), room)
        self.sliding = self._dry & (np.abs(bend) > room)

    @property
    def energy(self) -> float:
        """What the bristles hold, J."""
        return float(0.5 * np.sum(self._stiffness * self._bend**2))

    def set_viscous(self, joints: slice, viscous_Nms_rad: float | Vector) -> None:
        """Change the viscous friction of some joints (a seized gear)."""
        self._viscous[joints] = viscous_Nms_rad
