"""The criterion: below one must be the spectral radius of every loop that reality may make of a cell.

The loops are each arm alone, bare and with the object, the rigid cell, the cell on soft grasps, and, where arms align
themselves, the cell as it does so; with grasps from a little softer than the softest stated pad to the stiffest, the
arms' inertia off by the stated error either way (the object's with it), friction at its stated least, and the loop's
delay at its stated ends and as believed.

Soft grasps are looked at with all stiffnesses at the first place and the longest delay.  The worst of them are looked
at again more finely, at the other delays, where the rigid cell is worst, and with arms that align themselves.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from agent.verify.criterion.bodies import Pose
from agent.verify.criterion.cases import Case, Demand, Loop, Ranges, alone, near, rigid, soft
from agent.verify.criterion.judge import SPATIAL_ROWS, Block, Judge, blocks

PER_DECADE_PLANAR, PER_DECADE_SPATIAL = 3, 1
FINER = ((4, 10.0**0.5), (2, 10.0**0.25))  # how many soft cases have their neighbours looked at, and how far these are
SUSPECTS = 8  # soft cases that are looked at elsewhere too
MARGIN_SUSPECTS = 4  # of all cases, with which the longest delay is looked for
PLACES_ALONE = 4  # at which the arms are looked at alone
DELAY_MAX_PERIODS = 3.0  # up to which the longest delay is looked for
DELAY_STEP = 1 / 16  # of a period, to which it is found
KEPT = 12  # worst cases of a demand: enough for the suspects, whatever delays they have in common
STABLE = 1.0


@dataclass(frozen=True, slots=True)
class Found:
    """A case and its spectral radius."""

    radius: float
    case: Case


@dataclass(frozen=True)
class Criterion:
    """The worst cases of every demand, the largest radius first, and the longest delay that all survive."""

    cases: tuple[Found, ...]
    delay_margin_s: float | None  # None: something is unstable at the shortest stated delay
    delay_looked_at_s: float

    @property
    def worst(self) -> Mapping[Demand, Found]:
        """The worst case of every demand."""
        return {d: f for d in Demand if (f := next((f for f in self.cases if f.case.demand is d), None)) is not None}

    @property
    def radius(self) -> float:
        """The largest of all but of the slow motion in which arms align themselves."""
        return max(f.radius for d, f in self.worst.items() if d is not Demand.ALIGNING)


def examine(poses: Sequence[Pose], loop: Loop, ranges: Ranges) -> Criterion:
    """The loop at these poses along the trajectory, the start first."""
    judge = Judge(poses, loop)
    found = sweep(judge, ranges)
    margin = delay_margin(judge, ranges, [f.case for f in found if f.case.demand is not Demand.ALIGNING])
    T = loop.period_s
    return Criterion(tuple(found), None if margin is None else margin * T, DELAY_MAX_PERIODS * T)


def sweep(judge: Judge, ranges: Ranges) -> list[Found]:
    """The worst cases of every demand, the largest radius first."""
    every, count = range(len(judge.poses)), len(judge.loop.gains)
    longest, *others = ranges.delays
    if count == 1:
        return rank(judge, ranges, alone(1, ranges, every, ranges.delays), kept=KEPT)
    found = rank(judge, ranges, rigid(ranges, every, ranges.delays), kept=KEPT)
    elsewhere = found[0].case.place
    found += rank(judge, ranges, alone(count, ranges, _places(judge, {elsewhere}), ranges.delays), kept=KEPT)
    found += _soft(judge, ranges, elsewhere, longest, others)
    return sorted(found, key=_by_radius)


def _places(judge: Judge, more: Iterable[int]) -> list[int]:
    """Where the arms are looked at alone."""
    every = range(len(judge.poses))
    return sorted({0, *more, *every[:: max(1, len(every) // PLACES_ALONE)]})


def _soft(judge: Judge, ranges: Ranges, elsewhere: int, longest: float, others: Sequence[float]) -> list[Found]:
    found = rank(judge, ranges, soft(ranges, 0, longest, per_decade(judge.poses[0])), kept=KEPT)
    for count, factor in FINER:
        around = [c for f in found[:count] for c in near(ranges, f.case, factor)]
        found += rank(judge, ranges, around, least=_kept(found))
        found.sort(key=_by_radius)
    suspects = [f.case for f in found[:SUSPECTS]]
    again = [replace(c, delay_periods=delay) for c in suspects for delay in others]
    again += [replace(c, place=elsewhere) for c in suspects if elsewhere]
    found += rank(judge, ranges, again, least=_kept(found))
    if judge.loop.aligning is not None:
        aligning = rigid(ranges, {0, elsewhere}, [longest], Demand.ALIGNING)
        aligning += [replace(c, demand=Demand.ALIGNING) for c in suspects]
        found += rank(judge, ranges, aligning, kept=1)
    return found


def _kept(ranked: Sequence[Found]) -> float:
    """The radius below which a case is not one of the worst."""
    return ranked[KEPT - 1].radius if len(ranked) >= KEPT else 0.0


def per_decade(at: Pose) -> int:
    """Stiffnesses per decade that are looked at: an eigenvalue problem of a planar cell costs a thirtieth of others."""
    return PER_DECADE_PLANAR if len(at.P) < SPATIAL_ROWS else PER_DECADE_SPATIAL


def rank(
    judge: Judge, ranges: Ranges, cases: Sequence[Case], *, kept: int | None = None, least: float = 0.0
) -> list[Found]:
    """These with their radii, the largest first.

    Left out are those of which a power of their map shows that they are below the least, or, of every demand, not
    among so many as are to be kept.
    """
    found: dict[Demand, list[Found]] = {}
    stacks = blocks(judge.poses, judge.loop, ranges, cases, mixed=True)
    for block in _ends_first(stacks) if stacks and stacks[0].cases[0].k_t > 0.0 else stacks:
        like = found.setdefault(block.cases[0].demand, [])
        beside = least if kept is None or len(like) < kept else max(least, like[kept - 1].radius)
        like += [Found(radius, case) for radius, case in judge.largest(block, beside)]
        like.sort(key=_by_radius)
    order = {case: k for k, case in enumerate(cases)}
    return sorted(itertools.chain(*found.values()), key=lambda f: (-f.radius, order[f.case]))


def _ends_first(stacks: Sequence[Block]) -> list[Block]:
    """First and last, second and last but one, and so on: the softest or the stiffest grasps are mostly the worst."""
    both = itertools.chain(*zip(stacks, reversed(stacks), strict=True))
    return list(dict.fromkeys(both))


def _by_radius(found: Found) -> float:
    return -found.radius


def delay_margin(judge: Judge, ranges: Ranges, ranked: Sequence[Case]) -> float | None:
    """Longest delay, in periods, at which everything is stable; None: not even at the shortest stated.

    ranked: cases, the worst first.  Bisection over the worst cases; where it ends, all loops without springs and grasps
    of every stiffness are looked at again, as the worst there may be others, and what is unstable joins them.  It ends
    below the true one by at most a step, but not below the longest stated delay where all is stable there.
    """
    suspects = _suspects(ranked)
    low, high = ranges.delay_periods[0], DELAY_MAX_PERIODS
    stated = ranges.delay_periods[-1]

    def stable(delay: float) -> bool:
        for k, case in enumerate(suspects):
            if _unstable(rank(judge, ranges, [replace(case, delay_periods=delay)], least=STABLE)):
                suspects.insert(0, suspects.pop(k))  # it will mostly be the one that refuses next
                return False
        return True

    if not stable(low):
        return None
    while True:
        high = high if stable(high) else _bisect(stable, low, high)
        if high < stated < high + DELAY_STEP and stable(stated):
            high = stated
        worst = _stiff(judge, ranges, suspects, high) or _soft_like(judge, ranges, suspects, high)
        if worst is None:
            return high
        if high <= low:
            return None
        suspects.insert(0, worst.case)


def _stiff(judge: Judge, ranges: Ranges, suspects: Sequence[Case], delay: float) -> Found | None:
    """The worst of arms alone and of the rigid cell, at the suspects' places and others; None when all are stable."""
    places = _places(judge, {c.place for c in suspects})
    count = len(judge.loop.gains)
    every = alone(count, ranges, places, [delay]) + (rigid(ranges, places, [delay]) if count > 1 else [])
    return _unstable(rank(judge, ranges, every, kept=1, least=STABLE))


def _unstable(ranked: Sequence[Found]) -> Found | None:
    return next((f for f in ranked if f.radius >= STABLE), None)


def _soft_like(judge: Judge, ranges: Ranges, suspects: Sequence[Case], delay: float) -> Found | None:
    """The worst of all grasps with the inertias of the first suspect that has some; None when all are stable."""
    like = next((c for c in suspects if c.demand is Demand.SOFT), None)
    if like is None:
        return None
    every = soft(ranges, like.place, delay, per_decade(judge.poses[0]))
    alike = [c for c in every if (c.inertia, c.load) == (like.inertia, like.load)]
    return _unstable(rank(judge, ranges, alike, kept=1, least=STABLE))


def _suspects(ranked: Sequence[Case]) -> list[Case]:
    """The worst cases, and the worst of each demand; different in more than the delay."""
    kinds = list(dict.fromkeys(replace(c, delay_periods=0.0) for c in ranked))
    first = {d: next((c for c in kinds if c.demand is d), None) for d in Demand}
    return list(dict.fromkeys([*kinds[:MARGIN_SUSPECTS], *(c for c in first.values() if c is not None)]))


def _bisect(holds: Callable[[float], bool], low: float, high: float) -> float:
    """Where it ceases to hold between low, where it does, and high, where it does not."""
    while high - low > DELAY_STEP:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low
