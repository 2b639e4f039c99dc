"""A cell from rest to rest: grasps that give, close where they are, and let go to begin again."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from drivers.interface import Vector
from sim_backend.physics.soft import SoftPlant


class HandledPlant(SoftPlant):
    """The soft plant with what hands and a support do to it.  Raises PlantError as SoftPlant."""

    def take_hold(self, arm: int) -> None:
        """Close the grasp of one arm (its place) as it stands: its pad is not stretched."""
        self._arrive()
        self._pads.close(arm)
        self._openings.close(arm)
        self._linearise()  # the opening of a grasp that was open is known from here on
        self._pads.rest_at(arm, self._phi[arm], self._T.rotation)
        self._linearise()

    def let_go(self, q: Vector, T_world_object: pin.SE3) -> None:
        """Open all grasps, and stand with the arms at q (J,) and the object at its pose, all at rest."""
        for name in self.spec.names:
            self.release(name)
        self._behind = False
        self._q, self._T = np.array(q), pin.SE3(T_world_object)
        self._v[:] = 0.0
        if self._gears is not None:
            self._gears.along(self.dq)
        self._linearise()

    def end_effector(self, arm: int) -> pin.SE3:
        """True pose of the end effector of an arm (its place)."""
        self._arrive()
        return self._arms.pose(arm, self._q)

    @property
    def object_twist(self) -> Vector:
        """True twist (6,) of the object's frame, world axes: a view."""
        return self._v[self.joint_count :]
