"""What may stand in a cell file, key by key."""

from __future__ import annotations

import enum
import math
from collections import Counter
from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, model_validator

from agent.config.schema.arm import Baud
from agent.config.schema.controller import Controller
from agent.config.schema.coordination import NoticingSpec
from agent.config.schema.session import Session
from agent.config.schema.simulation import Simulation
from agent.config.schema.tolerance import Tolerance
from agent.config.schema.trajectory import TrajectorySpec
from agent.config.schema.types import (
    AS_LIST,
    Angle,
    Attitude,
    FileStem,
    Format,
    Instant,
    Label,
    Length,
    Mass,
    Moment,
    Name,
    PerAxis,
    Quaternion,
    Share,
    Strict,
    Vec3,
    Wrench,
    wrong,
)
from agent.telemetry.row.topics import RESERVED

TASK_ROWS = 6
PERIODS_TOLERANCE = 1e-6
GRAVITY_RANGE_M_PER_S2 = (1.0, 30.0)  # the Moon has 1.6, Jupiter 25; a slip of the unit is outside


class DriverKind(enum.StrEnum):
    """What moves the arms of this cell."""

    SIM = "sim"
    DYNAMIXEL = "dynamixel"


class World(Strict):
    """The inertial frame {I}."""

    gravity_m_per_s2: Vec3

    @model_validator(mode="after")
    def _plausible(self) -> World:
        g = math.hypot(*self.gravity_m_per_s2)
        low, high = GRAVITY_RANGE_M_PER_S2
        if g and not low <= g <= high:
            raise wrong(
                "gravity_m_per_s2",
                found=f"{g:.4g} m/s²",
                expected=f"{low:g} to {high:g} m/s² in all, or zero",
                remedy="give the acceleration of what falls, world axes: [0.0, 0.0, -9.81] where z points up",
            )
        return self


class Inertia(Strict):
    """Inertia tensor about the centre of mass, object axes."""

    xx: Moment
    yy: Moment
    zz: Moment
    xy: Annotated[float, Field(ge=-100.0, le=100.0)] = 0.0
    xz: Annotated[float, Field(ge=-100.0, le=100.0)] = 0.0
    yz: Annotated[float, Field(ge=-100.0, le=100.0)] = 0.0

    @model_validator(mode="after")
    def _physical(self) -> Inertia:
        moments = np.linalg.eigvalsh(self.matrix())
        if moments[0] <= 0.0 or moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-9):
            raise wrong(
                "",
                found=f"principal moments {', '.join(f'{m:.3g}' for m in moments)}",
                expected="positive ones with the largest not above the sum of the others",
                remedy="a solid box of sides a, b, c has m (b² + c²) / 12 about a",
            )
        return self

    def matrix(self) -> list[list[float]]:
        """(3, 3) tensor."""
        return [[self.xx, self.xy, self.xz], [self.xy, self.yy, self.yz], [self.xz, self.yz, self.zz]]


class Object(Strict):
    """The grasped rigid body; its frame is at the centre of mass."""

    mass_kg: Mass
    size_m: Annotated[tuple[Length, Length, Length], AS_LIST]
    inertia_kg_m2: Inertia
    p_start_m: Vec3
    quat_start: Quaternion


class Safety(Strict):
    """Bounds that are checked before the start and on every tick."""

    e_eta_min: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.1
    sigma_min: Annotated[float, Field(gt=0.0, le=1.0)] = 0.02
    tau_step_max_fraction: Annotated[float, Field(gt=0.0, le=2.0)] = 0.5  # of tau_max, from one tick to the next
    tau_max_fraction_of_stall: Annotated[float, Field(gt=0.0, le=1.0)] = 0.5
    start_error_max_m: Annotated[float, Field(gt=0.0, le=1.0)] = 0.02
    start_error_max_rad: Attitude = 0.1
    # beyond it the object is held: a neighbour, a grasp or a person is the reason
    tracking_error_max_m: Annotated[float, Field(gt=0.0, le=1.0)] = 0.05
    tracking_error_max_rad: Attitude = 0.3
    spectral_radius_max: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.9999
    hold_speed_max_rad_per_s: Annotated[float, Field(gt=0.0, le=20.0)] = 1.5  # in HOLD; faster: it is braked
    blind_s: Annotated[float, Field(ge=0.02, le=2.0)] = 0.2  # without a state; then the servos' watchdogs stop the arm
    recover_s: Annotated[float, Field(ge=0.0, le=60.0)] = 2.0  # after that, for the arm to come back; 0: it is lost
    noticing: NoticingSpec = NoticingSpec()
    inertia_error: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.3


class Report(Strict):
    """What the report measures and judges."""

    transient_s: Instant
    max_position_error_m: Annotated[float, Field(gt=0.0, le=100.0)] | None = None
    max_attitude_error_rad: Attitude | None = None


class DynamixelPort(Strict):
    """How a host reaches the servos of this arm."""

    port: Annotated[Label, Field(pattern=r"^\S+$")]
    baud: Baud | None = None  # None: as the arm file says


class PostureSpec(Strict):
    """Null-space posture of an arm with more than six controlled joints."""

    q_rad: list[Angle]
    stiffness_Nm_per_rad: Annotated[float, Field(ge=0.0, le=1e4)]
    damping_Nm_s_per_rad: Annotated[float, Field(gt=0.0, le=1e4)]


class Arm(Strict):
    """One arm of the cell."""

    absent: ClassVar[Mapping[str, str]] = MappingProxyType(
        {
            "k_v_Nm_s_per_rad": "give the rotation a k_v of its own, N·m·s/rad: the number of k_v_N_s_per_m is mostly "
            "far too much for a wrist; 0.1 is a beginning, `coop tune` finds a better one"
        }
    )

    name: Name
    host: Annotated[str, Field(pattern=r"^[A-Za-z0-9]([A-Za-z0-9.-]{0,251}[A-Za-z0-9])?$")] | None = None  # None: any
    model: FileStem
    p_world_base_m: Vec3
    quat_world_base: Quaternion
    p_object_ee_m: Vec3
    quat_object_ee: Quaternion
    load_share: Share  # the paper allows 0: such an arm damps the object and carries nothing
    k_v_N_s_per_m: PerAxis
    k_v_Nm_s_per_rad: PerAxis  # the paper prints one number for both, which is far too much for a wrist
    internal_wrench_N_Nm: Wrench | None = None  # at ee, object axes
    grip_force_max_N: Annotated[float, Field(gt=0.0, le=1e4)] | None = None  # what the gripper holds by friction
    controlled: Annotated[list[Label], Field(min_length=3, max_length=7)]
    locked_rad: dict[Label, Angle] = Field(default_factory=dict)
    q_near_rad: list[Angle]
    rest_rad: dict[Label, Angle] = Field(default_factory=dict)  # where the arm rests; else as its arm file says
    grip_width_m: Length | None = None  # of the object between the fingers; None: its size in their direction
    posture: PostureSpec | None = None
    dynamixel: DynamixelPort | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Arm:
        n = len(self.controlled)
        if len(self.q_near_rad) != n:
            raise wrong(
                "q_near_rad",
                found=f"{len(self.q_near_rad)} values",
                expected=f"one q_near_rad per controlled joint, {n}",
                remedy="give angles near those that hold the object at the start",
            )
        if (self.posture is not None) != (n > TASK_ROWS):
            raise wrong(
                "posture", found="none" if self.posture is None else f"one with {n} controlled joints",
                expected="a posture for more than six controlled joints, and for no other",
                remedy="give q_rad, stiffness and damping, or leave it out",
            )  # fmt: skip
        if self.posture is not None and len(self.posture.q_rad) != n:
            raise wrong(
                "posture.q_rad", found=f"{len(self.posture.q_rad)} values", expected=f"one per controlled joint, {n}",
                remedy="give the angles the arm is to rest at in its null space",
            )  # fmt: skip
        both = set(self.controlled) & set(self.locked_rad)
        if both:
            raise wrong(
                "locked_rad", found=", ".join(sorted(both)), expected="no joint that is controlled as well",
                remedy="name each joint either as controlled or as locked",
            )  # fmt: skip
        return self


class CellFile(Strict):
    """A whole cell: the same bytes on every host."""

    format: Format
    name: Name
    driver: Annotated[DriverKind, AS_LIST]
    rate_hz: Annotated[float, Field(ge=20.0, le=2000.0)]
    loop_delay_s: Annotated[float, Field(ge=0.0)] | None = None  # from a sample to its torque; None: one period
    duration_s: Annotated[float, Field(gt=0.0, le=1e6)]
    world: World
    object: Object
    trajectory: TrajectorySpec
    controller: Controller
    safety: Safety = Safety()
    tolerance: Tolerance = Tolerance()
    simulation: Simulation = Simulation()
    session: Session | None = None  # None: the arms begin with the object in their grippers
    report: Report
    embedded: dict[str, str] = Field(default_factory=dict)  # text of the files the cell names, added while loading
    arms: Annotated[list[Arm], Field(min_length=1, max_length=8)]

    @property
    def p_place_m(self) -> tuple[float, float, float]:
        """Where the object stands before the run: its start pose, or below it where a session lifts it."""
        lift_m = 0.0 if self.session is None else self.session.lift_m
        size = math.hypot(*self.world.gravity_m_per_s2)
        if not lift_m or not size:
            return self.object.p_start_m
        (x, y, z), (a, b, c) = self.object.p_start_m, self.world.gravity_m_per_s2
        k = lift_m / size
        return (x + k * a, y + k * b, z + k * c)

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
        if self.loop_delay_s is not None and self.delay_periods > 1.0:
            raise wrong(
                "loop_delay_s",
                found=f"{self.loop_delay_s:g}",
                expected=f"at most one control period, {1.0 / self.rate_hz:g} s at {self.rate_hz:g} Hz",
                remedy="lower rate_hz, or make the loop quicker; leave the key out for one period",
            )
        return self

    @model_validator(mode="after")
    def _arms_agree(self) -> CellFile:
        names = [a.name for a in self.arms]
        repeated = [name for name, count in Counter(names).items() if count > 1]
        if repeated:
            raise wrong(
                "arms", found=", ".join(names), expected="arm names that differ", remedy=f"rename one {repeated[0]}"
            )
        reserved = RESERVED & set(names)
        if reserved:
            raise wrong(
                "arms", found=", ".join(sorted(reserved)), remedy="rename that arm",
                expected=f"arm names other than {', '.join(sorted(RESERVED))}, which topics have",
            )  # fmt: skip
        total = math.fsum(a.load_share for a in self.arms)
        if abs(total - 1.0) > 1e-9:
            raise wrong(
                "arms", found=f"a sum of {total:.9g}", expected="load shares that sum to 1",
                remedy="correct load_share of the arms",
            )  # fmt: skip
        anchor, names = self.controller.alignment.anchor, [a.name for a in self.arms]
        if anchor is not None and anchor not in names:
            raise wrong(
                "controller.alignment.anchor", found=repr(anchor), expected=" or ".join(names),
                remedy="name one of the cell's arms",
            )  # fmt: skip
        self.simulation.require_fit({a.name: len(a.controlled) for a in self.arms})
        if self.driver is DriverKind.DYNAMIXEL:
            for a in self.arms:
                if a.dynamixel is None:
                    raise wrong(
                        "arms", found=f"no port of arm {a.name}", expected="dynamixel = { port = ... } of every arm",
                        remedy='add it, or take driver = "sim"',
                    )  # fmt: skip
        return self
