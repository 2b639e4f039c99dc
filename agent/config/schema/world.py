"""What may stand under `[world]` and `[object]` of a cell file."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from agent.config.schema.types import (
    AS_LIST,
    MOMENTS_KG_M2,
    Coordinate,
    Length,
    Mass,
    Moment,
    Quaternion,
    Strict,
    Vec3,
    wrong,
)

GRAVITY_RANGE_M_PER_S2 = (1.0, 30.0)  # the Moon has 1.6, Jupiter 25; a slip of the unit is outside


class World(Strict):
    """The inertial frame {I}."""

    gravity_m_per_s2: Vec3
    """Acceleration of what falls, world axes; zero for a cell without weight."""

    @model_validator(mode="after")
    def _plausible(self) -> World:
        g = math.hypot(*self.gravity_m_per_s2)
        low, high = GRAVITY_RANGE_M_PER_S2
        if g and not low <= g <= high:
            raise wrong(
                "gravity_m_per_s2",
                found=f"{g:.4g} m/s²",
                expected=f"{low:g} to {high:g} m/s² in all, or zero",
                remedy="give the acceleration of what falls, world axes: [0.0, 0.0, -9.81] where z points up",
            )
        return self


class Table(Strict):
    """A table below the cell; where there is none, arms are not compared with it."""

    z_m: Coordinate
    """Height of its top, world z; z points up."""


class Inertia(Strict):
    """Inertia tensor about the centre of mass, object axes."""

    xx: Moment
    """Moment about the object's x axis, at the centre of mass."""
    yy: Moment
    """Moment about the object's y axis, at the centre of mass."""
    zz: Moment
    """Moment about the object's z axis, at the centre of mass."""
    xy: Annotated[float, Field(ge=-100.0, le=100.0)] = 0.0
    """Product of inertia, object axes, tensor entry (with its sign)."""
    xz: Annotated[float, Field(ge=-100.0, le=100.0)] = 0.0
    """Product of inertia, object axes, tensor entry (with its sign)."""
    yz: Annotated[float, Field(ge=-100.0, le=100.0)] = 0.0
    """Product of inertia, object axes, tensor entry (with its sign)."""

    @model_validator(mode="after")
    def _physical(self) -> Inertia:
        moments = np.linalg.eigvalsh(self.matrix())
        if moments[0] < MOMENTS_KG_M2[0] or moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-9):
            raise wrong(
                "",
                found=f"principal moments {', '.join(f'{m:.3g}' for m in moments)}",
                expected=f"{MOMENTS_KG_M2[0]:g} at least, the largest not above the sum of the others",
                remedy="a solid box of sides a, b, c has m (b² + c²) / 12 about a",
            )
        return self

    def matrix(self) -> list[list[float]]:
        """(3, 3) tensor."""
        return [[self.xx, self.xy, self.xz], [self.xy, self.yy, self.yz], [self.xz, self.yz, self.zz]]


class Object(Strict):
    """The grasped rigid body; its frame is at the centre of mass."""

    mass_kg: Mass
    """Mass of the object."""
    size_m: Annotated[tuple[Length, Length, Length], AS_LIST]
    """Sides of the box around the object, along its axes: pictures, plausibility and collisions."""
    inertia_kg_m2: Inertia
    """Inertia about the centre of mass, object axes."""
    p_start_m: Vec3
    """Where the object is before the run, world axes."""
    quat_start: Quaternion
    """Its attitude there, w x y z."""
