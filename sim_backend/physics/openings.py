"""How far each grasp is open, and how fast it opens with the joints and the object (pads.py has what comes of it)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from drivers.interface import Vector
from sim_backend.physics.free_arm import FreeArms


class Openings:
    """The openings of N grasps.

    G (6 N, J + 6): joint velocities and the object's twist, world axes, to the rate of all openings; the rows of a
    grasp that does not hold are zero.
    """

    def __init__(self, arms: FreeArms, grasps: Sequence[pin.SE3], joint_count: int) -> None:
        """grasps: pose of each on the object; all of them hold."""
        self._arms = arms
        self._grasps = [pin.SE3(grasp) for grasp in grasps]
        self._J = joint_count
        self.G = np.zeros((6 * len(grasps), joint_count + 6))
        self._of = self.G.reshape(len(grasps), 6, joint_count + 6)
        self._of[:, :, joint_count:] = -np.eye(6)

    def measure(self, T_world_object: pin.SE3, closed: Vector) -> Vector:
        """Openings (N, 6) at the joints of the arms' last terms, and G there; closed (N, 1): 1 for one that holds."""
        J, T, phi = self._J, T_world_object, np.empty((len(self._grasps), 6))
        for i, grasp in enumerate(self._grasps):
            holds = float(closed[i, 0])
            jacobian, T_world_ee = self._arms.end_effector(i)
            T_world_grasp = T * grasp
            if holds:
                self._of[i, :, :J] = jacobian
            x, y, z = (holds * (T_world_grasp.translation - T.translation)).tolist()
            self._of[i, :3, J + 3 :] = ((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0))
            phi[i, :3] = T_world_ee.translation - T_world_grasp.translation
            R = T_world_grasp.rotation
            phi[i, 3:] = R.dot(pin.log3(R.T.dot(T_world_ee.rotation)))
        return phi

    def gaps(self, opening: Vector, closed: Vector) -> tuple[Vector, Vector]:
        """Sizes (N,) m and (N,) rad of openings (N, 6); NaN for a grasp that does not hold."""
        gap = np.where(closed > 0.0, opening, np.nan)
        return np.linalg.norm(gap[:, :3], axis=1), np.linalg.norm(gap[:, 3:], axis=1)

    def keep(self, closed: Vector) -> None:
        """The grasps that hold from now on; closed (N, 1) as in `measure`."""
        self._of *= closed[:, :, None]

    def close(self, grasp: int) -> None:
        """One grasp holds again; `measure` tells the rest of its rows."""
        self._of[grasp, :, self._J :] = -np.eye(6)
