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
    """Whether every arm but the anchor shifts its target towards what it sees."""
    anchor: Name | None = None
    """The arm that does not, once it has taken up where the object is before the start; none: the first."""
    ready_per_s: Rate = 2.0
    """How quickly it shifts while waiting for the start."""
    track_per_s: Rate = 0.3
    """How quickly it shifts during the motion."""
    return_per_s: Rate = 0.3
    """How quickly its shift goes back during the motion to what it was at the start."""
    dead_zone_m: Annotated[float, Field(ge=0.0, le=0.05)] = 1.5e-3
    """Difference of positions that is left alone."""
    dead_zone_rad: Annotated[float, Field(ge=0.0, le=0.5)] = 8e-3
    """Difference of attitudes that is left alone."""
    max_m: Annotated[float, Field(gt=0.0, le=0.1)] = 0.02
    """Largest shift of the target."""
    max_rad: Annotated[float, Field(gt=0.0, le=0.5)] = 0.1
    """Largest turn of the target."""


class NoticingSpec(Strict):
    """From which unexpected wrench on an arm it holds (agent.control.residual): a sudden one, and one that stays."""

    enabled: bool = True
    """Whether an arm holds on an unexpected wrench."""
    fast_N: Force | None = None
    """Sudden unexpected force from which it does; none: derived from the cell, as the next three."""
    fast_Nm: Moment | None = None
    """Sudden unexpected moment from which it does."""
    slow_N: Force | None = None
    """Unexpected force that stays, from which it does."""
    slow_Nm: Moment | None = None
    """Unexpected moment that stays, from which it does."""
    against_N: Force | None = None
    """Pull against the motion from which it does, 1.05 of it down or at once, 1.25 up; none: derived, of three arms."""
    climb_N: Force | None = None
    """Climb against the motion, thrice in 0.45 s, with which 0.6 of it does; none: derived, of three arms and more."""
    brace_N: Annotated[float, Field(ge=0.0, le=20.0)] | None = None
    """Pull back, at the most, of an arm that holds and is carried on; none: 2 of three arms and more, 0 of two."""
    rate_per_s: Annotated[float, Field(gt=0.0, le=200.0)] = 30.0
    """Bandwidth of the residual."""
    slow_per_s: Annotated[float, Field(gt=0.0, le=50.0)] | None = None
    """Bandwidth of the slow channel; none: 2 of planar arms, 4 of others."""
