"""The joint torques with which the grasps act on the arms, in the mean since they were last asked for.

What moves an arm beside its motors and its friction is the object: M a + c − τ, with the arm's own M and c and the
acceleration that the closed chain has found.  The mean over a control period is the impulse that a lone arm has to be
given to move along.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from drivers.interface import Vector
from sim_backend.physics.free_arm import FreeArms
from sim_backend.physics.spec import PlantSpec


class GraspMeter:
    """Sums up grasp torques (J,) of all arms' joints; calls change no bit of the motion."""

    def __init__(self, joint_count: int) -> None:
        self._sum = np.zeros(joint_count)
        self._count = 0

    def add(self, torque_Nm: Vector) -> None:
        """Torques (J,) of one substep."""
        self._sum += torque_Nm
        self._count += 1

    def blow(self, momentum: Vector, substep_s: float) -> None:
        """Momenta (J,) N·m·s that the grasps gave at once, at the begin of a substep."""
        self._sum += momentum / substep_s

    def take(self) -> Vector:
        """Mean (J,) N·m since the last call; zeros where no substep has passed, as on a support."""
        mean: Vector = self._sum / max(1, self._count)
        self._sum[:], self._count = 0.0, 0
        return mean


class ChainGrasps(GraspMeter):
    """The same for a closed chain, whose solver tells accelerations but not the torques of its grasps."""

    def __init__(self, spec: PlantSpec) -> None:
        arms = FreeArms(spec)
        self._model, self._data = arms.model, arms.data
        self._rotor_inertia = np.array(arms.model.armature)
        super().__init__(arms.model.nv)

    def observe(self, q: Vector, v: Vector, a: Vector, armature: Vector, tau_Nm: Vector) -> None:
        """One substep at q, v with accelerations a; armature (J,) and torques τ (J,) as the chain had them."""
        needed = pin.rnea(self._model, self._data, q, v, a)
        self.add(needed + (armature - self._rotor_inertia) * a - tau_Nm)

    def strike(self, q: Vector, dv: Vector, added: Vector, given: Vector, substep_s: float) -> None:
        """Teeth that met at q before a substep: speeds changed by dv, rotors counted less by `added`, motors gave."""
        self.blow(pin.crba(self._model, self._data, q).dot(dv) + added * dv - given, substep_s)
