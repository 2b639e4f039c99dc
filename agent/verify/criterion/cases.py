"""Cases of the criterion: which loop, where on the trajectory, in which reality."""

from __future__ import annotations

import enum
import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from agent.control.errors import Gains
from agent.control.estimator import Observer
from drivers.pads import DAMPING_RATIO

SOFTER_LINEAR, SOFTER_ANGULAR = 10.0, 5.0  # than the softest stated pad


class Demand(enum.Enum):
    """Which loop is to be stable."""

    BARE = "arm alone"
    HOLDING = "arm alone with the object"
    RIGID = "cell with rigid grasps"
    SOFT = "cell with soft grasps"
    ALIGNING = "cell that aligns itself"


@dataclass(frozen=True, slots=True)
class Case:
    """One loop in one reality."""

    demand: Demand
    place: int
    delay_periods: float  # from a sample to its torque, in truth
    inertia: float  # of the arms, times the believed one
    load: float  # of the object, likewise
    arm: int | None = None  # of BARE and HOLDING
    k_t: float = 0.0  # N/m of the grasps; zero: they do not give
    k_r: float = 0.0  # N·m/rad


@dataclass(frozen=True, slots=True)
class Aligning:
    """Self-alignment of all arms but one, as fast as it gets."""

    anchor: int
    per_s: float


@dataclass(frozen=True)
class Loop:
    """Rate, gains and observer of all arms: what is to be judged."""

    period_s: float
    gains: tuple[Gains, ...]
    observer: Observer | None  # the same in all arms; None: the law takes what is measured
    aligning: Aligning | None = None


@dataclass(frozen=True)
class Ranges:
    """How far reality may be from what the files say.  Raises ValueError for what is no range."""

    delay_periods: tuple[float, float, float]  # shortest, believed and longest delay of the loop
    inertia_error: float = 0.3  # of the arms
    object_error: float = 0.2  # of the object's mass and inertia
    friction: float = 0.6  # least, of the viscous friction
    pads_N_per_m: tuple[float, float] = (1e3, 1e6)
    pads_Nm_per_rad: tuple[float, float] = (5.0, 1e3)
    pads_damping_ratio: float = DAMPING_RATIO

    def __post_init__(self) -> None:
        for low, high in (self.pads_N_per_m, self.pads_Nm_per_rad, (1.0, 1.0 + self.inertia_error)):
            if not 0.0 < low <= high < math.inf:
                raise ValueError(f"no range: {low} to {high}")
        if not 0.0 <= self.delay_periods[0] <= self.delay_periods[1] <= self.delay_periods[2] < math.inf:
            raise ValueError(f"no delays in ascending order: {self.delay_periods}")

    @property
    def delays(self) -> tuple[float, ...]:
        """Delays that are looked at, the longest first."""
        return tuple(sorted(set(self.delay_periods), reverse=True))

    @property
    def inertias(self) -> tuple[float, ...]:
        """The arms' inertia, times the believed one."""
        return tuple(sorted({1.0 - self.inertia_error, 1.0, 1.0 + self.inertia_error}))

    @property
    def loads(self) -> tuple[float, ...]:
        """The object's inertia, times the believed one."""
        return tuple(sorted({1.0 - self.object_error, 1.0, 1.0 + self.object_error}))

    def grasps(self, per_decade: int) -> list[tuple[float, float]]:
        """Pairs (N/m, N·m/rad) from a little softer than the softest stated pad to the stiffest."""
        linear = _steps(self.pads_N_per_m[0] / SOFTER_LINEAR, self.pads_N_per_m[1], per_decade)
        angular = _steps(self.pads_Nm_per_rad[0] / SOFTER_ANGULAR, self.pads_Nm_per_rad[1], per_decade)
        return list(itertools.product(linear, angular))


def _steps(low: float, high: float, per_decade: int) -> list[float]:
    """Both ends and what lies between, at most so far apart."""
    count = max(1, math.ceil(per_decade * math.log10(high / low) - 1e-9))
    return [float(x) for x in np.geomspace(low, high, count + 1)]


def alone(arms: int, ranges: Ranges, places: Iterable[int], delays: Iterable[float]) -> list[Case]:
    """Every arm bare and with the object."""
    each = list(itertools.product(places, delays, ranges.inertias, range(arms)))
    without = [Case(Demand.BARE, place, delay, s, 1.0, arm) for place, delay, s, arm in each]
    return without + [Case(Demand.HOLDING, *c[:3], load, c[3]) for c in each for load in ranges.loads]


def rigid(ranges: Ranges, places: Iterable[int], delays: Iterable[float], demand: Demand = Demand.RIGID) -> list[Case]:
    """The cell on grasps that do not give."""
    return [Case(demand, *c) for c in itertools.product(places, delays, ranges.inertias, ranges.loads)]


def soft(ranges: Ranges, place: int, delay: float, per_decade: int) -> list[Case]:
    """The cell on grasps of every stiffness, with the arms' inertia and the object's at both ends."""
    ends = sorted({(s, load) for s in ranges.inertias[::2] for load in ranges.loads[::2]})
    every = itertools.product(ranges.grasps(per_decade), ends)
    return [Case(Demand.SOFT, place, delay, s, load, None, k_t, k_r) for (k_t, k_r), (s, load) in every]


def near(ranges: Ranges, case: Case, factor: float) -> list[Case]:
    """The same on grasps softer and stiffer by a factor, as far as they are in the range."""
    (low_t, low_r), (high_t, high_r) = ranges.grasps(1)[0], ranges.grasps(1)[-1]
    around = (1.0 / factor, 1.0, factor)
    pairs = {
        (min(max(case.k_t * a, low_t), high_t), min(max(case.k_r * b, low_r), high_r)) for a in around for b in around
    }
    return [replace(case, k_t=k_t, k_r=k_r) for k_t, k_r in sorted(pairs - {(case.k_t, case.k_r)})]
