"""The plant that a specification asks for: welded grasps, or grasps that give."""

from __future__ import annotations

from sim_backend.physics.plant import Plant
from sim_backend.physics.soft import SoftPlant
from sim_backend.physics.spec import PlantSpec

AnyPlant = Plant | SoftPlant


def build_plant(spec: PlantSpec) -> AnyPlant:
    """SoftPlant where the specification has pads, Plant where it has none.  Raises PlantError (GraspError)."""
    return Plant(spec) if spec.grasp is None else SoftPlant(spec)
