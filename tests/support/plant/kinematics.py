"""Where an arm of a plant ends, by pinocchio's kinematics of that arm alone."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from drivers.interface import Vector
from sim_backend.physics.composition import arm_model
from sim_backend.physics.spec import PlantSpec


def end_effector(spec: PlantSpec, arm: int, q: Vector) -> tuple[pin.SE3, Vector]:
    """Pose in the world of the arm at this place, at q (n,), and its Jacobian (6, n), world axes."""
    model = arm_model(spec.arms[arm])
    data, base = model.createData(), spec.arms[arm].T_world_base
    frame = max(i for i, f in enumerate(model.frames) if f.name == "ee")
    J = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
    pose = base * pin.updateFramePlacement(model, data, frame)
    return pose, np.vstack([base.rotation @ J[:3], base.rotation @ J[3:]])
