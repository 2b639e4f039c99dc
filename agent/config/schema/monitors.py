"""What may stand under `[safety.monitors]`: how far an arm may go before it holds by itself (agent.monitors)."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field

from agent.config.schema.types import AS_LIST, Coordinate, Strict
from agent.monitors.bounds import Name


def _ascending(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] >= value[1]:
        raise ValueError("a range from low to high")
    return value


Range = Annotated[tuple[Coordinate, Coordinate], AS_LIST, AfterValidator(_ascending)]
Part = Annotated[float, Field(gt=0.0, le=1.0)]
Watched = Annotated[Name, AS_LIST]


class MonitorsSpec(Strict):
    """Bounds of what every arm of the cell watches of itself; defaults suit any arm whose file is right."""

    off: list[Watched] = Field(default_factory=list)
    """Monitors switched off, by name; for tests and for arms that sense less than they say."""
    speed_share: Part = 0.2
    """Speed of a joint, of its servo's no-load speed, allowed beside twice what the motion asks for."""
    power_share: Annotated[float, Field(gt=0.0, le=4.0)] = 0.5
    """Power of a joint, of the most that its servos give: stall × no-load / 4."""
    position_margin_rad: Annotated[float, Field(ge=0.0, le=0.5)] = 0.02
    """Distance from the end stops of the URDF at which an arm holds."""
    workspace_m: Annotated[tuple[Range, Range, Range], AS_LIST] | None = None
    """Where the object's origin may be; none: around its motion."""
    workspace_margin_m: Annotated[float, Field(gt=0.0, le=1.0)] = 0.1
    """Room around the motion where no workspace is given."""
    limited_share: Part = 0.5
    """Part of the last 100 ticks with a torque, or a torque step, at its limit."""
    frozen_rad: Annotated[float, Field(gt=0.0, le=1.0)] = 0.02
    """Turn asked of a joint whose reading stays the same."""
    load_share: Part = 0.45
    """Root mean square torque of a joint, of its stall torque."""
    load_time_s: Annotated[float, Field(ge=1.0, le=600.0)] = 30.0
    """Time over which that mean is taken."""
    gravity_times: Annotated[float, Field(ge=0.1, le=10.0)] = 1.0
    """Factor on the derived bound of the gravity monitor."""
    temperature_margin_C: Annotated[float, Field(ge=0.0, le=20.0)] = 2.0
    """Margin to a servo's own temperature limit."""
    voltage_margin_V: Annotated[float, Field(ge=0.0, le=2.0)] = 0.2
    """Margin to a servo's own voltage limits."""
