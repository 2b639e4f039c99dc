"""What may stand under `[simulation]` of a cell file."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, ClassVar

from pydantic import Field, model_validator

from agent.config.schema.fault import Fault
from agent.config.schema.reality import Reality
from agent.config.schema.types import (
    AS_LIST,
    AngularStiffness,
    Effort,
    Instant,
    Length,
    LinearStiffness,
    Name,
    Smoothing,
    Strict,
    wrong,
)
from drivers.pads import DAMPING_RATIO
from drivers.substeps import fewest_substeps, is_short_enough, substep_s


class Effects(Strict):
    """What a real servo adds; each can be switched off."""

    retired: ClassVar[Mapping[str, str]] = MappingProxyType(
        {
            "delay_cycles": "write loop_delay_s = delay_cycles / rate_hz at the top of the cell file, which agents, "
            "checks and plant share; effects.delay_s only where the simulated delay differs from it"
        }
    )

    friction: bool = True
    """Whether joints rub."""
    position_quantisation: bool = True
    """Whether positions come in encoder steps."""
    velocity_quantisation: bool = True
    """Whether velocities come in servo steps."""
    torque_quantisation: bool = True
    """Whether torques are made in current steps."""
    saturation: bool = True
    """Whether torque ends where the servo's does."""
    delay_s: Annotated[float, Field(ge=0.0, le=0.5)] | None = None
    """Loop delay of the simulated cell; none: loop_delay_s."""
    torque_constant_error: Annotated[float, Field(gt=-0.9, lt=1.0)] = 0.0
    """Part by which the simulated torque constants are off."""


class Grasp(Strict):
    """Finger pads of every arm in the simulated cell; without this table grasps are welded."""

    stiffness_N_per_m: LinearStiffness
    """Stiffness of finger pads."""
    stiffness_Nm_per_rad: AngularStiffness
    """The same in rotation."""
    damping_ratio: Annotated[float, Field(ge=0.0, le=10.0)] = DAMPING_RATIO
    """Of an arm that swings on its pad."""
    slip_N: Annotated[float, Field(gt=0.0, le=1e4)] | None = None
    """The pads slip above this force; none: never."""
    slip_Nm: Annotated[float, Field(gt=0.0, le=1e4)] | None = None
    """Or above this moment."""
    open_m: Length | None = None
    """A grasp that has slipped so far opens for good; none: never."""

    @model_validator(mode="after")
    def _consistent(self) -> Grasp:
        if self.open_m is not None and self.slip_N is None:
            raise wrong(
                "open_m", found="no slip_N", expected="the force above which pads slip", remedy="give slip_N as well"
            )
        return self


class Push(Strict):
    """A push on the object at its frame's origin, world axes."""

    at_s: Instant
    """When, on the trajectory's clock."""
    duration_s: Annotated[float, Field(gt=0.0, le=1e6)]
    """How long."""
    force_N: Annotated[tuple[Effort, Effort, Effort], AS_LIST] = (0.0, 0.0, 0.0)
    """Force on the object, world axes."""
    moment_Nm: Annotated[tuple[Effort, Effort, Effort], AS_LIST] = (0.0, 0.0, 0.0)
    """Moment on it."""


class Opening(Strict):
    """A gripper that loses the object for good."""

    at_s: Instant
    """When, on the trajectory's clock."""
    arm: Name
    """The arm whose gripper loses the object for good."""


class Simulation(Strict):
    """The simulated cell; what an agent does, and whether real arms may start, does not depend on what it says."""

    ready_s: Annotated[float, Field(ge=0.0, le=60.0)] = 0.0
    """Lockstep: the arms wait so long before the common start."""
    substeps_per_cycle: Annotated[int, Field(ge=1, le=200)] = 5
    """Integration steps per control cycle; 180 a second at least, where the arms are simulated."""
    observe_rate_hz: Annotated[float, Field(ge=0.01, le=2000.0)] = 50.0
    """Rate of the truth in the log; in lockstep of every k-th cycle, k the nearest whole number."""
    friction_smooth_rad_per_s: Smoothing = 0.01
    """Speed over which simulated friction changes its sign."""
    object_mass_error: Annotated[float, Field(ge=-0.99, le=10.0)] = 0.0
    """Part by which the plant's object is heavier."""
    effects: Effects = Effects.default()
    """What a real servo adds."""
    grasp: Grasp | None = None
    """Finger pads; none: welded grasps."""
    reality: Reality | None = None
    """What the plant has against what the files say; none: nothing."""
    push: list[Push] = Field(default_factory=list)
    """Pushes on the object."""
    opening: list[Opening] = Field(default_factory=list)
    """Grippers that open."""
    fault: list[Fault] = Field(default_factory=list)
    """Arms that fail."""

    def require_short_steps(self, rate_hz: float) -> None:
        """Refuse integration steps that are too long for the plant.  Raises PydanticCustomError."""
        if not is_short_enough(substep_s(rate_hz, self.substeps_per_cycle)):
            raise wrong(
                "simulation.substeps_per_cycle",
                found=f"{self.substeps_per_cycle} at rate_hz = {rate_hz:g}",
                expected=f"{fewest_substeps(rate_hz)} at least: longer steps let simulated grasps swing by themselves",
                remedy="give so many, or a higher rate_hz",
            )

    def require_fit(self, joints: Mapping[str, int]) -> None:
        """Refuse what befalls arms that are not there; joints: their number by arm.  Raises PydanticCustomError."""
        if self.reality is not None:
            self.reality.require_fit(joints)
            self.reality.require_pads(welded=self.grasp is None)
            if not self.effects.friction:
                self.reality.require_rubbing()
        befallen = {"opening": [one.arm for one in self.opening], "fault": [one.arm for one in self.fault]}
        for table, arms in befallen.items():
            for i, arm in enumerate(arms):
                if arm not in joints:
                    raise wrong(
                        f"simulation.{table}.{i}.arm", found=arm, expected=" or ".join(joints),
                        remedy="name an arm of the cell",
                    )  # fmt: skip
