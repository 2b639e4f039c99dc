"""What may stand under `[simulation]` of a cell file."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, ClassVar

from pydantic import Field, model_validator

from agent.config.schema.types import Length, Smoothing, Strict, wrong


class Effects(Strict):
    """What a real servo adds; each can be switched off."""

    retired: ClassVar[Mapping[str, str]] = MappingProxyType(
        {
            "delay_cycles": "write loop_delay_s = delay_cycles / rate_hz at the top of the cell file, which agents, "
            "checks and plant share; effects.delay_s only where the simulated delay differs from it"
        }
    )

    friction: bool = True
    position_quantisation: bool = True
    velocity_quantisation: bool = True
    torque_quantisation: bool = True
    saturation: bool = True
    delay_s: Annotated[float, Field(ge=0.0, le=0.5)] | None = None  # of the simulated loop; None: loop_delay_s
    torque_constant_error: Annotated[float, Field(gt=-0.9, lt=1.0)] = 0.0


class Grasp(Strict):
    """Finger pads of every arm in the simulated cell; without this table grasps are welded."""

    stiffness_N_per_m: Annotated[float, Field(ge=10.0, le=1e8)]
    stiffness_Nm_per_rad: Annotated[float, Field(ge=0.01, le=1e6)]
    damping_ratio: Annotated[float, Field(ge=0.0, le=10.0)] = 0.25  # of an arm that swings on its pad
    slip_N: Annotated[float, Field(gt=0.0, le=1e4)] | None = None  # the pads slip above it; None: never
    slip_Nm: Annotated[float, Field(gt=0.0, le=1e4)] | None = None
    open_m: Length | None = None  # a grasp that has slipped so far opens for good

    @model_validator(mode="after")
    def _consistent(self) -> Grasp:
        if self.open_m is not None and self.slip_N is None:
            raise wrong(
                "open_m", found="no slip_N", expected="the force above which pads slip", remedy="give slip_N as well"
            )
        return self


class Simulation(Strict):
    """The simulated cell; what an agent does, and whether a cell may start, does not depend on it."""

    ready_s: Annotated[float, Field(ge=0.0, le=60.0)] = 0.0  # lockstep: the arms wait so long before the common start
    substeps_per_cycle: Annotated[int, Field(ge=1, le=200)] = 5
    observe_rate_hz: Annotated[float, Field(ge=0.01, le=2000.0)] = 50.0  # of the truth in the log
    friction_smooth_rad_per_s: Smoothing = 0.01
    object_mass_error: Annotated[float, Field(ge=-0.99, le=10.0)] = 0.0  # the plant's object: 1 = twice as heavy
    effects: Effects = Effects()
    grasp: Grasp | None = None  # None: welded
