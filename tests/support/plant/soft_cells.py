"""The plant with grasps that give, for tests: any cell's with any pads."""

from __future__ import annotations

from dataclasses import replace

from sim_backend.physics.actuator import ActuatorSpec
from sim_backend.physics.soft import SoftPlant
from sim_backend.physics.spec import GraspSpec, PlantSpec


def soft(spec: PlantSpec, pads: GraspSpec, **changes: object) -> SoftPlant:
    return SoftPlant(replace(spec, grasp=pads, **changes))  # type: ignore[arg-type]


def viscous(n: int) -> ActuatorSpec:
    return ActuatorSpec.of(n, viscous_Nms_rad=0.5)
