"""The plant that a specification asks for: welded grasps, or grasps that give."""

from __future__ import annotations

from drivers.interface import Vector
from sim_backend.physics.plant import Plant
from sim_backend.physics.snapshot import Snapshot
from sim_backend.physics.soft import SoftPlant
from sim_backend.physics.spec import PlantSpec

AnyPlant = Plant | SoftPlant


def build_plant(spec: PlantSpec) -> AnyPlant:
    """SoftPlant where the specification has pads, Plant where it has none.  Raises PlantError (GraspError)."""
    return Plant(spec) if spec.grasp is None else SoftPlant(spec)


def snapshot(plant: AnyPlant, tau_cmd_Nm: Vector) -> Snapshot:
    """This instant of a plant with commands (J,) acting; that of one whose grasps give is worked out at once."""
    if isinstance(plant, Plant):
        return plant.snapshot(tau_cmd_Nm)
    seen = plant.observe(tau_cmd_Nm)
    return Snapshot(lambda: seen)
