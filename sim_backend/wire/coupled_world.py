"""What the worlds of emulated servos on one plant have in common: how an arm's joints are read, and the truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.interface import Vector
from sim_backend.physics.build import AnyPlant
from sim_backend.physics.snapshot import Observation


class CoupledWorld:
    """Emulated servos' plant; whoever derives says how torques act and time passes."""

    def __init__(self, plant: AnyPlant) -> None:
        self.substep_s = plant.spec.substep_s
        self.tau_Nm: Vector = np.zeros(plant.joint_count)
        self._plant = plant
        self._zero_error = [arm.actuator.zero_error_rad for arm in plant.spec.arms]

    def state(self, arm: int) -> tuple[Sequence[float], Sequence[float]]:
        """Positions, from where encoders believe zero to be, and velocities of an arm's controlled joints, in order."""
        joints = self._plant.slices[arm]
        q: list[float] = (self._plant.q[joints] + self._zero_error[arm]).tolist()
        dq: list[float] = self._plant.dq[joints].tolist()
        return q, dq

    def acting(self) -> Vector:
        """Torques (J,) of all servos in this substep: none of an arm that the plant's calendar has limp."""
        limp = self._plant.calendar.limp(round(self._plant.t / self.substep_s))
        if not limp:
            return self.tau_Nm
        tau = self.tau_Nm.copy()
        for arm in limp:
            tau[self._plant.slices[self._plant.spec.names.index(arm)]] = 0.0
        return tau

    def observe(self) -> Observation:
        """What is true now, with the servos' torques acting; changes nothing."""
        return self._plant.observe(self.acting())
