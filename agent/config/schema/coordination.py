"""What may stand under `[controller.alignment]` and `[safety.noticing]`: how an arm lives with the others, unheard."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from agent.config.schema.types import Name, Strict

Rate = Annotated[float, Field(ge=0.0, le=20.0)]
Force = Annotated[float, Field(gt=0.0, le=1e3)]
Moment = Annotated[float, Field(gt=0.0, le=1e3)]


class AlignmentSpec(Strict):
    """Every arm but the anchor shifts its own target towards what it sees (agent.control.alignment)."""

    enabled: bool = True
    anchor: Name | None = None  # the arm that does not; None: the first of the cell
    ready_per_s: Rate = 2.0  # while waiting for the start
    track_per_s: Rate = 0.3
    dead_zone_m: Annotated[float, Field(ge=0.0, le=0.05)] = 1.5e-3
    dead_zone_rad: Annotated[float, Field(ge=0.0, le=0.5)] = 8e-3
    max_m: Annotated[float, Field(gt=0.0, le=0.1)] = 0.02
    max_rad: Annotated[float, Field(gt=0.0, le=0.5)] = 0.1


class NoticingSpec(Strict):
    """From which unexpected wrench on an arm it holds (agent.control.residual): a sudden one, and one that stays."""

    enabled: bool = True
    fast_N: Force | None = None  # None: derived from the cell (agent.config.noticing), and so the others
    fast_Nm: Moment | None = None
    slow_N: Force | None = None
    slow_Nm: Moment | None = None
    rate_per_s: Annotated[float, Field(gt=0.0, le=200.0)] = 30.0
    slow_per_s: Annotated[float, Field(gt=0.0, le=50.0)] | None = None  # None: 2 of planar arms, 4 of any other
