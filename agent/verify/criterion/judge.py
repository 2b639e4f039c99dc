"""The spectral radii of cases, computed in stacks.

Cases whose maps are of one size are computed together, and their motion, which knows no gains, is computed once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from agent.control.models import Matrix
from agent.verify.criterion import bodies
from agent.verify.criterion.bodies import Bodies, Motion, Pose, Springs, Truth
from agent.verify.criterion.cases import Aligning, Case, Demand, Loop, Ranges
from agent.verify.criterion.loop import Laws, Shifting, laws, one_period, radii
from agent.verify.criterion.power import below
from drivers.interface import Vector

SPATIAL_ROWS = 6
STACK_PLANAR = 16  # cases at a time: more of them do not fit into the cache
STACK_SPATIAL = 8  # what is found of some spares others their eigenvalues, which take 10 ms each
STACK_OF_ONE = 64  # of an arm alone or a rigid cell, whose maps are a seventh of the others


@dataclass(frozen=True, eq=False)
class Block:
    """Cases of one size and delay, and their motion between two samples."""

    cases: tuple[Case, ...]
    motion: Motion

    def only(self, k: int) -> Block:
        """Case k alone."""
        return Block((self.cases[k],), self.motion.only(k))


def blocks(
    poses: Sequence[Pose], loop: Loop, ranges: Ranges, cases: Sequence[Case], *, mixed: bool = False
) -> list[Block]:
    """The cases in stacks; poses: one per place.  Of the loop its period and anchor count, not its gains.

    mixed: with several arms and places in a stack, which takes less time; else they differ in inertia and stiffness.
    """
    stack_soft = STACK_PLANAR if len(poses[0].P) < SPATIAL_ROWS else STACK_SPATIAL
    groups: dict[tuple[object, ...], list[Case]] = {}
    for case in dict.fromkeys(cases):
        where = () if mixed else (case.place, case.arm)
        groups.setdefault((case.demand, case.delay_periods, case.k_t > 0.0, *where), []).append(case)
    return [
        Block(tuple(stack), _bodies(poses, ranges, stack).motion(loop.period_s, stack[0].delay_periods))
        for group in groups.values()
        for stack in _stacks(group, STACK_OF_ONE if mixed and group[0].k_t == 0.0 else stack_soft)
    ]


def _stacks(group: list[Case], size: int) -> list[list[Case]]:
    return [group[k : k + size] for k in range(0, len(group), size)]


def _bodies(poses: Sequence[Pose], ranges: Ranges, stack: Sequence[Case]) -> Bodies:
    case, at = stack[0], _where(poses, stack)
    truth = Truth(np.array([c.inertia for c in stack]), np.array([c.load for c in stack]), ranges.friction)
    if case.arm is not None:
        return (bodies.bare if case.demand is Demand.BARE else bodies.holding)(at, 0, truth)
    if case.k_t > 0.0:
        k_t, k_r = np.array([[c.k_t, c.k_r] for c in stack]).T
        return bodies.soft(at, truth, Springs(k_t, k_r, ranges.pads_damping_ratio))
    one = bodies.rigid(at, truth)
    return one.seen_by(2) if case.demand is Demand.ALIGNING else one


def _where(poses: Sequence[Pose], stack: Sequence[Case]) -> Pose:
    """The pose of a stack of cases, with their arm alone where they have one."""
    kinds = {(c.place, c.arm): k for k, c in enumerate(stack)}
    each = {kind: _moving(poses[stack[k].place], stack[k].arm) for kind, k in kinds.items()}
    return bodies.together([each[c.place, c.arm] for c in stack]) if len(each) > 1 else next(iter(each.values()))


def _moving(at: Pose, arm: int | None) -> Pose:
    return at if arm is None else replace(at, grips=at.grips[arm : arm + 1])


@dataclass(frozen=True)
class Judge:
    """Poses and a loop, whose laws are made once per pose."""

    poses: Sequence[Pose]
    loop: Loop
    _laws: dict[int, Laws] = field(default_factory=dict, repr=False)

    def radii(self, block: Block) -> Vector:
        """Spectral radius of every case of the block."""
        return radii(self.maps(block))

    def largest(self, block: Block, least: float) -> list[tuple[float, Case]]:
        """Spectral radii with their cases, without most of those below the least."""
        A = self.maps(block)
        left = np.flatnonzero(~below(A, least))
        return [(r, block.cases[k]) for r, k in zip(radii(A[left]).tolist(), left.tolist(), strict=True)]

    def maps(self, block: Block) -> Matrix:
        """The map (K, s, s) from one sample to the next of every case of the block."""
        case, motion = block.cases[0], block.motion
        law, shifting = self._together(block.cases), None
        if case.demand is Demand.ALIGNING:
            aligning, m = self._aligning, len(law.R)
            if case.k_t == 0.0:
                followers = slice(m, None)
            else:
                rows = [m * i + k for i in self._anchor_last() for k in range(m)]
                motion, followers = motion.reordered(rows), slice(0, len(rows) - m)
            shifting = Shifting(followers, aligning.per_s * self.loop.period_s)
        return one_period(motion, law, self.loop.observer, shifting)

    def _together(self, cases: Sequence[Case]) -> Laws:
        """Laws of a stack of cases; of one place and arm without a stack."""
        kinds = {(c.place, c.arm): c for c in cases}
        each = {kind: self._law(case) for kind, case in kinds.items()}
        if len(each) == 1:
            return next(iter(each.values()))
        all_laws = [each[c.place, c.arm] for c in cases]
        return Laws(np.array([law.S for law in all_laws]), np.array([law.D for law in all_laws]), all_laws[0].R)

    def _law(self, case: Case) -> Laws:
        law = self._at(case.place)
        if case.demand is Demand.ALIGNING:
            return law.of(self._anchor_last()) if case.k_t > 0.0 else law.anchor_and_followers(self._aligning.anchor)
        if case.arm is not None:
            return law.of([case.arm])
        return law.together() if case.demand is Demand.RIGID else law

    @property
    def _aligning(self) -> Aligning:
        if self.loop.aligning is None:
            raise TypeError("a cell that does not align itself has no such case")
        return self.loop.aligning

    def _anchor_last(self) -> list[int]:
        """The arms in such an order that the followers' rows are in one piece."""
        anchor = self._aligning.anchor
        return [i for i in range(len(self.loop.gains)) if i != anchor] + [anchor]

    def _at(self, place: int) -> Laws:
        if place not in self._laws:
            self._laws[place] = laws(self.poses[place], self.loop.gains)
        return self._laws[place]
