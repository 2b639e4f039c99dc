"""Cases of the criterion: which loop, where on the trajectory, in which reality; and their spectral radii, in stacks.

Cases that differ in numbers only are computed together, and their motion, which knows no gains, is computed once.
"""

from __future__ import annotations

import enum
import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from agent.control.errors import Gains
from agent.control.estimator import Observer
from agent.verify.criterion import bodies
from agent.verify.criterion.bodies import Bodies, Motion, Pose, Springs, Truth
from agent.verify.criterion.loop import Laws, Shifting, laws, spectral_radii
from drivers.interface import Vector

SOFTER_LINEAR, SOFTER_ANGULAR = 10.0, 5.0  # than the softest stated pad
STACK = 16  # cases at a time: more of them do not fit into the cache


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
    pads_damping_ratio: float = 0.25

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


@dataclass(frozen=True, eq=False)
class Block:
    """Cases that differ in inertia and stiffness only, and their motion between two samples."""

    cases: tuple[Case, ...]
    motion: Motion

    def only(self, k: int) -> Block:
        """Case k alone."""
        return Block((self.cases[k],), self.motion.only(k))


def blocks(poses: Sequence[Pose], loop: Loop, ranges: Ranges, cases: Sequence[Case]) -> list[Block]:
    """The cases in stacks; poses: one per place.  Of the loop its period and anchor count, not its gains."""
    groups: dict[tuple[Case, bool], list[Case]] = {}
    for case in dict.fromkeys(cases):
        groups.setdefault((replace(case, inertia=0.0, load=0.0, k_t=0.0, k_r=0.0), case.k_t > 0.0), []).append(case)
    stacks = [group[k : k + STACK] for group in groups.values() for k in range(0, len(group), STACK)]
    return [
        Block(tuple(s), _bodies(poses[s[0].place], ranges, s).motion(loop.period_s, s[0].delay_periods)) for s in stacks
    ]


def _bodies(at: Pose, ranges: Ranges, stack: Sequence[Case]) -> Bodies:
    case = stack[0]
    truth = Truth(np.array([c.inertia for c in stack]), np.array([c.load for c in stack]), ranges.friction)
    if case.arm is not None:
        return (bodies.bare if case.demand is Demand.BARE else bodies.holding)(at, case.arm, truth)
    if case.k_t > 0.0:
        k_t, k_r = np.array([[c.k_t, c.k_r] for c in stack]).T
        return bodies.soft(at, truth, Springs(k_t, k_r, ranges.pads_damping_ratio))
    one = bodies.rigid(at, truth)
    return one.seen_by(2) if case.demand is Demand.ALIGNING else one


@dataclass(frozen=True)
class Judge:
    """Poses and a loop, whose laws are made once per pose."""

    poses: Sequence[Pose]
    loop: Loop
    _laws: dict[int, Laws] = field(default_factory=dict, repr=False)

    def radii(self, block: Block) -> Vector:
        """Spectral radius of every case of the block."""
        case, observer = block.cases[0], self.loop.observer
        law = self._at(case.place)
        if case.demand is Demand.ALIGNING:
            return self._aligning(block, law)
        if case.arm is not None:
            law = law.of([case.arm])
        elif case.demand is Demand.RIGID:
            law = law.together()
        return spectral_radii(block.motion, law, observer)

    def _aligning(self, block: Block, law: Laws) -> Vector:
        aligning, m = self.loop.aligning, len(law.R)
        if aligning is None:
            raise TypeError("a cell that does not align itself has no such case")
        per_tick, anchor = aligning.per_s * self.loop.period_s, aligning.anchor
        if block.cases[0].k_t == 0.0:
            shifting = Shifting(slice(m, None), per_tick)
            return spectral_radii(block.motion, law.anchor_and_followers(anchor), self.loop.observer, shifting)
        # the anchor last, so that the followers' rows are in one piece
        order = [i for i in range(len(law.S)) if i != anchor] + [anchor]
        shifting = Shifting(slice(0, m * (len(order) - 1)), per_tick)
        rows = np.concatenate([np.arange(m * i, m * (i + 1)) for i in order])
        return spectral_radii(block.motion.reordered(rows), law.of(order), self.loop.observer, shifting)

    def _at(self, place: int) -> Laws:
        if place not in self._laws:
            self._laws[place] = laws(self.poses[place], self.loop.gains)
        return self._laws[place]
