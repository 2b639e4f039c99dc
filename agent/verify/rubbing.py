"""Friction of an arm's joints that hardly move, all places at once: what they resist by, and what is fed against it.

By agent.control.friction at no speed, so that breakaway has not fallen off; arrays are (n,) or (T, n).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agent.config.friction import joint_friction, unfiled
from agent.config.schema.arm import ServoJoint
from agent.config.schema.tolerance import Tolerance
from agent.control.models import Matrix
from drivers.interface import Vector

BREAKAWAY = 1.5  # times Coulomb friction, what a joint at rest may resist, whatever its file says


@dataclass(frozen=True, eq=False)
class Rubbing:
    """Of the controlled joints, as the arm file has it."""

    coulomb: Vector
    breakaway: Vector
    load: Vector  # per N·m of the motor, of a joint that moves
    breakaway_load: Vector
    viscous: Vector
    unfiled: tuple[float, float]  # breakaway, times Coulomb friction, and load friction beside those of the file

    @classmethod
    def of(cls, servos: Sequence[ServoJoint], tolerance: Tolerance) -> Rubbing:
        """Of these joints, in a cell that states this."""
        found = [joint_friction(servo) for servo in servos]
        return cls(
            coulomb=np.array([joint.coulomb_Nm for joint in found]),
            breakaway=np.array([joint.breakaway_Nm for joint in found]),
            load=np.array([joint.load for joint in found]),
            breakaway_load=np.array([joint.breakaway_load for joint in found]),
            viscous=np.array([joint.viscous_Nm_s_per_rad for joint in found]),
            unfiled=unfiled(tolerance, servos),
        )

    @property
    def load_at_rest(self) -> Vector:
        """(n,) per N·m of the motor, of a joint at rest."""
        return self.load + self.breakaway_load

    def moving(self, tau: Matrix) -> Matrix:
        """Least (T, n) that joints resist by while motors give tau (T, n): of their breakaway nothing is left."""
        return self.coulomb + self.load * np.abs(tau)

    def at_rest(self, tau: Matrix) -> Matrix:
        """What joints at rest resist by, as the arm file says."""
        return self.coulomb + self.breakaway + self.load_at_rest * np.abs(tau)

    def at_most(self, tau: Matrix) -> Matrix:
        """The same with what the cell states beside, and `BREAKAWAY` where that is less."""
        more, more_load = self.unfiled
        constant = np.maximum(BREAKAWAY * self.coulomb, (1.0 + more) * self.coulomb + self.breakaway)
        return constant + (self.load_at_rest + more_load) * np.abs(tau)

    def fed(self, tau_rest: Matrix, sign: Matrix) -> Matrix:
        """Γ (T, n) of the feed-forward at the motors' torques tau_rest + sign Γ: `agent.control.friction.solved`."""
        constant, load = self.coulomb + self.breakaway, self.load_at_rest
        size, along = np.abs(tau_rest), np.where(tau_rest >= 0.0, sign, -sign)
        bound = (constant + load * size) / (1.0 - load * along)
        turned: Matrix = (constant - load * size) / (1.0 + load * along)
        return np.where(size + along * bound >= 0.0, bound, turned)
