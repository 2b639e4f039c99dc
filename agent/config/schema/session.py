"""What may stand under `[session]`: how the arms go from their rest to the object and back, each by itself."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from agent.config.schema.types import Duration, Length, Strict

Way = Annotated[float, Field(gt=0.0, le=3.2)]  # rad
Rate = Annotated[float, Field(gt=0.0, le=50.0)]  # rad/s


class Session(Strict):
    """From rest to rest; the same on every host."""

    speed_max_rad_per_s: Annotated[float, Field(gt=0.0, le=2.0)] = 0.6  # of any joint between rest and grasp
    back_off_m: Length = 0.06  # from the grasp, along the gripper's axis: the place before it
    lift_m: Annotated[float, Field(ge=0.0, le=1.0)] = 0.02  # the object stands so far below its start pose
    lift_s: Duration = 3.0
    lower_s: Duration = 6.0  # from wherever the object is to where it stood
    ease_s: Duration = 1.0  # in which a journey begins
    take_up_s: Duration = 1.5  # in which an arm that has closed its gripper takes up its load share, and gives it back
    start_blend_s: Duration = 4.0  # in which a motion that begins beside the start pose comes to its own
    rate_rad_per_s: Rate = 12.0  # with which joints follow and stand
    soft_rad: Way = 0.12  # a joint that is farther off pushes no harder
    off_max_rad: Way = 0.25  # a joint that is farther from its path stops the arm; no journey begins there
