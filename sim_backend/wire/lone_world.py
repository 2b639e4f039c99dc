"""Arms that hold nothing as the world of emulated servos: what a rehearsal moves in the place of real arms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_backend.physics.lone import LoneArm
from sim_backend.physics.spec import PlantSpec
from sim_backend.wire.arm import EmulatedArm
from sim_backend.wire.cell import EmulatedCell
from sim_backend.wire.plant_world import without_servo_electronics
from sim_backend.wire.timing import BusTiming
from sim_backend.wire.wiring import ArmWiring


class LoneWorld:
    """Arms with dynamics of their own; each rests on a support until its servos have given torque once."""

    def __init__(self, arms: Sequence[LoneArm], zero_error_rad: Sequence[np.ndarray]) -> None:
        self.arms = tuple(arms)
        self.substep_s = self.arms[0].substep_s
        self._zero_error = zero_error_rad
        self._tau = [np.zeros_like(arm.q) for arm in self.arms]
        self._idle = set(range(len(self.arms)))

    def state(self, arm: int) -> tuple[Sequence[float], Sequence[float]]:
        """Positions, from where encoders believe zero to be, and velocities of an arm's controlled joints, in order."""
        one = self.arms[arm]
        return (one.q + self._zero_error[arm]).tolist(), one.dq.tolist()

    def apply(self, arm: int, tau_Nm: Sequence[float]) -> None:
        """Set the torques of an arm's servos."""
        self._tau[arm] = np.array(tau_Nm)
        if any(tau_Nm):
            self._idle.discard(arm)

    def advance(self) -> None:
        """Let one substep pass.  Raises PlantError when the motion is no longer finite."""
        for i, arm in enumerate(self.arms):
            if i in self._idle:
                arm.rest()
            else:
                arm.advance(self._tau[i])


def emulate_alone(
    spec: PlantSpec, arms: Sequence[tuple[int, ArmWiring]], *, timing: BusTiming | None
) -> tuple[EmulatedCell, LoneWorld]:
    """Build emulated servos on lone arms: each by its place in `spec.arms`, its wiring with its place in this list.

    `timing` None makes every reply available at once.  Raises PlantError.
    """
    bare = without_servo_electronics(spec)
    zeros = [bare.arms[i].actuator.zero_error_rad for i, _ in arms]
    world = LoneWorld([LoneArm(bare, i) for i, _ in arms], zeros)
    emulated = [EmulatedArm(wiring, timing=timing) for _, wiring in arms]
    return EmulatedCell(emulated, world), world
