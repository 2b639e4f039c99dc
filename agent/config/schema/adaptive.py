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
    """Gain of the mass relative to gamma; 0 pins it."""
    first_moment: Factor = 1.0
    """Gain of the first moment relative to gamma; 0 pins it."""
    inertia: Factor = 1.0
    """Gain of the inertia relative to gamma; 0 pins it."""


class ArmGainFactors(GainFactors):
    """The same for an arm, whose joints have parameters too (used when their column is on)."""

    rotor_inertia: Factor = 1.0
    """Gain of the reflected rotor inertia relative to gamma; 0 pins it."""
    viscous: Factor = 1.0
    """Gain of viscous friction relative to gamma; 0 pins it."""
    coulomb: Factor = 1.0
    """Gain of Coulomb friction relative to gamma; 0 pins it."""
    breakaway: Factor = 1.0
    """Gain of breakaway friction relative to gamma; 0 pins it."""
    load: Factor = 1.0
    """Gain of friction that grows with the load, relative to gamma; 0 pins it."""


class Bounds(Strict):
    """Box of the estimates, relative to the configured parameters of each body.

    Mass: relative_min to relative_max times the configured one.  First moment, per axis, and inertia: as far as
    relative_max times the mass can bring them with its centre slack_m away from the configured one.  An absolute
    limit replaces the upper relative one.
    """

    relative_min: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Smallest estimate of a mass, times the configured one."""
    relative_max: Annotated[float, Field(gt=0.0, le=100.0)] = 5.0
    """Largest estimate of a mass, times the configured one."""
    slack_m: Annotated[float, Field(ge=0.0, le=10.0)] = 0.03
    """How far the centre of mass may be believed from the configured one."""
    mass_max_kg: Mass | None = None
    """Absolute limit in place of relative_max."""

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
    """Absolute limit of the reflected rotor inertia; none: relative_max."""
    viscous_max_Nm_s_per_rad: Limit | None = None
    """Absolute limit of viscous friction; none: relative_max."""
    coulomb_max_Nm: Limit | None = None
    """Absolute limit of Coulomb friction; none: relative_max."""


class Adaptive(Strict):
    """The adaptive law: gains, what is unknown, where the estimates begin and how far they may go."""

    gamma: Factor = 1e-3
    """γ_i of the paper: how quickly an arm's parameters are learned."""
    gamma_object: Factor = 1.0
    """γ_O: how quickly the object's are; the paper: 1."""
    factor: ArmGainFactors = ArmGainFactors.default()
    """Gains of groups of an arm's parameters, relative to gamma; all 1 is the paper's law."""
    factor_object: GainFactors = GainFactors.default()
    """The same for the object."""
    rotor_inertia: bool = True
    """Whether rotor inertia is learned; what is off keeps its configured value."""
    viscous: bool = False
    """Whether viscous friction is learned."""
    coulomb: bool = False
    """Whether Coulomb friction is learned."""
    breakaway: bool = False
    """Whether breakaway friction is learned, where the arm file has the figure."""
    load: bool = False
    """Whether friction that grows with load is learned, where the arm file has the figures."""
    leak_per_s: Annotated[float, Field(ge=0.0, le=10.0)] = 0.0
    """How quickly estimates forget towards the cell file; 0: never."""
    start: Annotated[Start, AS_LIST] = Start.NOMINAL
    """What is believed at the start: zero, or the configured parameters times start_scale."""
    start_scale: Annotated[float, Field(ge=0.0, le=100.0)] = 1.0
    """Factor of the configured parameters at the start."""
    bounds: ArmBounds = ArmBounds.default()
    """Box of an arm's estimates."""
    bounds_object: Bounds = Bounds.default()
    """Box of the object's estimates."""
    physical: bool = True
    """Principal moments of the estimates stay those of a real body."""

    @model_validator(mode="after")
    def _scale_has_a_meaning(self) -> Adaptive:
        if self.start is Start.ZERO and self.start_scale != 1.0:
            raise wrong(
                "start_scale", found=f"{self.start_scale:g}", expected='start_scale only with start = "nominal"',
                remedy="leave it out",
            )  # fmt: skip
        return self
