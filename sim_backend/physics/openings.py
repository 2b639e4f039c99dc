"""How far each grasp is open, and how fast it opens with the joints and the object (pads.py has what comes of it).

A pad that has not slipped pulls the object at its grasp and the arm at the end effector: they lie φ apart, along which
its spring pulls.  One that has slipped, or was closed beside its place, touches the object where the end effector is
now: both get its force there, along one line.  Its opening is told in axes that turn with the object, as what has
slipped is, so that its wrench is the slope of what its spring holds; φ̇ is then the rate in these axes, and that of the
rotation vector is J_l⁻¹(φ) times the angular velocity, whose transpose turns K (φ − s) + C φ̇ into the moment.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import pinocchio as pin

from drivers.interface import Vector
from sim_backend.physics.free_arm import FreeArms

LEAST_SLIP: Final = 1e-12  # m, rad; less is rounding


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
        self._turning: dict[int, Vector] = {}  # J_l⁻¹ (3, 3) of each grasp that touches at the end effector

    def measure(self, T_world_object: pin.SE3, closed: Vector, slipped: Vector) -> Vector:
        """Openings (N, 6) at the joints of the arms' last terms, and G there; closed (N, 1): 1 for one that holds.

        slipped: (N, 6); where it is not zero (LEAST_SLIP) the pad touches at the end effector.
        """
        J, T, phi = self._J, T_world_object, np.empty((len(self._grasps), 6))
        shifted: list[bool] = np.any(np.abs(slipped) > LEAST_SLIP, axis=1).tolist()
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
            turn = R.T.dot(T_world_ee.rotation)
            phi[i, 3:] = R.dot(pin.log3(turn))
            if holds and shifted[i]:
                self._touch(i, T_world_ee.translation - T.translation, R.dot(pin.Jlog3(turn).T).dot(R.T))
            elif i in self._turning:
                del self._turning[i]
                self._of[i, 3:, J + 3 :] = -holds * np.eye(3)
        return phi

    def touches(self, grasp: int) -> bool:
        """Whether a grasp touches the object where its end effector is, by the last `measure`."""
        return grasp in self._turning

    def _touch(self, i: int, lever: Vector, turning: Vector) -> None:
        """Rows of a grasp at a place (3,) from the object's origin; turning: J_l⁻¹ (3, 3)."""
        J, rows = self._J, self._of[i]
        self._turning[i] = turning
        rows[:3, J + 3 :] = pin.skew(lever)
        rows[3:, :J] = turning.dot(rows[3:, :J])
        rows[3:, J + 3 :] = -turning

    def wrenches(self, pulls: Vector) -> Vector:
        """Wrenches (N, 6) on the object of K (φ − s) + C φ̇ (N, 6): force, and the moment at where it acts."""
        for i, turning in self._turning.items():
            pulls[i, 3:] = turning.T.dot(pulls[i, 3:])
        return pulls

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
