"""What may stand in a cell file and in an arm file, key by key."""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from agent.config.schema.adaptive import Adaptive
from agent.config.schema.trajectory import TrajectorySpec
from agent.config.schema.types import (
    Finite,
    Name,
    NonNegative,
    PerAxis,
    Positive,
    Quaternion,
    Share,
    Strict,
    Vec3,
    wrong,
)
from agent.telemetry.row.topics import RESERVED

TASK_ROWS = 6
PERIODS_TOLERANCE = 1e-6


class DriverKind(enum.StrEnum):
    """What moves the arms of this cell."""

    SIM = "sim"
    DYNAMIXEL = "dynamixel"


class World(Strict):
    """The inertial frame {I}."""

    gravity_m_per_s2: Vec3


class Inertia(Strict):
    """Inertia tensor about the centre of mass, object axes."""

    xx: Positive
    yy: Positive
    zz: Positive
    xy: Finite = 0.0
    xz: Finite = 0.0
    yz: Finite = 0.0

    @model_validator(mode="after")
    def _physical(self) -> Inertia:
        moments = np.linalg.eigvalsh(self.matrix())
        if moments[0] <= 0.0 or moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-9):
            raise ValueError(
                "positive principal moments with the largest not above the sum of the others "
                f"(they are {', '.join(f'{m:.3g}' for m in moments)})"
            )
        return self

    def matrix(self) -> list[list[float]]:
        """(3, 3) tensor."""
        return [[self.xx, self.xy, self.xz], [self.xy, self.yy, self.yz], [self.xz, self.yz, self.zz]]


class Object(Strict):
    """The grasped rigid body; its frame is at the centre of mass."""

    mass_kg: Positive
    size_m: Annotated[tuple[Positive, Positive, Positive], Field()]
    inertia_kg_m2: Inertia
    p_start_m: Vec3
    quat_start: Quaternion


class ControllerKind(enum.StrEnum):
    """Which of the paper's laws runs."""

    KNOWN = "known"
    ADAPTIVE = "adaptive"


class VelocitySource(enum.StrEnum):
    """What the law takes as joint position and velocity."""

    SERVO = "servo"  # the servos' own values, as they are
    OBSERVER = "observer"  # fused with the commanded acceleration (agent.control.estimator)


class ObserverGains(Strict):
    """How far a servo's values correct what the observer predicts, per control period; used with velocity = "observer".

    A larger gain follows a surprise sooner and lets more of the servos' quantisation through.
    """

    position_gain: Share = 0.2  # of the position innovation, into the position
    velocity_gain: Share = 0.2  # of the velocity innovation, into the velocity
    velocity_from_position_per_s: NonNegative = 5.0  # of the position innovation, into the velocity


class Controller(Strict):
    """Gains and options of the law; a number stands for three equal entries (the paper's scalars)."""

    kind: ControllerKind
    k_p_per_s: PerAxis
    k_eps_rad_per_s: PerAxis
    k_p_rate_per_s: PerAxis | None = None  # in v̇_r; the paper: the same as k_p
    k_eps_rate_rad_per_s: PerAxis | None = None
    friction_feedforward: bool = False
    friction_smooth_rad_per_s: Positive = 0.05
    velocity: VelocitySource = VelocitySource.OBSERVER
    observer: ObserverGains = ObserverGains()
    adaptive: Adaptive = Adaptive()  # used when kind is "adaptive"


class Safety(Strict):
    """Bounds that are checked before the start and on every tick."""

    e_eta_min: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.1
    sigma_min: Positive = 0.02
    tau_step_max_fraction: Annotated[float, Field(gt=0.0, le=2.0)] = 0.5  # of tau_max, from one tick to the next
    tau_max_fraction_of_stall: Annotated[float, Field(gt=0.0, le=1.0)] = 0.5
    start_error_max_m: Positive = 0.02
    start_error_max_rad: Positive = 0.1
    tracking_error_max_m: Positive = (
        0.05  # beyond it the object is held: a neighbour, a grasp or a person is the reason
    )
    tracking_error_max_rad: Positive = 0.3
    spectral_radius_max: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.9999
    inertia_error: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.3


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
    delay_s: Annotated[float, Field(ge=0.0, le=0.5)] | None = (
        None  # of the simulated loop; None: as the cell believes, loop_delay_s
    )
    torque_constant_error: Annotated[float, Field(gt=-0.9, lt=1.0)] = 0.0


class Simulation(Strict):
    """The simulated cell; what an agent does, and whether a cell may start, does not depend on it."""

    substeps_per_cycle: Annotated[int, Field(ge=1, le=200)] = 5
    observe_rate_hz: Positive = 50.0  # of the truth in the log
    friction_smooth_rad_per_s: Positive = 0.01
    object_mass_error: Annotated[float, Field(gt=-1.0, le=10.0)] = 0.0  # the plant's object: 1 = twice as heavy
    effects: Effects = Effects()


class Report(Strict):
    """What the report measures and judges."""

    transient_s: NonNegative
    max_position_error_m: Positive | None = None
    max_attitude_error_rad: Positive | None = None


class DynamixelPort(Strict):
    """How a host reaches the servos of this arm."""

    port: str
    baud: Annotated[int, Field(gt=0)] | None = None  # None: as the arm file says


class PostureSpec(Strict):
    """Null-space posture of an arm with more than six controlled joints."""

    q_rad: list[Finite]
    stiffness_Nm_per_rad: NonNegative
    damping_Nm_s_per_rad: Positive


class Arm(Strict):
    """One arm of the cell."""

    name: Name
    model: str
    p_world_base_m: Vec3
    quat_world_base: Quaternion
    p_object_ee_m: Vec3
    quat_object_ee: Quaternion
    load_share: Annotated[float, Field(ge=0.0, le=1.0)]
    k_v_N_s_per_m: PerAxis
    k_v_Nm_s_per_rad: PerAxis | None = None  # the paper: the same number
    internal_wrench_N_Nm: tuple[Finite, Finite, Finite, Finite, Finite, Finite] | None = None  # at ee, object axes
    grip_force_max_N: Positive | None = None  # what the gripper holds by friction
    controlled: Annotated[list[str], Field(min_length=3, max_length=7)]
    locked_rad: dict[str, Finite] = Field(default_factory=dict)
    q_near_rad: list[Finite]
    posture: PostureSpec | None = None
    dynamixel: DynamixelPort | None = None


class CellFile(Strict):
    """A whole cell: the same bytes on every host."""

    format: Literal[1]
    name: Name
    driver: DriverKind
    rate_hz: Annotated[float, Field(ge=20.0, le=2000.0)]
    loop_delay_s: NonNegative | None = None  # from a sample to its torque on the joint; None: one control period
    duration_s: Positive
    world: World
    object: Object
    trajectory: TrajectorySpec
    controller: Controller
    safety: Safety = Safety()
    simulation: Simulation = Simulation()
    report: Report
    embedded: dict[str, str] = Field(default_factory=dict)  # text of the files the cell names, added while loading
    arms: Annotated[list[Arm], Field(min_length=1, max_length=8)]

    @property
    def delay_s(self) -> float:
        """Time from a sample to its torque, as agents, checks and tools believe it."""
        return self.delay_periods / self.rate_hz

    @property
    def delay_periods(self) -> float:
        """The same in control periods, 0 to 1; a millionth next to 0 or 1 is 0 or 1."""
        if self.loop_delay_s is None:
            return 1.0
        periods = self.loop_delay_s * self.rate_hz
        whole = float(round(periods))
        return whole if abs(periods - whole) <= PERIODS_TOLERANCE else periods

    @property
    def simulated_delay_s(self) -> float:
        """Time from a sample to its torque in the simulated cell."""
        own = self.simulation.effects.delay_s
        return self.delay_s if own is None else own

    @model_validator(mode="after")
    def _delay_within_a_period(self) -> CellFile:
        if self.delay_periods > 1.0:
            raise wrong(
                "loop_delay_s",
                found=f"{self.loop_delay_s:g}",
                expected=f"at most one control period, {1.0 / self.rate_hz:g} s at {self.rate_hz:g} Hz",
                remedy="lower rate_hz, or make the loop quicker; leave the key out for one period",
            )
        return self

    @model_validator(mode="after")
    def _consistent(self) -> CellFile:
        names = [a.name for a in self.arms]
        if len(set(names)) != len(names):
            raise ValueError(f"arm names that differ (they are {', '.join(names)})")
        if RESERVED & set(names):
            raise ValueError(f"arm names other than {', '.join(sorted(RESERVED))} (they are {', '.join(names)})")
        total = math.fsum(a.load_share for a in self.arms)
        if abs(total - 1.0) > 1e-9:
            raise ValueError(f"load shares that sum to 1 (they sum to {total:.9g})")
        for a in self.arms:
            if len(a.q_near_rad) != len(a.controlled):
                raise ValueError(f"one q_near_rad per controlled joint of arm {a.name}")
            if (a.posture is not None) != (len(a.controlled) > TASK_ROWS):
                raise ValueError(
                    f"a posture for arms with more than six controlled joints, and for no other ({a.name})"
                )
            if a.posture is not None and len(a.posture.q_rad) != len(a.controlled):
                raise ValueError(f"one posture.q_rad per controlled joint of arm {a.name}")
            both = set(a.controlled) & set(a.locked_rad)
            if both:
                raise ValueError(f"no joint both controlled and locked ({', '.join(sorted(both))} of arm {a.name})")
        return self


class Provenance(enum.StrEnum):
    """How far a figure can be trusted."""

    MEASURED = "measured"
    PUBLISHED = "published"
    ESTIMATED = "estimated"


class Figure(Strict):
    """One figure of an arm file with its origin."""

    value: Finite
    status: Provenance
    source: Annotated[str, Field(min_length=3)]


class ServoJoint(Strict):
    """One joint and the servos that move it."""

    name: str
    servo: str
    ids: Annotated[list[int], Field(min_length=1, max_length=2)]
    reverse: list[bool]
    zero_tick: int
    position_limit_ticks: tuple[int, int]
    rotor_inertia_kg_m2: Figure
    coulomb_Nm: Figure
    viscous_Nm_s_per_rad: Figure
    torque_constant_Nm_per_A: Figure | None = None
    no_load_current_A: Figure | None = None


class ArmFile(BaseModel):
    """An arm description; the gripper is parsed by the driver that moves it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    format: Literal[1]
    model: str
    urdf: str
    ee_frame: str
    baud: int
    protocol: float
    notes: list[str]
    sleep_rad: dict[str, float]
    joints: list[ServoJoint]
    gripper: dict[str, Any]
