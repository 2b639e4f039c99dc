"""What may stand in an arm file, key by key."""

from __future__ import annotations

import enum
import math
from collections import Counter
from collections.abc import Sequence
from typing import Annotated

from pydantic import AfterValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from agent.config.schema.types import AS_LIST, Angle, FileStem, Format, Label, Strict, nearest, wrong
from drivers.dynamixel.servo.codes import BAUD_RATES, MAX_ID
from drivers.dynamixel.servo.counts import TICK_RAD, TICKS_PER_TURN
from drivers.dynamixel.servo.models import SERVOS

PROTOCOL = 2.0  # that the driver speaks
LAST_TICK = 4095


def known_baud(baud: int) -> int:
    """A speed of the bus, bit/s, that servos can be set to."""
    if baud not in BAUD_RATES.values():
        rates = ", ".join(str(rate) for rate in sorted(BAUD_RATES.values()))
        raise wrong("", found=baud, expected=f"one of {rates}", remedy="give the speed the servos are set to, bit/s")
    return baud


def _known_servo(name: str) -> str:
    if name not in SERVOS:
        remedy = nearest(name, SERVOS) or "name the servo as its label does"
        raise wrong("", found=repr(name), expected="one of " + ", ".join(SERVOS), remedy=remedy)
    return name


def _known_protocol(protocol: float) -> float:
    if protocol not in (1.0, PROTOCOL):  # of 1.0 the whole file says which servos it concerns
        raise wrong("", found=protocol, expected="2.0", remedy="it is what the driver speaks")
    return protocol


Baud = Annotated[int, AfterValidator(known_baud)]
Tick = Annotated[int, Field(ge=0, le=LAST_TICK)]
PartLength = Annotated[float, Field(ge=1e-3, le=1.0)]  # m, of a part of a gripper
ServoId = Annotated[int, Field(ge=0, le=MAX_ID)]


class Provenance(enum.StrEnum):
    """How far a figure can be trusted."""

    MEASURED = "measured"
    PUBLISHED = "published"
    ESTIMATED = "estimated"


class Figure(Strict):
    """One figure of an arm file with its origin; none of them can be negative."""

    value: Annotated[float, Field(ge=0.0, le=100.0)]
    status: Annotated[Provenance, AS_LIST]
    source: Annotated[str, Field(min_length=3)]


class PositiveFigure(Figure):
    """One that cannot be zero either."""

    value: Annotated[float, Field(gt=0.0, le=100.0)]


class Servos(Strict):
    """The servos of one joint or gripper: the first leads, the second is its shadow."""

    servo: Annotated[str, AfterValidator(_known_servo)]
    ids: Annotated[list[ServoId], Field(min_length=1, max_length=2)]
    reverse: list[bool]
    zero_tick: Tick
    position_limit_ticks: Annotated[tuple[Tick, Tick], AS_LIST]

    @model_validator(mode="after")
    def _consistent(self) -> Servos:
        if len(self.reverse) != len(self.ids):
            raise wrong(
                "reverse",
                found=f"{len(self.reverse)} entries for {len(self.ids)} servos",
                expected="one per servo",
                remedy="say of every ID whether its servo is mounted the other way round",
            )
        low, high = self.position_limit_ticks
        if low >= high:
            raise wrong(
                "position_limit_ticks",
                found=f"{low} to {high}",
                expected="the lower limit first, below the upper one",
                remedy="an absolute encoder cannot tell turns apart: both lie within one turn",
            )
        return self


class ServoJoint(Servos):
    """One joint and the servos that move it."""

    name: Label
    rotor_inertia_kg_m2: Figure
    coulomb_Nm: Figure
    viscous_Nm_s_per_rad: Figure
    torque_constant_Nm_per_A: PositiveFigure | None = None
    no_load_current_A: Figure | None = None
    breakaway_Nm: Figure | None = None  # what sticking holds above Coulomb
    stribeck_rad_per_s: PositiveFigure | None = None
    stribeck_exponent: PositiveFigure | None = None
    load_friction: Figure | None = None  # per N·m of the motor
    breakaway_load_friction: Figure | None = None

    @property
    def sticks(self) -> bool:
        """Whether the friction of the simulated joint has presliding."""
        return any(f is not None for f in (self.breakaway_Nm, self.load_friction, self.breakaway_load_friction))

    @model_validator(mode="after")
    def _load_friction_lets_it_move(self) -> ServoJoint:
        shares = [f.value for f in (self.load_friction, self.breakaway_load_friction) if f is not None]
        if sum(shares) >= 1.0:
            raise wrong(
                "load_friction",
                found=f"{sum(shares):g} with breakaway_load_friction",
                expected="together less than 1: no motor moves a joint whose friction grows as quickly as its torque",
                remedy="both are in N·m per N·m of the motor: identify them",
            )
        return self

    @model_validator(mode="after")
    def _breakaway_falls_off(self) -> ServoJoint:
        extra = self.breakaway_Nm is not None or self.breakaway_load_friction is not None
        if extra and self.stribeck_rad_per_s is None:
            raise wrong(
                "stribeck_rad_per_s",
                found="nothing",
                expected="the speed over which breakaway falls off",
                remedy="give it with the breakaway",
            )
        return self


ROD_MIN = 1.01  # times the radius of the horn that it is pushed by
LEVER_MIN = 1e-3  # of the radius of a gripper's horn, at either end of its way
GRIP_KEYS = ("closed_tick", "open_tick", "horn_radius_m", "rod_length_m", "grip_effort")


class GripperJoint(Servos):
    """The gripper, with the geometry that turns its servo's angle into the way of the fingers."""

    closed_tick: Tick | None = None
    open_tick: Tick | None = None
    horn_radius_m: PartLength | None = None
    rod_length_m: PartLength | None = None
    grip_effort: PositiveFigure | None = None  # share of stall torque with which it closes and keeps closed
    pad_friction: PositiveFigure | None = None  # coefficient between finger and object

    @property
    def obeys(self) -> bool:
        """Whether its servo can be told to close on the bus of the arm."""
        return SERVOS[self.servo].protocol == PROTOCOL

    @property
    def missing(self) -> tuple[str, ...]:
        """Keys without which nobody can close it on an object and know that it has."""
        return tuple(key for key in GRIP_KEYS if getattr(self, key) is None)

    @model_validator(mode="after")
    def _fingers_go_all_the_way(self) -> GripperJoint:
        horn, rod = self.horn_radius_m, self.rod_length_m
        if horn is not None and rod is not None and rod < ROD_MIN * horn:
            raise wrong(
                "rod_length_m",
                found=f"{rod} m beside horn_radius_m of {horn} m",
                expected=f"a rod longer than the radius of the horn, {ROD_MIN} times at least",
                remedy="measure both from pin to pin: a shorter rod would stop the horn",
            )
        if self.closed_tick is not None and self.open_tick is not None:
            self._require_opening(self.closed_tick - self.zero_tick, self.open_tick - self.zero_tick)
        return self

    @staticmethod
    def _require_opening(closed: int, opened: int) -> None:
        """See that the fingers go apart all the way; ticks of the horn from where it stands across their way.

        They do as long as it does not pass ±90°, where it points along their way; beyond, with ticks that go down.
        """
        stroke, half_turn = opened - closed, TICKS_PER_TURN // 2
        levers = [math.copysign(1.0, stroke) * math.cos(ticks * TICK_RAD) for ticks in (closed, opened)]
        if not 0 < abs(stroke) < half_turn or min(levers) < LEVER_MIN:
            raise wrong(
                "open_tick",
                found=f"{opened:+d} ticks from zero_tick, where closed_tick is {closed:+d}",
                expected="fingers that go apart all the way from closed to open, and a horn that does not pass ±90°",
                remedy="read both positions in `coop motors scan`, fingers shut and wide open, and look at zero_tick",
            )


class ArmFile(Strict):
    """An arm description."""

    format: Format
    model: FileStem
    urdf: FileStem
    ee_frame: Label
    baud: Baud
    protocol: Annotated[float, AfterValidator(_known_protocol)]
    notes: list[str]
    sleep_rad: dict[Label, Angle]
    joints: Annotated[list[ServoJoint], Field(min_length=1, max_length=16)]
    gripper: GripperJoint

    @model_validator(mode="after")
    def _consistent(self) -> ArmFile:
        if self.protocol != PROTOCOL:
            raise self._undriven()
        names = [joint.name for joint in self.joints]
        _refuse_repeated("joints", "name", names)
        _refuse_repeated("joints", "ID", [i for joint in (*self.joints, self.gripper) for i in joint.ids])
        unknown = [name for name in self.sleep_rad if name not in names]
        if unknown:
            raise wrong(
                "sleep_rad",
                found=", ".join(map(repr, unknown)),
                expected="joints of the arm: " + ", ".join(names),
                remedy=nearest(unknown[0], names) or "name its joints",
            )
        return self

    def _undriven(self) -> PydanticCustomError:
        """Why nothing drives the arm: its servos are said to speak a protocol that the driver does not."""
        servos = {joint.name: joint.servo for joint in self.joints} | {"gripper": self.gripper.servo}
        fit = [f"{name} ({servo})" for name, servo in servos.items() if SERVOS[servo].protocol == PROTOCOL]
        never = [f"{name} ({servo})" for name, servo in servos.items() if SERVOS[servo].protocol != PROTOCOL]
        remedies = []
        if fit:
            remedies.append(f"give {', '.join(fit)} firmware of Protocol 2.0 (DYNAMIXEL Wizard), then write 2.0 here")
        if never:
            remedies.append(f"none exists for {', '.join(never)}: never commanded")
        return wrong(
            "protocol", found=f"{self.protocol}, whose servos cannot be driven",
            expected="2.0, the one that the driver speaks", remedy="; ".join(remedies),
        )  # fmt: skip


def _refuse_repeated(key: str, what: str, values: Sequence[object]) -> None:
    repeated = [value for value, count in Counter(values).items() if count > 1]
    if repeated:
        raise wrong(
            key, found=f"{what} {repeated[0]!r} more than once", expected=f"one {what} for each",
            remedy=f"give every one its own {what}",
        )  # fmt: skip
