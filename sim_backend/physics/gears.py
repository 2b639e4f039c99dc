"""Backlash of the joints: gears whose teeth meet without bouncing, push one way only, and part where they would pull.

With x the angle by which the motor is ahead of the joint, |x| ≤ ½ backlash, w the motor's speed and J its inertia, both
as the joint counts them, and τ its torque:

    in the gap   J ẇ = τ, ẋ = w − dq; the joint gets no torque and J is no part of its inertia
    meshed       w = dq; the joint gets τ and J is part of its inertia; the teeth bear τ − J ddq towards their side,
                 and where that is less than nothing they are parted in the next substep
    meeting      the mechanism M, with J of all joints that mesh, takes over the momentum: M Δv = J (w − dq)

A blow takes the energy out that was in the difference of speeds; the rest keeps it, so that a plant whose motors give
nothing gains none.  The motor crosses without friction, all of which is the joint's; without the rotor's inertia the
mean speed of a substep, −D (dq + dq⁺)/2, would let a light joint ring, so in the gap friction is −D dq⁺.  Encoders sit
at the joint.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drivers.interface import Vector
from sim_backend.physics.spec import PlantSpec

LEAST_INERTIA: Final = 1e-5  # kg·m²; a motor that has less counts as one of so much, and crosses the gap in a substep


class Gears:
    """Gears of all joints (J,) of a plant.  In every substep: `meet` where `meets` says so, `passed`, then `step`.

    Arrays are not written to again, so `copy.copy` keeps an instant.
    """

    def __init__(self, backlash_rad: Vector, rotor_inertia: Vector, substep_s: float) -> None:
        loose = backlash_rad > 0.0
        self._half = 0.5 * backlash_rad
        self._J: Vector = np.where(loose, np.maximum(rotor_inertia, LEAST_INERTIA), rotor_inertia)
        self._per_J: Vector = 1.0 / np.maximum(self._J, LEAST_INERTIA)
        self._rotor_inertia, self._h = rotor_inertia, substep_s
        self.x: Vector = np.zeros(len(backlash_rad))  # motor ahead of joint, rad
        self.speed: Vector = np.zeros(len(backlash_rad))  # of the motors, rad/s
        self._pushes: Vector = np.zeros(len(backlash_rad))  # of the motors in a substep, N·m·s
        self._meshed = ~loose
        self._meeting: NDArray[np.bool_]  # the same, joint by joint, where there are any
        self.meets = False  # any teeth, at the begin of the next substep
        self._share()

    def _share(self) -> None:
        self.inertia: Vector = np.where(self._meshed, self._J, 0.0)  # of the motors, that is the joints' now
        self.added: Vector = self.inertia - self._rotor_inertia  # to a mass matrix that has all rotors in it
        self.ahead_s: Vector = np.where(self._meshed, 0.5 * self._h, self._h)  # of a substep, to where friction acts

    @property
    def energy(self) -> float:
        """Of the motors that fly in their gaps, J."""
        return float(0.5 * np.sum((self._J - self.inertia) * self.speed**2))

    def along(self, dq: Vector) -> None:
        """All motors move with their joints, at dq (J,)."""
        self.speed = dq.copy()
        self.meets = False

    def meet(self, dq: Vector, jump: Callable[[Vector], Vector]) -> tuple[Vector, Vector]:
        """Change of all velocities by teeth that meet, and the momenta (J,) that motors gave; dq (J,): just before.

        jump: that change, joints first, by momenta (J,) N·m·s given to the joints, with `inertia` as it then stands.
        Teeth that the blow of others pulls at, by more than their motor pushes in a substep, part instead.
        """
        for _ in range(len(dq) + 1):  # every round but the last parts some
            given = np.where(self._meeting, self._J * (self.speed - dq), 0.0)
            self._meshed = self._meshed | self._meeting
            self._share()
            dv = jump(given)
            change = dv[: len(dq)]
            pulled = self._meshed & (np.sign(self.x) * (given + self._pushes - self._J * change) < 0.0)
            if not pulled.any():
                break
            self._meshed, self._meeting = self._meshed & ~pulled, self._meeting & ~pulled
        self.speed = np.where(self._meshed, dq + change, self.speed)
        return dv, given

    def passed(self, motor: Vector) -> Vector:
        """Torque (J,) that reaches the joints in this substep, of what the motors give."""
        return np.where(self._meshed, motor, 0.0)

    def step(self, motor: Vector, dq: Vector, ddq: Vector) -> None:
        """The substep is over: motors' torques, joints' speeds at its end and accelerations in it, (J,) each."""
        h, meshed, side = self._h, self._meshed, np.sign(self.x)
        faster = h * self._per_J * motor
        x = self.x + h * np.where(meshed, 0.0, self.speed + 0.5 * faster - (dq - 0.5 * h * ddq))
        self.speed = np.where(meshed, dq, self.speed + faster)
        parts = side * (motor - self._J * ddq) < 0.0
        self._pushes = h * motor
        self.x = np.clip(x, -self._half, self._half)
        self._meeting = ~meshed & (np.abs(x) >= self._half) & (np.sign(x) * (self.speed - dq) > 0.0)
        self.meets = bool(self._meeting.any())
        if (meshed & parts).any():
            self._meshed = meshed & ~parts
            self._share()


def gears(spec: PlantSpec) -> Gears | None:
    """Of all arms of the plant; None where no joint has backlash."""
    backlash = np.concatenate([np.zeros(0), *(arm.actuator.backlash_rad for arm in spec.arms)])
    if not backlash.any():
        return None
    return Gears(backlash, np.concatenate([arm.rotor_inertia for arm in spec.arms]), spec.substep_s)
