"""Joint friction of a whole plant, where any arm of it has presliding."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from sim_backend.physics.friction import DryFriction, FrictionSpec
from sim_backend.physics.spec import PlantSpec


def dry_friction(spec: PlantSpec) -> DryFriction | None:
    """Friction of all joints (J,), arms without presliding by their Coulomb friction; None where no arm has it."""
    if all(arm.friction is None for arm in spec.arms):
        return None
    parts = [arm.friction or FrictionSpec.smooth(arm.actuator) for arm in spec.arms]
    joined = FrictionSpec(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(FrictionSpec)})
    return DryFriction(joined, np.concatenate([arm.rotor_inertia for arm in spec.arms]), spec.substep_s)
