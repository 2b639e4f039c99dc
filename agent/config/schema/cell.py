"""What may stand in a cell file, key by key."""

from __future__ import annotations

import math
from collections import Counter
from typing import Annotated

from pydantic import Field, model_validator

from agent.config.schema.controller import Controller
from agent.config.schema.coordination import NoticingSpec
from agent.config.schema.driver import DriverKind
from agent.config.schema.floating import Floating
from agent.config.schema.hil import Hil
from agent.config.schema.member import Arm
from agent.config.schema.monitors import MonitorsSpec
from agent.config.schema.session import Session
from agent.config.schema.simulation import Simulation
from agent.config.schema.tolerance import Tolerance
from agent.config.schema.trajectory import TrajectorySpec
from agent.config.schema.types import (
    AS_LIST,
    Attitude,
    Format,
    Instant,
    Name,
    Strict,
    wrong,
)
from agent.config.schema.world import Object, Table, World
from agent.telemetry.row.topics import RESERVED

PERIODS_TOLERANCE = 1e-6
DECAY_LEAST_PER_S = 0.02  # of errors, whatever the rate


class Safety(Strict):
    """Bounds that are checked before the start and on every tick."""

    e_eta_min: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.1
    """Smallest |e_η| at the start: below it the attitude error is near half a turn, where the law has no direction."""
    sigma_min: Annotated[float, Field(gt=0.0, le=1.0)] = 0.02
    """Least 1/‖J⁻¹‖ of an arm's task Jacobian, a bound of its smallest singular value; the agent holds below it."""
    tau_step_max_fraction: Annotated[float, Field(gt=0.0, le=2.0)] = 0.5
    """Torque change from one tick to the next, of the torque bound."""
    tau_max_fraction_of_stall: Annotated[float, Field(gt=0.0, le=1.0)] = 0.5
    """Torque bound of each joint, of its stall torque."""
    start_error_max_m: Annotated[float, Field(gt=0.0, le=1.0)] = 0.02
    """The start is refused with the object farther than this from its desired position."""
    start_error_max_rad: Attitude = 0.1
    """The start is refused with the object turned by more than this from its desired attitude."""
    tracking_error_max_m: Annotated[float, Field(gt=0.0, le=1.0)] = 0.05
    """Beyond it the object is held: a neighbour, a grasp or a person is the reason."""
    tracking_error_max_rad: Attitude = 0.3
    """Attitude error beyond which the object is held."""
    spectral_radius_max: Annotated[float, Field(gt=0.0, lt=1.0)] | None = None
    """Largest spectral radius of a period that a check accepts; none: errors fall by 2 % a second, 0.9999 at 200 Hz."""
    hold_speed_max_rad_per_s: Annotated[float, Field(gt=0.0, le=20.0)] = 1.5
    """A joint that is faster while an arm holds is braked."""
    blind_s: Annotated[float, Field(ge=0.02, le=2.0)] = 0.2
    """Time without a state after which the agent falls silent, so that the servos' watchdogs stop the arm."""
    recover_s: Annotated[float, Field(ge=0.0, le=60.0)] = 2.0
    """Time after that in which the arm may come back; 0: it is lost at once."""
    noticing: NoticingSpec = NoticingSpec.default()
    """From which unexpected wrench an arm holds."""
    monitors: MonitorsSpec = MonitorsSpec.default()
    """What an arm watches in every mode that commands torque, and the bounds."""
    collision_margin_m: Annotated[float, Field(ge=0.0, le=0.5)] = 0.005
    """Least distance of bodies along the motion; below it `coop check` refuses."""
    inertia_error: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.3
    """Part by which the arms' inertia may be off, for checks and `coop tune`."""


class Report(Strict):
    """What the report measures and judges."""

    transient_s: Instant
    """Errors are judged after so much of the trajectory."""
    max_position_error_m: Annotated[float, Field(gt=0.0, le=100.0)] | None = None
    """Largest position error after it that `coop run --strict` accepts; none: not judged."""
    max_attitude_error_rad: Attitude | None = None
    """The same for the attitude."""


class CellFile(Strict):
    """A whole cell: the same bytes on every host."""

    format: Format
    """Version of this file format."""
    name: Name
    """Name of the cell, in topics and file names."""
    driver: Annotated[DriverKind, AS_LIST]
    """What moves the arms: sim, or the servos."""
    rate_hz: Annotated[float, Field(ge=20.0, le=2000.0)]
    """Control rate; higher allows stiffer gains, the servo bus bounds it."""
    loop_delay_s: Annotated[float, Field(ge=0.0)] | None = None
    """Time from a sample to its torque, at most one period; none: one period."""
    duration_s: Annotated[float, Field(gt=0.0, le=1e6)]
    """Length of a run."""
    world: World
    """The inertial frame."""
    table: Table | None = None
    """The table that the cell stands on; none: nothing is compared with it."""
    object: Object
    """The grasped rigid body; its frame is at the centre of mass."""
    trajectory: TrajectorySpec
    """The desired motion of the object."""
    controller: Controller
    """The law and its gains."""
    safety: Safety = Safety.default()
    """Bounds checked before the start and on every tick."""
    tolerance: Tolerance = Tolerance.default()
    """Errors that check, tune and study count with."""
    simulation: Simulation = Simulation.default()
    """The simulated cell; agents do not read it."""
    hil: Hil | None = None
    """Real arms that rehearse with simulated partners and object; none: no arm is in the loop."""
    session: Session | None = None
    """From rest to the object and back; none: the arms begin with the object in their grippers."""
    floating: Floating | None = None
    """Arms that a hand guides (`coop float`); none: every arm works."""
    report: Report
    """What the report measures and judges."""
    embedded: dict[str, str] = Field(default_factory=dict)
    """Text of files that the cell names, by name; added while loading, not written by hand."""
    arms: Annotated[list[Arm], Field(min_length=1, max_length=8)]
    """The arms, one table each."""

    @property
    def looped(self) -> tuple[str, ...]:
        """The arms that [hil] has in the loop; none without it."""
        return () if self.hil is None else tuple(self.hil.arms)

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
    def radius_max(self) -> float:
        """Largest spectral radius per period that a check accepts."""
        given = self.safety.spectral_radius_max
        return math.exp(-DECAY_LEAST_PER_S / self.rate_hz) if given is None else given

    @property
    def observe_every(self) -> int:
        """Cycles from one observation of the simulated truth to the next."""
        return max(1, round(self.rate_hz / self.simulation.observe_rate_hz))

    @property
    def simulated_delay_s(self) -> float:
        """Time from a sample to its torque in the simulated cell."""
        own = self.simulation.effects.delay_s
        return self.delay_s if own is None else own

    @model_validator(mode="after")
    def _table_lies_level(self) -> CellFile:
        x, y, z = self.world.gravity_m_per_s2
        if self.table is not None and (z > 0.0 or math.hypot(x, y) > 0.1 * math.hypot(x, y, z)):
            raise wrong(
                "table", found=f"gravity {list(self.world.gravity_m_per_s2)}", expected="a world whose z points up",
                remedy="leave [table] out, or turn the world",
            )  # fmt: skip
        return self

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
    def _marks_differ(self) -> CellFile:
        by_mark: dict[int, str] = {}
        for a in self.arms:
            other = None if a.mark is None else by_mark.setdefault(a.mark, a.name)
            if other not in (None, a.name):
                raise wrong(
                    "arms", found=f"mark {a.mark} of {other} and of {a.name}", expected="a mark of its own for each",
                    remedy="give one of them another, then `coop motors mark`",
                )  # fmt: skip
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
        self.tolerance.require_fit(self.rate_hz)
        self.simulation.require_fit({a.name: len(a.controlled) for a in self.arms})
        if self.simulation.reality is not None:
            self.simulation.reality.require_delay(self.simulated_delay_s, self.tolerance, self.rate_hz)
        if self.hil is not None:
            self.hil.require_fit(names, self.rate_hz, simulated=self.driver is DriverKind.SIM)
        if self.floating is not None:
            self.floating.require_fit(names, self.tolerance)
            if self.hil is not None:
                raise wrong(
                    "floating", found="[hil] beside it", expected="one of them",
                    remedy="arms that float rehearse nothing: remove one table",
                )  # fmt: skip
        if self.driver is DriverKind.SIM:
            self.simulation.require_short_steps(self.rate_hz)
        else:
            for a in self.arms:
                if a.dynamixel is None:
                    raise wrong(
                        "arms", found=f"no port of arm {a.name}", expected="dynamixel = { port = ... } of every arm",
                        remedy='add it, or take driver = "sim"',
                    )  # fmt: skip
        return self
