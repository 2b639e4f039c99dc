"""The stiffest gains of a cell that its stability criterion accepts, no noisier than the configured ones.

What holds the object in its pose is (k_v K + c) H of each arm; the search makes it large, in translation and rotation
alike, with the radius of every case of agent.verify.criterion below a bound.  Free are k_p, k_ε, the part of both that
stands in v̇_r, k_v of translation and of rotation, and the gains of the observer where there is one.

Looking at every case for every step would take an hour.  The search begins with some; those that its result does not
meet join them, and it goes on until the result meets all.  Cases that refused lately are looked at first, because they
mostly refuse the next step too.  The same cell is searched in the same way.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from agent.verify.chatter import forgetting
from agent.verify.criterion.bodies import Pose
from agent.verify.criterion.cases import Case, Demand, Loop, Ranges, alone, rigid, soft
from agent.verify.criterion.examine import Found, sweep
from agent.verify.criterion.judge import Block, Judge, blocks
from agent.verify.scale import Scale
from agent.verify.search import Miss, climb
from drivers.interface import Vector

STARTS: Final = 3  # further ones where the first finds nothing
TRIES: Final = 500  # per start, and after cases have joined
ROUNDS: Final = 5
SHORT: Final = 150  # tries of the search for what binds
SPREAD: Final = 0.5  # of the further starts, natural logarithm
STRIDE: Final = 7  # every so many soft cases are there from the beginning
JOINING: Final = 4  # cases at most that join at a time
HOT: Final = 4  # cases that are looked at first
NOISE_WEIGHT: Final = 0.1  # of an excess of noise, beside one of the radius
KEEPS: Final = 1e-9  # by which a radius may be above the bound

Noise = Callable[[Loop], float]  # relative to the largest that is wanted


@dataclass(frozen=True)
class Wanted:
    """What gains are to keep."""

    radius: float  # at most, of every case
    noise: Noise  # at most 1
    observer_radius: float = 1.0  # at most, of the observer by itself

    def missed(self, loop: Loop) -> Miss:
        """By which part noise or observer are above it."""
        noisy = Miss(NOISE_WEIGHT * (self.noise(loop) - 1.0), "noise")
        return max(noisy, Miss(forgetting(loop.observer) / self.observer_radius - 1.0, "observer"), key=_excess)


@dataclass(frozen=True, eq=False)
class Stiffest:
    """Where a search ended."""

    scale: Scale
    worst: Found  # of all cases
    kept: bool  # whether all is as wanted
    noise: float  # relative to the largest that is wanted


class Search:
    """One loop at some places, and what is wanted of it."""

    def __init__(self, poses: Sequence[Pose], loop: Loop, ranges: Ranges, wanted: Wanted) -> None:
        self._poses, self._loop, self._ranges, self._wanted = poses, loop, ranges, wanted
        self._blocks = blocks(poses, loop, ranges, self._first())
        self._hot: list[Block] = []
        self._size = Scale.LAW if loop.observer is None else Scale.SIZE

    def run(self) -> Stiffest:
        """The stiffest gains that were found; the nearest to what is wanted where none keeps it."""
        ended: list[Stiffest] = []
        for start in range(STARTS):
            ended.append(self._climb(start))
            if ended[-1].kept:
                break
        return min(ended, key=lambda s: (not s.kept, s.worst.radius))

    def nearest(self) -> float:
        """The smallest radius, not below the wanted one, that a short search finds in the cases that it begins with."""
        random = np.random.default_rng(0)
        found = climb(np.zeros(self._size), lambda _: 0.0, self._missed, range(SHORT), random)
        return self._wanted.radius * (1.0 + max(found.miss.excess, 0.0))

    def _first(self) -> list[Case]:
        ranges, count = self._ranges, len(self._loop.gains)
        longest, low = ranges.delays[0], ranges.inertias[0]
        single = alone(count, ranges, [0], ranges.delays[:2])
        if count > 1:
            single += [*rigid(ranges, [0], [longest]), *soft(ranges, 0, longest, 1)[::STRIDE]]
        return [c for c in single if c.inertia == low]

    def _climb(self, start: int) -> Stiffest:
        random = np.random.default_rng(start)
        x = random.normal(0.0, SPREAD if start else 0.0, self._size)
        found = climb(x, self._value, self._missed, range(TRIES), random)
        worst = self._swept(found.x)
        for _ in range(ROUNDS):
            missed = [w.case for w in worst if w.radius > self._wanted.radius + KEEPS]
            if found.miss.excess > 0.0 or not missed:
                break
            self._blocks += blocks(self._poses, self._loop, self._ranges, missed[:JOINING])
            found = climb(found.x, self._value, self._missed, range(TRIES), random)
            worst = self._swept(found.x)
        loop = self._scaled(found.x)
        kept = worst[0].radius <= self._wanted.radius + KEEPS and self._wanted.missed(loop).excess <= KEEPS
        return Stiffest(Scale.at(found.x), worst[0], kept, self._wanted.noise(loop))

    def _swept(self, x: Vector) -> list[Found]:
        judge = Judge(self._poses, self._scaled(x))
        return [f for f in sweep(judge, self._ranges) if f.case.demand is not Demand.ALIGNING]

    def _scaled(self, x: Vector) -> Loop:
        return scaled(self._loop, Scale.at(x))

    def _value(self, x: Vector) -> float:
        """Logarithm of the stiffnesses, of translation and rotation alike, mean over the arms."""
        gains = map(Scale.at(x).of, self._loop.gains)
        each = [(g, grip.share) for g, grip in zip(gains, self._poses[0].grips, strict=True)]
        logs = [math.log(g.k_v[k] * (*g.k_p, *g.k_eps)[k] + share) for g, share in each for k in range(6)]
        return sum(logs) / (3.0 * len(each))

    def _missed(self, x: Vector, enough: float) -> Miss:
        """By which part a radius, the noise or the observer's slowness is above what is wanted."""
        loop = self._scaled(x)
        judge, most = Judge(self._poses, loop), self._wanted.missed(loop)
        if most.excess > enough:
            return most
        for k, block in enumerate([*self._hot, *self._blocks]):
            radii = judge.radii(block)
            worst = int(radii.argmax())
            most = max(most, Miss(float(radii[worst]) / self._wanted.radius - 1.0, block.cases[worst]), key=_excess)
            if most.excess > enough:
                hot = self._hot.pop(k) if k < len(self._hot) else block.only(worst)
                self._hot = [hot, *self._hot[: HOT - 1]]
                return most
        return most


def scaled(loop: Loop, scale: Scale) -> Loop:
    """The loop with scaled gains."""
    return replace(loop, gains=tuple(map(scale.of, loop.gains)), observer=scale.of_observer(loop.observer))


def _excess(miss: Miss) -> float:
    return miss.excess
