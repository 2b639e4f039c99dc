"""What may stand under `[session]`: how the arms go from their rest to the object and back, each by itself."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from agent.config.schema.types import Duration, Length, Strict

Way = Annotated[float, Field(gt=0.0, le=3.2)]  # rad
Rate = Annotated[float, Field(gt=0.0, le=50.0)]  # rad/s


class Session(Strict):
    """From rest to rest; the same on every host."""

    speed_max_rad_per_s: Annotated[float, Field(gt=0.0, le=2.0)] = 0.6
    """Largest speed of any joint between rest and grasp."""
    back_off_m: Length = 0.06
    """The place before the grasp: so far back along the gripper's axis."""
    lift_m: Annotated[float, Field(ge=0.0, le=1.0)] = 0.02
    """The object stands so far below its start pose."""
    lift_s: Duration = 3.0
    """Time in which it is lifted, before the trajectory."""
    lower_s: Duration = 6.0
    """Time in which it is lowered from wherever it is to where it stood."""
    ease_s: Duration = 1.0
    """Time in which a journey of the joints begins."""
    take_up_s: Duration = 1.5
    """Time in which an arm takes its load share up after the grasp, and gives it back before the release."""
    start_blend_s: Duration = 4.0
    """Time in which a motion that begins beside the start pose comes to its own."""
    rate_rad_per_s: Rate = 12.0
    """How stiffly joints follow and stand while the arm holds nothing; larger is stiffer."""
    soft_rad: Way = 0.12
    """A joint that is farther off than this pushes no harder."""
    off_max_rad: Way = 0.25
    """A joint that is farther from its path stops the arm, and no journey begins there."""
