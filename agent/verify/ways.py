"""How near arms of a session come to anything on their ways between rest and grasp, and while they lower the object.

Each arm goes its way at a time of its own, and nothing says where the others are meanwhile: every place of one arm's
way is held against every place of another's, its rest and its grasp among them.  What is reported is no more than the
least distance, and no less than NEAR_ENOUGH of it.  The object stands in its place; a gripper is held against it as far
as the place before the grasp.  Links of one arm that its rest brings nearer to each other than the margin need not keep
it, but come no nearer.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import coal
import numpy as np
import pinocchio as pin

from agent.config.cell import Cell, placement
from agent.control import ik
from agent.control.life import Life
from agent.control.models import ArmModel
from agent.control.trajectory_rest import RestToRest
from agent.verify.collision.scene import Scene
from agent.verify.collision.way import Pair, Way
from agent.verify.finding import Finding, judged
from drivers.interface import Vector

PLACES: Final = 65  # along a way
NEAR_ENOUGH: Final = 0.7  # of the true distance, that is reported
LOWERED_FROM: Final = 5  # places of the motion
LOWERED_PLACES: Final = 5  # on the way down from each
NEARER_M: Final = 1e-3  # than at its rest, that links of an arm may come which are near each other there
REMEDY: Final = "move bases, grasps or rest_rad apart, or take another elbow branch (q_near_rad)"


@dataclass(frozen=True, slots=True)
class Met:
    """How near two bodies come, and where on each one's way (0 to 1)."""

    distance_m: float  # no less than this; below the margin: exactly, somewhere
    pair: Pair
    at: tuple[float, float]


def ways(
    cell: Cell,
    models: Sequence[ArmModel],
    scene: Scene,
    lives: Sequence[Life],
    paths: Sequence[Sequence[Vector]],
    instants: Sequence[float],
) -> list[Finding]:
    """Findings of a cell with a session, none without.

    lives: one per arm, none without a session; paths[i][k]: joint angles (n,) of arm i at instants[k], s.
    """
    if not lives:
        return []
    margin = cell.file.safety.collision_margin_m
    each = [_of_arm(life, scene, i) for i, life in enumerate(lives)]
    found = [finding for i, (way, before) in enumerate(each) for finding in _alone(scene, i, way, before, margin)]
    for (i, (first, _)), (j, (second, _)) in itertools.combinations(enumerate(each), 2):
        where = f"{cell.arms[i].name} and {cell.arms[j].name}"
        met = nearest(first, second, scene.between(i, j), margin)
        found.append(_judged(scene, "distance of the arms, each anywhere between rest and grasp", where, met, margin))
    low = _lowered(cell, models, scene, paths, instants)
    if low is not None:
        found.append(_judged(scene, "distances while the object is lowered", "cell", low, margin))
    return found


def nearest(first: Way, second: Way, pairs: Sequence[Pair], margin_m: float) -> Met | None:
    """Of all places of one way and all of the other; pairs: of shapes, the first one's in `first`."""
    search = _Search(first, second, margin_m)
    return search.run(pairs)


class _Search:
    """Looks first where two bodies may be nearest, in halves of their ways, until nothing else can be nearer."""

    def __init__(self, first: Way, second: Way, margin_m: float) -> None:
        self._ways, self._margin = (first, second), margin_m
        self._gone = [way.gone.tolist() for way in self._ways]
        self._frames: tuple[dict[Pair, coal.Transform3s], ...] = ({}, {})
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()
        self._open: list[tuple[float, float, Pair, tuple[int, int, int, int]]] = []

    def run(self, pairs: Sequence[Pair]) -> Met | None:
        """None where there are no pairs."""
        ends = len(self._ways[0].p) - 1, len(self._ways[1].p) - 1
        for pair in pairs:
            self._look(pair, (0, ends[0], 0, ends[1]))
        while self._open:
            low, distance, pair, (a, b, c, d) = heapq.heappop(self._open)
            middle = (a + b) // 2, (c + d) // 2
            if distance < self._margin or low >= NEAR_ENOUGH * distance or (b - a <= 1 and d - c <= 1):
                sure = distance if distance < self._margin else low
                return Met(sure, pair, (middle[0] / max(1, ends[0]), middle[1] / max(1, ends[1])))
            halves = (
                ((a, middle[0], c, d), (middle[0], b, c, d))
                if b - a > 1 and (d - c <= 1 or self._slack(0, pair, a, b) >= self._slack(1, pair, c, d))
                else ((a, b, c, middle[1]), (a, b, middle[1], d))
            )
            for half in halves:
                self._look(pair, half)
        return None

    def _look(self, pair: Pair, span: tuple[int, int, int, int]) -> None:
        """The distance in the middle of both spans, and how much less it can be within them."""
        a, b, c, d = span
        distance = self._distance(pair, (a + b) // 2, (c + d) // 2)
        low = distance - self._slack(0, pair, a, b) - self._slack(1, pair, c, d)
        heapq.heappush(self._open, (low if distance >= self._margin else distance - math.inf, distance, pair, span))

    def _slack(self, which: int, pair: Pair, begin: int, end: int) -> float:
        """How far a point of that body is from where it is in the middle of the span, at the most."""
        gone, middle = self._gone[which][pair[which]], (begin + end) // 2
        return float(max(gone[end] - gone[middle], gone[middle] - gone[begin]))

    def _distance(self, pair: Pair, *places: int) -> float:
        frames = [self._frame(which, pair[which], place) for which, place in enumerate(places)]
        shapes = self._ways[0].shapes
        self._result.clear()
        return float(
            coal.distance(
                shapes[pair[0]].geometry, frames[0], shapes[pair[1]].geometry, frames[1], self._request, self._result
            )
        )

    def _frame(self, which: int, shape: int, place: int) -> coal.Transform3s:
        known, way = self._frames[which], self._ways[which]
        found = known.get((shape, place))
        if found is None:
            found = known[shape, place] = coal.Transform3s(way.R[place, shape], way.p[place, shape])
        return found


def _of_arm(life: Life, scene: Scene, i: int) -> tuple[Way, Way]:
    """The way of an arm from its rest to its grasp, and the part of it as far as the place before the grasp."""
    before_s = life.path.legs[0].seconds
    stands = placement(*life.place)
    times = sorted({*np.linspace(0.0, life.path.seconds, PLACES).tolist(), before_s})
    whole = scene.alone(i, [life.path.at(t).q for t in times], stands)
    count = times.index(before_s) + 1
    return whole, Way(scene.shapes, whole.R[:count], whole.p[:count])


def _alone(scene: Scene, i: int, way: Way, before: Way, margin: float) -> Iterator[Finding]:
    """Of one arm to itself, to table and object."""
    itself, what = scene.itself(i), "distance of the arm to itself, object and table between rest and grasp"
    lying = [pair for pair, at_rest in zip(itself, way.first(itself), strict=True) if at_rest < margin]
    if lying:
        yield _opening(scene, i, way, lying)
    found = [
        (near.distance_m, near.pair, near.place / (len(part.p) - 1))
        for part, pairs in (
            (way, [*(p for p in itself if p not in lying), *scene.with_table(i), *scene.with_object(i)]),
            (before, scene.gripper_with_object(i)),
        )
        if (near := part.nearest(pairs)) is not None
    ]
    least = min(found, default=None)
    met = None if least is None else Met(least[0], least[1], (least[2], 0.0))
    yield _judged(scene, what, scene.names[i], met, margin, other=False)


def _opening(scene: Scene, i: int, way: Way, lying: Sequence[Pair]) -> Finding:
    """Links that lie at each other at rest."""
    nearer = (way.distances(lying)[:1] - way.distances(lying)).max(axis=0)
    worst = int(nearer.argmax())
    names = ", ".join("–".join(scene.shapes[k].link for k in pair) for pair in lying)
    return judged(
        "links that lie at each other at rest", scene.names[i],
        f"{names}, nearer by {nearer[worst] * 1e3:.1f} mm on the way",
        f"≤ {NEARER_M * 1e3:g} mm nearer than at rest", holds=float(nearer[worst]) <= NEARER_M, remedy=REMEDY,
    )  # fmt: skip


def _lowered(
    cell: Cell, models: Sequence[ArmModel], scene: Scene, paths: Sequence[Sequence[Vector]], instants: Sequence[float]
) -> Met | None:
    """The least distance of anything while the object goes straight from places of its motion to where it stood."""
    motion, found = cell.trajectory(), list[Met]()
    arms = range(len(models))
    pairs = [pair for i in arms for pair in (*scene.itself(i), *scene.with_object(i), *scene.with_table(i))]
    pairs += [pair for i, j in itertools.combinations(arms, 2) for pair in scene.between(i, j)]
    for k in np.unique(np.linspace(0, len(instants) - 1, LOWERED_FROM).round().astype(int)).tolist():
        T = list(_down(cell, motion.at(instants[k]).p, motion.at(instants[k]).quat))
        try:
            along = [_followed(model, T, path[k]) for model, path in zip(models, paths, strict=True)]
        except ik.Unreachable:  # the motion itself is told of by the other findings
            continue
        near = scene.way(list(zip(*along, strict=True)), T).nearest(pairs)
        if near is not None:
            found.append(Met(near.distance_m, near.pair, (near.place / (len(T) - 1), 0.0)))
    return min(found, key=lambda met: met.distance_m, default=None)


def _down(cell: Cell, p: tuple[float, ...], quat: tuple[float, ...]) -> Iterator[pin.SE3]:
    way = RestToRest(p, quat, cell.file.p_place_m, cell.file.object.quat_start, 1.0, 0.0, and_back=False)  # type: ignore[arg-type]
    for s in np.linspace(0.0, 1.0, LOWERED_PLACES).tolist():
        at = way.at(s)
        yield placement(at.p, at.quat)


def _followed(model: ArmModel, along: Sequence[pin.SE3], q: Vector) -> list[Vector]:
    found = []
    for T in along:
        q = ik.solve(model, T, q)
        found.append(q)
    return found


def _judged(scene: Scene, what: str, where: str, met: Met | None, margin: float, *, other: bool = True) -> Finding:
    if met is None:
        return Finding(what, where, "nothing that could meet", "")
    first, second = (scene.shapes[k].label for k in met.pair)
    size = f"overlap by {-met.distance_m * 1e3:.1f} mm" if met.distance_m < 0.0 else f"{met.distance_m * 1e3:.1f} mm"
    place = f"{met.at[0]:.0%}" + (f" and {met.at[1]:.0%}" if other and where != "cell" else "")
    return judged(
        what, where, f"{size} ({first}, {second}, at {place} of the way)", f"≥ {margin * 1e3:g} mm",
        holds=met.distance_m >= margin, remedy=REMEDY,
    )  # fmt: skip
