"""What may stand under `[tolerance]` of a cell file: how far reality may be from what the cell's files say.

Every key is the largest error to be lived with, in both directions where a sign makes sense.  The gains are judged by
it (`coop check`, `coop tune`), simulated realities are drawn within it, and from it follows what is no trip of noticing
and monitors; no torque depends on it.
"""

from __future__ import annotations

import math
from typing import Annotated, Final

from pydantic import AfterValidator, Field

from agent.config.schema.types import AS_LIST, AngularStiffness, LinearStiffness, Strict, wrong
from drivers.pads import DAMPING_RATIO

ZEROS_PLANAR_RAD: Final = math.radians(0.5)
ZEROS_SPATIAL_RAD: Final = math.radians(0.1)  # six joints add up what three do not
PLANAR_JOINTS: Final = 3  # three controlled joints move an arm in a plane, more do not (agent.control.models)


def _ascending(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] > value[1]:
        raise ValueError("a range from low to high")
    return value


def _around_one(value: tuple[float, float]) -> tuple[float, float]:
    if not value[0] <= 1.0 <= value[1]:
        raise ValueError("a range with 1 in it, which is what the files say")
    return _ascending(value)


Distance = Annotated[float, Field(ge=0.0, le=0.1)]
Turn = Annotated[float, Field(ge=0.0, le=0.2)]
Part = Annotated[float, Field(ge=0.0, le=0.9)]  # of what the files say
Breakaway = Annotated[float, Field(ge=0.0, le=5.0)]  # times Coulomb friction
LoadPart = Annotated[float, Field(ge=0.0, le=0.5)]  # of the motor's torque
Times = Annotated[float, Field(ge=0.0, le=10.0)]  # what the files say
Factors = Annotated[tuple[Times, Times], AS_LIST, AfterValidator(_around_one)]


def refuse_overtaking(key: str, jitter_s: float, rate_hz: float) -> None:
    """Refuse a jitter of the delay with which torques would overtake each other.  Raises PydanticCustomError."""
    if 2.0 * jitter_s * rate_hz >= 1.0:
        raise wrong(
            key, found=f"{jitter_s:g} s", expected=f"below half a period, {0.5 / rate_hz:g} s",
            remedy="lower it: a torque would overtake the one before",
        )  # fmt: skip


class Tolerance(Strict):
    """Errors of a cell that check, tune and study count with."""

    base_m: Distance = 1e-3
    """Where a base stands."""
    base_rad: Turn = math.radians(0.5)
    """How it is turned; 0.5°."""
    grasp_m: Distance = 2e-3
    """Where a gripper holds the object."""
    grasp_rad: Turn = 0.0
    """How it is turned there."""
    zeros_rad: Turn | None = None
    """Zero of each joint; none: 0.5° of a planar arm, 0.1° of any other."""
    masses: Part = 0.1
    """Part of the masses of an arm's links."""
    object: Part = 0.2
    """Part of the object's mass and inertia."""
    object_centre_m: Distance = 0.0
    """The object's centre of mass beside its frame."""
    friction: Factors = (0.6, 1.5)
    """Times the friction in the arm files, from to."""
    breakaway: Breakaway = 0.0
    """Friction above Coulomb at rest, times that, of arms whose files have none; 0: none is drawn."""
    load_friction: LoadPart = 0.0
    """Friction per N·m of the motor, of arms whose files have none; 0: none is drawn."""
    joints_alike: bool = True
    """Whether one factor is that of all joints' friction of an arm, and one that of all its masses; false: of each."""
    torque_constant: Part = 0.1
    """Part, of each servo."""
    pads_N_per_m: Annotated[tuple[LinearStiffness, LinearStiffness], AS_LIST, AfterValidator(_ascending)] = (1e3, 1e6)
    """Stiffness of a grasp, from to."""
    pads_Nm_per_rad: Annotated[tuple[AngularStiffness, AngularStiffness], AS_LIST, AfterValidator(_ascending)] = (
        5.0,
        1e3,
    )
    """The same in rotation."""
    pads_alike: bool = True
    """Whether all grasps of a reality are of one stiffness; false: each is drawn for itself."""
    pads_damping_ratio: Annotated[float, Field(ge=0.0, le=10.0)] = DAMPING_RATIO
    """Of an arm that swings on its pad."""
    delay: Factors = (0.8, 1.25)
    """Times the loop's delay, from to."""
    skew_s: Annotated[float, Field(ge=0.0, le=1.0)] = 5e-3
    """Between the starts of two arms."""
    backlash_rad: Annotated[float, Field(ge=0.0, le=0.1)] = 0.0
    """Of the gears of each joint, from one end of the gap to the other; 0: none is drawn."""
    delay_jitter_s: Annotated[float, Field(ge=0.0, le=0.5)] = 0.0
    """By which the loop's delay differs from tick to tick; 0: none is drawn."""

    def require_fit(self, rate_hz: float) -> None:
        """Refuse a jitter with which torques would overtake each other.  Raises PydanticCustomError."""
        refuse_overtaking("tolerance.delay_jitter_s", self.delay_jitter_s, rate_hz)

    def zeros_of(self, joints: int) -> float:
        """Error of the zero of each joint of an arm with so many controlled joints, rad."""
        if self.zeros_rad is not None:
            return self.zeros_rad
        return ZEROS_PLANAR_RAD if joints <= PLANAR_JOINTS else ZEROS_SPATIAL_RAD
