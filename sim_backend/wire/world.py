"""The physics that emulated servos move, as a Protocol; and that of a joint of no plant.

Servos, buses and clocks are outside.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol


class JointWorld(Protocol):
    """Joints of several arms under torques; time passes in whole substeps."""

    substep_s: float

    def state(self, arm: int) -> tuple[Sequence[float], Sequence[float]]:
        """Positions (rad) and velocities (rad/s) of an arm's joints, true now."""
        ...

    def apply(self, arm: int, tau_Nm: Sequence[float]) -> None:
        """Set the torques of an arm's servos; they act until set again."""
        ...

    def advance(self) -> None:
        """Let one substep pass."""
        ...


@dataclass(slots=True)
class FreeJoint:
    """One joint with its own inertia, friction and gravity, coupled to nothing."""

    q_rad: float = 0.0
    dq_rad_per_s: float = 0.0
    inertia_kg_m2: float = 0.01
    coulomb_Nm: float = 0.0
    viscous_Nm_s_per_rad: float = 0.0
    gravity_Nm: float = 0.0  # torque -gravity sin(q): hangs at zero
    knee_rad_per_s: float = 0.01

    def step(self, tau_Nm: float, dt_s: float) -> None:
        """Semi-implicit Euler, friction implicit, so that it never adds energy."""
        drag = self.viscous_Nm_s_per_rad
        if self.coulomb_Nm:
            drag += self.coulomb_Nm / math.hypot(self.dq_rad_per_s, self.knee_rad_per_s)
        if self.gravity_Nm:
            tau_Nm -= self.gravity_Nm * math.sin(self.q_rad)
        momentum = self.inertia_kg_m2 * self.dq_rad_per_s + dt_s * tau_Nm
        self.dq_rad_per_s = momentum / (self.inertia_kg_m2 + dt_s * drag)
        self.q_rad += dt_s * self.dq_rad_per_s
