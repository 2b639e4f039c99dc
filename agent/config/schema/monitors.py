"""What may stand under `[safety.monitors]`: how far an arm may go before it holds by itself (agent.monitors)."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field

from agent.config.schema.types import AS_LIST, Strict
from agent.monitors.bounds import Name


def _ascending(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] >= value[1]:
        raise ValueError("a range from low to high")
    return value


Coordinate = Annotated[float, Field(ge=-100.0, le=100.0)]
Range = Annotated[tuple[Coordinate, Coordinate], AS_LIST, AfterValidator(_ascending)]
Part = Annotated[float, Field(gt=0.0, le=1.0)]
Watched = Annotated[Name, AS_LIST]


class MonitorsSpec(Strict):
    """Bounds of what every arm of the cell watches of itself; defaults suit any arm whose file is right."""

    off: list[Watched] = Field(default_factory=list)  # by name; for tests and for arms that sense less than they say
    speed_share: Part = 0.2  # of a servo's no-load speed, beside twice what the motion asks for
    power_share: Annotated[float, Field(gt=0.0, le=4.0)] = 0.5  # of the most a joint's servos give: stall x no-load / 4
    position_margin_rad: Annotated[float, Field(ge=0.0, le=0.5)] = 0.02  # before the end stops of the URDF
    workspace_m: Annotated[tuple[Range, Range, Range], AS_LIST] | None = (
        None  # of the object's origin; None: its motion
    )
    workspace_margin_m: Annotated[float, Field(gt=0.0, le=1.0)] = 0.1  # around the motion
    limited_share: Part = 0.5  # of the last 100 ticks with a torque, or a torque step, at its limit
    frozen_rad: Annotated[float, Field(gt=0.0, le=1.0)] = 0.02  # asked of a joint whose reading stays the same
    load_share: Part = 0.45  # of stall, in the mean square
    load_time_s: Annotated[float, Field(ge=1.0, le=600.0)] = 30.0  # over which that is meant
    gravity_times: Annotated[float, Field(ge=0.1, le=10.0)] = 1.0  # the derived bound
    temperature_margin_C: Annotated[float, Field(ge=0.0, le=20.0)] = 2.0  # below a servo's own limit
    voltage_margin_V: Annotated[float, Field(ge=0.0, le=2.0)] = 0.2  # within a servo's own limits
