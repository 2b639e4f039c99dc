"""Distances of solid shapes along a motion that is given by places: lower bounds on the whole way."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import coal
import numpy as np
import pinocchio as pin

from agent.control.models import Matrix
from drivers.interface import Vector

AT_ONCE: Final = 12  # pairs whose distances are computed before it is asked whether any other can be nearer
OBJECT, TABLE = "object", "table"


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """One solid of the scene."""

    owner: str  # arm, "object" or "table"
    link: str
    body: int  # the joint of the arm that moves it; 0 stands still
    geometry: coal.ShapeBase
    radius: float  # of the ball about its centre that holds it
    at: pin.SE3  # in the frame of its joint; of object and table the identity
    holds: bool = False  # part of a gripper

    @property
    def label(self) -> str:
        """For a person."""
        return self.owner if self.owner == self.link else f"{self.owner} {self.link}"


Pair = tuple[int, int]  # places of two shapes


@dataclass(frozen=True, slots=True)
class Nearest:
    """The least distance of some pairs, and where."""

    distance_m: float  # no less than this; below zero: they overlap
    pair: Pair
    place: int


class Way:
    """Shapes at the places of a motion: R (K, S, 3, 3) and p (K, S, 3) of their centres, world axes."""

    def __init__(self, shapes: Sequence[Shape], R: Matrix, p: Matrix) -> None:
        self.shapes, self.R, self.p = shapes, R, p

    def nearest(self, pairs: Sequence[Pair]) -> Nearest | None:
        """The least distance of these pairs on the way; None where there are none."""
        if not pairs:
            return None
        a, b = np.array(pairs).T
        slack, found = 0.5 * (self._moved[:, a] + self._moved[:, b]), Nearest(math.inf, pairs[0], 0)
        bound = (self._balls(pairs) - slack).min(axis=0)
        for chosen in _in_turn(bound):
            if bound[chosen[0]] >= found.distance_m:
                break
            found = self._nearer(found, [pairs[k] for k in chosen], slack[:, chosen])
        return found

    def least(self, pairs: Sequence[Pair]) -> Nearest | None:
        """The same at these places alone, whatever is between them."""
        if not pairs:
            return None
        bound, found = self._balls(pairs).min(axis=0), Nearest(math.inf, pairs[0], 0)
        for chosen in _in_turn(bound):
            if bound[chosen[0]] >= found.distance_m:
                break
            distances = self.distances([pairs[k] for k in chosen])
            place, k = divmod(int(distances.argmin()), len(chosen))
            if distances[place, k] < found.distance_m:
                found = Nearest(float(distances[place, k]), pairs[chosen[k]], place)
        return found

    def _nearer(self, found: Nearest, pairs: Sequence[Pair], slack: Matrix) -> Nearest:
        """What was found, or what is nearer among these pairs; slack (K, pairs): by which each may be nearer."""
        distances = self.distances(pairs)
        low = distances - slack
        for flat in np.argsort(low, axis=None).tolist():
            place, k = divmod(flat, len(pairs))
            if low[place, k] >= found.distance_m:
                break
            distance = max(float(low[place, k]), float(distances[place, k]) - self._travel(pairs[k], place))
            if distance < found.distance_m:
                found = Nearest(distance, pairs[k], place)
        return found

    def _balls(self, pairs: Sequence[Pair]) -> Matrix:
        """(K, pairs) distances of the balls about them: no more than those of the shapes."""
        a, b = np.array(pairs).T
        radii = np.array([shape.radius for shape in self.shapes])
        apart: Matrix = np.linalg.norm(self.p[:, a] - self.p[:, b], axis=2) - radii[a] - radii[b]
        return apart

    def distances(self, pairs: Sequence[Pair]) -> Matrix:
        """(K, pairs) at each place, below zero where they overlap."""
        geometry = pin.GeometryModel()
        for i, shape in enumerate(self.shapes):
            geometry.addGeometryObject(pin.GeometryObject(str(i), 0, pin.SE3.Identity(), shape.geometry))
        for a, b in pairs:
            geometry.addCollisionPair(pin.CollisionPair(a, b))
        data = pin.GeometryData(geometry)
        used = sorted({i for pair in pairs for i in pair})
        found = np.empty((len(self.p), len(pairs)))
        for k, row in enumerate(found):
            for i in used:
                data.oMg[i] = pin.SE3(self.R[k, i], self.p[k, i])
            pin.computeDistances(geometry, data)
            row[:] = [result.min_distance for result in data.distanceResults]
        return found

    def first(self, pairs: Sequence[Pair]) -> list[float]:
        """The distances of these pairs at the first place."""
        return [] if not pairs else Way(self.shapes, self.R[:1], self.p[:1]).distances(pairs)[0].tolist()

    @functools.cached_property
    def _moved(self) -> Matrix:
        """(K, S) how far a point of each shape moves at most, to the next place or from the one before."""
        step = np.pad(self._steps, ((1, 1), (0, 0)))
        moved: Matrix = np.maximum(step[:-1], step[1:])
        return moved

    @functools.cached_property
    def _steps(self) -> Matrix:
        """(K - 1, S) how far a point of each shape moves at most, from each place to the next."""
        radii = np.array([0.0 if shape.owner == TABLE else shape.radius for shape in self.shapes])
        angle = 0.5 * math.pi * np.linalg.norm(np.diff(self.R, axis=0), axis=(2, 3))  # no less than the angle
        steps: Matrix = np.linalg.norm(np.diff(self.p, axis=0), axis=2) + angle * radii
        return steps

    @property
    def gone(self) -> Matrix:
        """(S, K) how far a point of each shape has moved at most since the first place."""
        gone: Matrix = np.pad(np.cumsum(self._steps, axis=0), ((1, 0), (0, 0))).T
        return gone

    def _travel(self, pair: Pair, place: int) -> float:
        """Half of what one moves as seen from the other, from this place to the next one or the one before."""
        a, b = pair
        if self.shapes[b].radius > self.shapes[a].radius:
            a, b = b, a  # the smaller one, seen from the larger one
        seen = [
            (self.R[j, a].T @ (self.p[j, b] - self.p[j, a]), self.R[j, a].T @ self.R[j, b])
            for j in (place, place - 1, place + 1)
            if 0 <= j < len(self.p)
        ]
        p, R = seen[0]
        ways = [math.dist(p, q) + _angle(R.T @ S) * self.shapes[b].radius for q, S in seen[1:]]
        return 0.5 * max(ways, default=0.0)


def _in_turn(bound: Vector) -> Iterator[list[int]]:
    """Places of pairs in the order of how near they may be, some at a time."""
    order = np.argsort(bound).tolist()
    yield from (order[k : k + AT_ONCE] for k in range(0, len(order), AT_ONCE))


def _angle(R: Matrix) -> float:
    return math.acos(min(1.0, max(-1.0, 0.5 * (float(np.trace(R)) - 1.0))))
