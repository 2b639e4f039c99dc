"""One arm of the plant on its own, in the world frame: the terms of its motion, and how it swings on its pad."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from drivers.interface import Vector
from drivers.pads import swinging_inertia
from sim_backend.physics.composition import arm_model, frame_number
from sim_backend.physics.spec import ArmSpec

_WORLD_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


class FreeArm:
    """Model of one arm that holds nothing, placed at its base.  Raises PlantError as `arm_model`."""

    def __init__(self, arm: ArmSpec, gravity: Vector) -> None:
        model = arm_model(arm)
        for joint in range(1, model.njoints):
            if model.parents[joint] == 0:
                model.jointPlacements[joint] = arm.T_world_base * model.jointPlacements[joint]
        model.gravity = pin.Motion(np.array(gravity), np.zeros(3))
        model.armature = np.array(arm.rotor_inertia)
        self.model, self.data = model, model.createData()
        self.frame = frame_number(model, arm.ee_frame)
        self.n = int(model.nv)

    def terms(self, q: Vector, v: Vector) -> tuple[Vector, Vector, Vector, pin.SE3]:
        """Inertia (n, n), bias torques (n,), end-effector Jacobian (6, n) in world axes, and pose at q, v (n,)."""
        model, data = self.model, self.data
        bias = pin.rnea(model, data, q, v, np.zeros(self.n)).copy()
        M = pin.crba(model, data, q).copy()
        M = np.triu(M) + np.triu(M, 1).T
        J = pin.computeFrameJacobian(model, data, q, self.frame, _WORLD_AXES)
        pin.updateFramePlacement(model, data, self.frame)
        return M, bias, J, pin.SE3(data.oMf[self.frame])

    def potential(self, q: Vector) -> float:
        """Potential energy at q (n,), J."""
        return float(pin.computePotentialEnergy(self.model, self.data, q))


def swinging(arm: FreeArm, q: Vector) -> Vector:
    """(6,) kg, kg·m² with which the arm at q (n,) swings on its pad."""
    M, _, J, _ = arm.terms(q, np.zeros(arm.n))
    return swinging_inertia(J @ np.linalg.inv(M) @ J.T)
