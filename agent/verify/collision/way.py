"""Distances of solid shapes along a motion that is given by places: lower bounds on the whole way."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Final

import coal
import numpy as np
import pinocchio as pin

from agent.control.models import Matrix
from drivers.interface import Vector

AT_FIRST: Final = 512  # pairs, each at a place, that are put in order before the others
OBJECT, TABLE = "object", "table"
_DISTANCE = attrgetter("distance_m")


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
        self._travels: dict[Pair, Vector] = {}

    def nearest(self, pairs: Sequence[Pair]) -> Nearest | None:
        """The least distance of these pairs on the way; None where there are none."""
        if not pairs:
            return None
        a, b = np.array(pairs).T
        slack = 0.5 * (self._moved[:, a] + self._moved[:, b])
        bound, found = self._balls(pairs) - slack, Nearest(math.inf, pairs[0], 0)
        for place, k in _in_turn(bound):
            if bound[place, k] >= found.distance_m:
                break
            distance = self._distance(pairs[k], place)
            low = distance - float(slack[place, k])
            if low < found.distance_m:
                low = max(low, distance - float(self._travel(pairs[k])[place]))
                found = min(found, Nearest(low, pairs[k], place), key=_DISTANCE)
        return found

    def least(self, pairs: Sequence[Pair]) -> Nearest | None:
        """The same at these places alone, whatever is between them."""
        if not pairs:
            return None
        bound, found = self._balls(pairs), Nearest(math.inf, pairs[0], 0)
        for place, k in _in_turn(bound):
            if bound[place, k] >= found.distance_m:
                break
            found = min(found, Nearest(self._distance(pairs[k], place), pairs[k], place), key=_DISTANCE)
        return found

    def _balls(self, pairs: Sequence[Pair]) -> Matrix:
        """(K, pairs) distances of the balls about them: no more than those of the shapes."""
        a, b = np.array(pairs).T
        radii = np.array([shape.radius for shape in self.shapes])
        apart: Matrix = np.linalg.norm(self.p[:, a] - self.p[:, b], axis=2) - radii[a] - radii[b]
        for k, (one, other) in enumerate(pairs):
            if self.shapes[other].owner == TABLE:
                apart[:, k] = self.p[:, one, 2] - radii[one] - self.shapes[other].geometry.d
        return apart

    def _distance(self, pair: Pair, place: int) -> float:
        """Of one pair at one place, below zero where they overlap."""
        a, b = pair
        T_a, T_b = (coal.Transform3s(self.R[place, i], self.p[place, i]) for i in pair)
        first, second = self.shapes[a].geometry, self.shapes[b].geometry
        return float(coal.distance(first, T_a, second, T_b, coal.DistanceRequest(), coal.DistanceResult()))

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
        found: list[float] = Way(self.shapes, self.R[:1], self.p[:1]).distances(pairs)[0].tolist()
        return found

    @functools.cached_property
    def _moved(self) -> Matrix:
        """(K, S) how far a point of each shape moves at most, to the next place or from the one before."""
        step = np.pad(self._steps, ((1, 1), (0, 0)))
        moved: Matrix = np.maximum(step[:-1], step[1:])
        return moved

    @functools.cached_property
    def _steps(self) -> Matrix:
        """(K - 1, S) how far a point of each shape moves at most, from each place to the next."""
        radii = np.array([shape.radius for shape in self.shapes])  # the table's, which does not turn, does not count
        angle = 0.5 * math.pi * np.linalg.norm(np.diff(self.R, axis=0), axis=(2, 3))  # no less than the angle
        steps: Matrix = np.linalg.norm(np.diff(self.p, axis=0), axis=2) + angle * radii
        return steps

    @property
    def gone(self) -> Matrix:
        """(S, K) how far a point of each shape has moved at most since the first place."""
        gone: Matrix = np.pad(np.cumsum(self._steps, axis=0), ((1, 0), (0, 0))).T
        return gone

    def _travel(self, pair: Pair) -> Vector:
        """(K,) half of what one moves as seen from the other, from each place to the next one or the one before."""
        if pair not in self._travels:
            a, b = pair
            if self.shapes[b].radius > self.shapes[a].radius:
                a, b = b, a  # the smaller one, seen from the larger one
            p = np.einsum("kji,kj->ki", self.R[:, a], self.p[:, b] - self.p[:, a])
            R = np.einsum("kji,kjl->kil", self.R[:, a], self.R[:, b])
            cosine = 0.5 * (np.einsum("kij,kij->k", R[:-1], R[1:]) - 1.0)
            angle = np.arccos(np.minimum(1.0, np.maximum(-1.0, cosine)))
            way = np.sqrt(np.square(np.diff(p, axis=0)).sum(axis=1)) + angle * self.shapes[b].radius
            step = np.concatenate([[0.0], way, [0.0]])
            self._travels[pair] = 0.5 * np.maximum(step[:-1], step[1:])
        return self._travels[pair]


def _in_turn(bound: Matrix) -> Iterator[tuple[int, int]]:
    """Rows and columns in the order of how near there may be; mostly the first of them are enough."""
    flat, few = bound.ravel(), min(bound.size, AT_FIRST)
    first = np.argpartition(flat, few - 1)
    for part in (np.sort(first[:few]), first[few:]):
        for k in part[np.argsort(flat[part])].tolist():
            yield divmod(k, bound.shape[1])
