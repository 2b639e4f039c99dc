"""What may stand under `[controller.adaptive]` of a cell file."""

from __future__ import annotations

import enum
from typing import Annotated

from pydantic import Field, model_validator

from agent.config.schema.types import AS_LIST, Factor, Mass, Strict, wrong

Limit = Annotated[float, Field(gt=0.0, le=100.0)]


class Start(enum.StrEnum):
    """What the agent believes before the first tick."""

    ZERO = "zero"  # nothing at all
    NOMINAL = "nominal"  # the configured parameters times start_scale


class GainFactors(Strict):
    """Gain of one group of parameters relative to the scalar gain; all 1 is the paper's law, 0 pins the group."""

    mass: Factor = 1.0
    first_moment: Factor = 1.0
    inertia: Factor = 1.0


class ArmGainFactors(GainFactors):
    """The same for an arm, whose joints have parameters too (used when their column is on)."""

    rotor_inertia: Factor = 1.0
    viscous: Factor = 1.0
    coulomb: Factor = 1.0
    breakaway: Factor = 1.0
    load: Factor = 1.0


class Bounds(Strict):
    """Box of the estimates, relative to the configured parameters of each body.

    Mass: relative_min to relative_max times the configured one.  First moment, per axis, and inertia: as far as
    relative_max times the mass can bring them with its centre slack_m away from the configured one.  An absolute
    limit replaces the upper relative one.
    """

    relative_min: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    relative_max: Annotated[float, Field(gt=0.0, le=100.0)] = 5.0
    slack_m: Annotated[float, Field(ge=0.0, le=10.0)] = 0.03
    mass_max_kg: Mass | None = None

    @model_validator(mode="after")
    def _ordered(self) -> Bounds:
        if self.relative_min > self.relative_max:
            raise wrong(
                "relative_min",
                found=f"{self.relative_min:g}",
                expected=f"relative_min ≤ relative_max, {self.relative_max:g}",
                remedy="lower it, or raise relative_max",
            )
        return self


class ArmBounds(Bounds):
    """The same for an arm with its joints."""

    rotor_inertia_max_kg_m2: Limit | None = None
    viscous_max_Nm_s_per_rad: Limit | None = None
    coulomb_max_Nm: Limit | None = None


class Adaptive(Strict):
    """The adaptive law: gains, what is unknown, where the estimates begin and how far they may go."""

    gamma: Factor = 1e-3  # γ_i of the paper
    gamma_object: Factor = 1.0  # γ_O; the paper: 1
    factor: ArmGainFactors = ArmGainFactors()
    factor_object: GainFactors = GainFactors()
    rotor_inertia: bool = True  # columns; a parameter whose column is off keeps its configured value
    viscous: bool = False
    coulomb: bool = False
    breakaway: bool = False  # this and load: where the arm file has the figure
    load: bool = False  # load_friction and breakaway_load_friction
    leak_per_s: Annotated[float, Field(ge=0.0, le=10.0)] = 0.0  # of the estimates, towards what is configured
    start: Annotated[Start, AS_LIST] = Start.NOMINAL
    start_scale: Annotated[float, Field(ge=0.0, le=100.0)] = 1.0
    bounds: ArmBounds = ArmBounds()
    bounds_object: Bounds = Bounds()
    physical: bool = True  # principal moments stay physical

    @model_validator(mode="after")
    def _scale_has_a_meaning(self) -> Adaptive:
        if self.start is Start.ZERO and self.start_scale != 1.0:
            raise wrong(
                "start_scale", found=f"{self.start_scale:g}", expected='start_scale only with start = "nominal"',
                remedy="leave it out",
            )  # fmt: skip
        return self
