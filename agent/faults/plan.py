"""Faults by name: what fails, how, from when, for how long.

`agent.faults.bench` carries them out in virtual time; those of telemetry and recorder `agent.faults.listeners`.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Any, Final

from pydantic import AfterValidator, Field, ValidationError, ValidationInfo, field_validator

from agent.config.files import CellFiles
from agent.config.schema.driver import DriverKind
from agent.config.schema.types import Name, Strict, wrong
from drivers.dynamixel.servo.counts import TICKS_PER_TURN
from drivers.interface import Refusal
from sim_backend.wire import faults as wire


class FaultPlanError(Refusal):
    """A fault that there is not, or that cannot happen to this cell."""


class Kind(enum.StrEnum):
    """How something fails."""

    OFF = "off"
    STUCK = "stuck"
    GARBAGE = "garbage"
    WRONG = "wrong"
    SLOW = "slow"
    DELAYED = "delayed"
    INTERMITTENT = "intermittent"


class Target(enum.StrEnum):
    """What fails."""

    SERVO = "servo"
    BUS = "bus"
    PORT = "port"
    AGENT = "agent"
    CLOCK = "clock"
    GRASP = "grasp"
    ARM = "arm"
    OBJECT = "object"
    OPERATOR = "operator"
    PLANT = "plant"
    HAND = "hand"
    TELEMETRY = "telemetry"
    RECORDER = "recorder"


@dataclass(frozen=True)
class Possible:
    """A fault that can be made to happen."""

    text: str
    unit: str = ""  # of its size; empty: it has none
    size: float = 0.0  # where none is given
    always: bool = False  # it is so from the beginning


POSSIBLE: Final[Mapping[tuple[Target, Kind], Possible]] = MappingProxyType(
    {
        (Target.SERVO, Kind.OFF): Possible("has no supply: no torque, no answer"),
        (Target.SERVO, Kind.STUCK): Possible("its encoder stays at one value"),
        (Target.SERVO, Kind.GARBAGE): Possible("one bit of each of its answers is flipped"),
        (Target.SERVO, Kind.WRONG): Possible("its encoder is off by so much", "deg", 5.0),
        (Target.SERVO, Kind.SLOW): Possible("warms up to 90 °C within so long", "s", 1.0),
        (Target.SERVO, Kind.DELAYED): Possible("its answers come so much later", "ms", 5.0),
        (Target.SERVO, Kind.INTERMITTENT): Possible("so many of its answers get lost", "share", 0.5),
        (Target.BUS, Kind.OFF): Possible("servos hear and obey, and no answer arrives"),
        (Target.BUS, Kind.STUCK): Possible("the adapter takes no more bytes"),
        (Target.BUS, Kind.GARBAGE): Possible("random bytes without end"),
        (Target.BUS, Kind.WRONG): Possible("so many answers arrive twice", "share", 0.5),
        (Target.BUS, Kind.DELAYED): Possible("every answer comes so much later", "ms", 5.0),
        (Target.BUS, Kind.INTERMITTENT): Possible("so many answers get lost", "share", 0.9),
        (Target.PORT, Kind.OFF): Possible("the adapter is unplugged; it is back when the fault ends"),
        (Target.AGENT, Kind.OFF): Possible("its process is gone, and nobody takes over"),
        (Target.AGENT, Kind.STUCK): Possible("its process stands still until the fault ends"),
        (Target.AGENT, Kind.GARBAGE): Possible("what it computes with is no number"),
        (Target.AGENT, Kind.WRONG): Possible("its gains are so many times as large", "times", 10.0, always=True),
        (Target.AGENT, Kind.SLOW): Possible("every cycle begins so many periods late", "periods", 1.5),
        (Target.CLOCK, Kind.WRONG): Possible("its clock is ahead by so much", "ms", 5.0, always=True),
        (Target.GRASP, Kind.OFF): Possible("the gripper loses the object for good"),
        (Target.GRASP, Kind.WRONG): Possible("it holds so far beside its place", "mm", 10.0, always=True),
        (Target.ARM, Kind.OFF): Possible("its 12 V are gone: limp, and no answer"),
        (Target.ARM, Kind.STUCK): Possible("its joints seize"),
        (Target.ARM, Kind.WRONG): Possible("so much of its largest torque is added", "share", 0.5),
        (Target.OBJECT, Kind.WRONG): Possible("weighs so many times what the cell says", "times", 1.5, always=True),
        (Target.OBJECT, Kind.STUCK): Possible("is pushed against the motion, so hard", "N", 10.0),
        (Target.OPERATOR, Kind.OFF): Possible("stops this arm alone"),
        (Target.PLANT, Kind.OFF): Possible("of a rehearsal: the simulated cell's process is gone"),
        (Target.PLANT, Kind.STUCK): Possible("of a rehearsal: the simulated cell stands still until the fault ends"),
        (Target.HAND, Kind.STUCK): Possible(
            "of a rehearsal: somebody pushes the real arm against the motion, so hard", "N", 5.0
        ),
        (Target.TELEMETRY, Kind.OFF): Possible("its process is killed; it is started anew when the fault ends"),
        (Target.TELEMETRY, Kind.STUCK): Possible("its process stands still until the fault ends"),
        (Target.TELEMETRY, Kind.GARBAGE): Possible("a stranger sends one burst of random messages under its keys"),
        (Target.TELEMETRY, Kind.WRONG): Possible("a stranger sends its rows, altered, from other files of the cell"),
        (Target.TELEMETRY, Kind.INTERMITTENT): Possible(
            "its process stands still for so much of every half second", "share", 0.5
        ),
        (Target.RECORDER, Kind.OFF): Possible("its process is killed; another one is started when the fault ends"),
        (Target.RECORDER, Kind.STUCK): Possible("its process stands still until the fault ends"),
        (Target.RECORDER, Kind.INTERMITTENT): Possible(
            "its process stands still for so much of every half second", "share", 0.5
        ),
    }
)

OF_REHEARSALS: Final = (Target.PLANT, Target.HAND)
OF_LISTENERS: Final = (Target.TELEMETRY, Target.RECORDER)
_OF_SIMULATED_ARMS: Final = frozenset({
    (Target.AGENT, Kind.OFF), (Target.GRASP, Kind.OFF), (Target.GRASP, Kind.WRONG), (Target.OPERATOR, Kind.OFF),
    (Target.CLOCK, Kind.WRONG),
})  # fmt: skip
_NAMED: Final = {f"{target}-{kind}": (target, kind) for target, kind in POSSIBLE}
NAMES: Final = tuple(_NAMED)


def _known(name: str) -> str:
    if name not in _NAMED:
        raise wrong("fault", found=name, expected=", ".join(NAMES), remedy="take one of these")
    return name


class Injection(Strict):
    """One fault of one arm; times count on the trajectory's clock."""

    fault: Annotated[str, AfterValidator(_known)]  # one of NAMES
    arm: Name | None = None  # None: the cell's first
    servo: Annotated[int, Field(ge=0, le=252)] | None = None  # of servos and their answers; None: all of the arm
    at_s: Annotated[float, Field(ge=0.0, le=1e6)] = 1.0
    for_s: Annotated[float, Field(gt=0.0, allow_inf_nan=True)] = math.inf
    size: Annotated[float, Field(gt=0.0, le=1e6)] | None = None  # in the unit of POSSIBLE; None: as it says

    @field_validator("size")
    @classmethod
    def _has_size(cls, size: float | None, info: ValidationInfo) -> float | None:
        name = info.data.get("fault")
        if size is not None and name is not None and not POSSIBLE[_NAMED[name]].unit:
            raise wrong("", found=size, expected=f"no size: {name} has none", remedy="leave it out")
        return size

    @property
    def target(self) -> Target:
        """What fails."""
        return _NAMED[self.fault][0]

    @property
    def kind(self) -> Kind:
        """How it fails."""
        return _NAMED[self.fault][1]

    @property
    def possible(self) -> Possible:
        """What it is."""
        return POSSIBLE[_NAMED[self.fault]]

    @property
    def amount(self) -> float:
        """Its size in the unit of POSSIBLE."""
        return self.possible.size if self.size is None else self.size

    @property
    def onset_s(self) -> float:
        """When it begins."""
        return 0.0 if self.possible.always else self.at_s


def require_known(name: str) -> None:
    """Raise FaultPlanError unless there is a fault of that name."""
    if name not in NAMES:
        raise FaultPlanError(
            "fault", found=repr(name), expected=f"one of {', '.join(NAMES)}",
            remedy="`coop faults list --kinds` says what they are",
        )  # fmt: skip


def injection(name: str, **given: Any) -> Injection:
    """One fault from what a command line gives; None is not given.  Raises FaultPlanError."""
    require_known(name)
    try:
        return Injection(fault=name, **{key: value for key, value in given.items() if value is not None})
    except ValidationError as error:
        first = error.errors()[0]
        raise FaultPlanError(
            f"fault {name}: {'.'.join(map(str, first['loc']))}",
            found=first["input"],
            expected=first["msg"],
            remedy="see `coop faults inject -h`",
        ) from error


def require_simulated(cell: CellFiles) -> None:
    """Refuse a cell of real arms, so that nobody takes a rehearsal for a test of them.  Raises FaultPlanError."""
    if cell.file.driver is not DriverKind.SIM:
        raise FaultPlanError(
            f"cell {cell.file.name}: driver", found=cell.file.driver.value, expected=DriverKind.SIM.value,
            remedy="faults are made in simulation alone: `--set driver=sim` rehearses with the rest of the file",
        )  # fmt: skip


def placed(faults: Sequence[Injection], arms: Sequence[str]) -> tuple[Injection, ...]:
    """The faults with their arms named.  Raises FaultPlanError for an arm that is not there."""
    for fault in faults:
        if fault.arm is not None and fault.arm not in arms:
            raise FaultPlanError("fault: arm", found=fault.arm, expected=" or ".join(arms), remedy="name an arm")
    return tuple(fault.model_copy(update={"arm": fault.arm or arms[0]}) for fault in faults)


def require_fit(faults: Sequence[Injection], looped: Sequence[str] | None) -> None:
    """Refuse faults that need a rehearsal, or servos where an arm is simulated.  Raises FaultPlanError.

    faults: `placed`; looped: arms that [hil] names, None without the table.
    """
    for fault in faults:
        if fault.target in OF_LISTENERS:
            raise FaultPlanError(
                f"fault {fault.fault}", found="arms in virtual time, whom nobody listens to",
                expected="processes: it happens without faults of arms and without [hil]",
                remedy="let it happen by itself: `coop faults inject CELL FAULT`",
            )  # fmt: skip
        if looped is None and fault.target in OF_REHEARSALS:
            raise FaultPlanError(
                f"fault {fault.fault}", found="a cell without [hil]", expected="a rehearsal: an arm in the loop",
                remedy="""name one: --set 'hil.arms=["ARM"]'""",
            )  # fmt: skip
        free = fault.target in (Target.PLANT, Target.OBJECT) or (fault.target, fault.kind) in _OF_SIMULATED_ARMS
        if looped is not None and fault.arm not in looped and not free:
            raise FaultPlanError(
                f"fault {fault.fault}: arm", found=f"{fault.arm}, which is simulated", expected=" or ".join(looped),
                remedy="name an arm in the loop with --arm",
            )  # fmt: skip


def require_happens(faults: Sequence[Injection], duration_s: float) -> None:
    """Refuse a fault that would begin when the run is over: nobody would notice it.  Raises FaultPlanError."""
    for fault in faults:
        if fault.at_s >= duration_s:
            raise FaultPlanError(
                f"fault {fault.fault} at {fault.at_s:g} s", found=f"a run of {duration_s:g} s",
                expected="an instant before its end", remedy="give a longer --duration, or an earlier --at",
            )  # fmt: skip


_WIRE: Final[Mapping[tuple[Target, Kind], wire.FaultKind]] = MappingProxyType(
    {
        (Target.SERVO, Kind.OFF): wire.FaultKind.POWER_LOSS,
        (Target.SERVO, Kind.STUCK): wire.FaultKind.ENCODER_STUCK,
        (Target.SERVO, Kind.GARBAGE): wire.FaultKind.CORRUPT,
        (Target.SERVO, Kind.WRONG): wire.FaultKind.ENCODER_OFFSET,
        (Target.SERVO, Kind.SLOW): wire.FaultKind.OVERHEAT,
        (Target.SERVO, Kind.DELAYED): wire.FaultKind.DELAY,
        (Target.SERVO, Kind.INTERMITTENT): wire.FaultKind.DROP,
        (Target.BUS, Kind.OFF): wire.FaultKind.MUTE,
        (Target.BUS, Kind.STUCK): wire.FaultKind.STALL,
        (Target.BUS, Kind.GARBAGE): wire.FaultKind.BABBLE,
        (Target.BUS, Kind.WRONG): wire.FaultKind.DUPLICATE,
        (Target.BUS, Kind.DELAYED): wire.FaultKind.DELAY,
        (Target.BUS, Kind.INTERMITTENT): wire.FaultKind.DROP,
        (Target.PORT, Kind.OFF): wire.FaultKind.PORT_LOSS,
        (Target.ARM, Kind.OFF): wire.FaultKind.POWER_LOSS,
    }
)
TICKS_PER_DEG: Final = TICKS_PER_TURN / 360.0


def on_the_wire(fault: Injection) -> wire.Fault | None:
    """The same as emulated servos and their bus take it, or None where it does not happen there; arm: `placed`."""
    kind = _WIRE.get((fault.target, fault.kind))
    if kind is None:
        return None
    given: dict[str, object] = {"kind": kind, "arm": fault.arm, "start_s": fault.at_s, "duration_s": fault.for_s}
    if fault.target in (Target.SERVO, Target.BUS):
        given["servo"] = fault.servo
    match kind:
        case wire.FaultKind.ENCODER_OFFSET:
            given["offset_ticks"] = round(fault.amount * TICKS_PER_DEG)
        case wire.FaultKind.OVERHEAT:
            given["ramp_s"] = fault.amount
        case wire.FaultKind.DELAY:
            given["delay_ms"] = fault.amount
        case wire.FaultKind.DROP | wire.FaultKind.DUPLICATE:
            given["probability"] = fault.amount
    return wire.Fault.model_validate(given)
