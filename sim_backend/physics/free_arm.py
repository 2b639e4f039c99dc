"""The arms of the plant without an object, each at its base: the terms of their motion, and how they swing on a pad."""

from __future__ import annotations

import itertools

import numpy as np
import pinocchio as pin

from drivers.interface import Vector
from drivers.pads import swinging_inertia
from sim_backend.physics.composition import place_arms
from sim_backend.physics.spec import PlantSpec

_WORLD_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


class FreeArms:
    """One model of all arms, holding nothing.  Raises PlantError as `arm_model`."""

    def __init__(self, spec: PlantSpec) -> None:
        model, ends = place_arms(spec)
        self._frames = [
            model.addFrame(
                pin.Frame(f"{arm.name}/end effector", model.getJointId(joint), 0, T_joint_ee, pin.FrameType.OP_FRAME)
            )
            for arm, (joint, T_joint_ee) in zip(spec.arms, ends, strict=True)
        ]
        joints = np.cumsum([0, *(len(arm.controlled) for arm in spec.arms)]).tolist()
        self.slices = tuple(slice(a, b) for a, b in itertools.pairwise(joints))  # of each arm's joints
        model.gravity = pin.Motion(np.array(spec.gravity), np.zeros(3))
        model.armature = np.concatenate([arm.rotor_inertia for arm in spec.arms])
        self.model, self.data = model, model.createData()

    def terms(self, q: Vector, v: Vector) -> tuple[Vector, Vector]:
        """Inertia (J, J) and bias torques (J,) at q, v (J,): views until the next call.

        `end_effector` then answers for the same q.
        """
        model, data = self.model, self.data
        pin.computeJointJacobians(model, data, q)
        bias = pin.nonLinearEffects(model, data, q, v)
        return pin.crba(model, data, q), bias

    def end_effector(self, arm: int) -> tuple[Vector, pin.SE3]:
        """Jacobian (6, J) of an arm's end effector, world axes, and its pose, a view until the next call."""
        frame = self._frames[arm]
        pose = pin.updateFramePlacement(self.model, self.data, frame)
        return pin.getFrameJacobian(self.model, self.data, frame, _WORLD_AXES), pose

    def pose(self, arm: int, q: Vector) -> pin.SE3:
        """Pose of an arm's end effector at q (J,); `end_effector` answers for this q from then on."""
        pin.forwardKinematics(self.model, self.data, q)
        return pin.SE3(pin.updateFramePlacement(self.model, self.data, self._frames[arm]))

    def swinging(self, q: Vector) -> Vector:
        """(N, 6) kg, kg·m² with which each arm at q (J,) swings on its pad."""
        M, _ = self.terms(q, np.zeros_like(q))
        jacobians = [self.end_effector(i)[0][:, own] for i, own in enumerate(self.slices)]
        inertias = [np.linalg.inv(M[own, own]) for own in self.slices]
        return np.array([swinging_inertia(J @ B @ J.T) for J, B in zip(jacobians, inertias, strict=True)])

    def potential(self, q: Vector) -> float:
        """Potential energy at q (J,), J."""
        return float(pin.computePotentialEnergy(self.model, self.data, q))
