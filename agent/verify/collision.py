"""How near solid bodies of a cell come: each arm to itself, to the others, to object and table, along its motion.

Bodies are the boxes, cylinders and balls of the URDFs (agent.config.solids), the object is the box of its `size_m`,
the table a plane.  Distances are computed at places along the way; between two of them a body can be nearer by half of
what it moves relative to the other, which is taken off: what is reported is a lower bound of the distance of these
bodies on the whole way.

Not looked at are links without a joint or with one joint between them, links that touch where all controlled joints
are zero (they are listed), an arm's gripper against the object that it holds, and its base against the table.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import coal
import numpy as np
import pinocchio as pin

from agent.config.cell import Arm, Cell, placement
from agent.config.solids import Body, Solid, body_of
from agent.control.models import ArmModel, Matrix
from agent.verify.finding import Finding, judged, warning
from drivers.interface import Vector

STANDS_M: Final = 1e-3  # by which an object that stands on the table may be in it
PLACES_MAX: Final = 150
AT_ONCE: Final = 12  # pairs whose distances are computed before it is asked whether any other can be nearer
EVERYWHERE_M: Final = 1e3  # radius of the table
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


class Scene:
    """The bodies of a cell; models one per arm."""

    def __init__(self, cell: Cell, models: Sequence[ArmModel]) -> None:
        self._cell, self._models = cell, models
        self.names = [arm.name for arm in cell.arms]
        self.bodies = [body_of(arm.urdf_xml, arm.file.urdf) for arm in cell.arms]
        each = zip(cell.arms, models, self.bodies, strict=True)
        self._arms = [list(_shapes(arm, model, body)) for arm, model, body in each]
        size = np.array(cell.file.object.size_m)
        box = Shape(OBJECT, OBJECT, 0, coal.Box(*size), 0.5 * float(np.linalg.norm(size)), pin.SE3.Identity())
        self.shapes: list[Shape] = [*itertools.chain(*self._arms), box]
        if cell.file.table is not None:
            plane = coal.Halfspace(np.array([0.0, 0.0, 1.0]), cell.file.table.z_m)
            self.shapes.append(Shape(TABLE, TABLE, 0, plane, EVERYWHERE_M, pin.SE3.Identity()))
        self._owned = {arm.name: self._of(arm.name) for arm in cell.arms}
        self.touching = {arm.name: self._touch(i) for i, arm in enumerate(cell.arms)}

    def way(self, along: Sequence[Sequence[Vector]], objects: Sequence[pin.SE3]) -> Way:
        """All shapes with arm i at along[k][i] and the object at objects[k]."""
        still = [pin.SE3.Identity()] * (len(self.shapes) - sum(map(len, self._arms)) - 1)
        poses = []
        for q, T_world_object in zip(along, objects, strict=True):
            arms = [self._placed(i, q_i) for i, q_i in enumerate(q)]
            poses.append([*itertools.chain(*arms), T_world_object, *still])
        R = np.array([[T.rotation for T in row] for row in poses])
        return Way(self.shapes, R, np.array([[T.translation for T in row] for row in poses]))

    def alone(self, i: int, along: Sequence[Vector], T_world_object: pin.SE3) -> Way:
        """One arm at along[k], the object where it stands; shapes of the other arms are nowhere."""
        mine = self._owned[self.names[i]]
        R, p = np.tile(np.eye(3), (len(along), len(self.shapes), 1, 1)), np.zeros((len(along), len(self.shapes), 3))
        (standing,) = self._of(OBJECT)
        R[:, standing], p[:, standing] = T_world_object.rotation, T_world_object.translation
        for place, q in enumerate(along):
            for k, T in zip(mine, self._placed(i, q), strict=True):
                R[place, k], p[place, k] = T.rotation, T.translation
        return Way(self.shapes, R, p)

    def _of(self, owner: str) -> list[int]:
        return [i for i, shape in enumerate(self.shapes) if shape.owner == owner]

    def _placed(self, i: int, q: Vector) -> list[pin.SE3]:
        model, data = self._models[i].model, self._models[i].data
        pin.forwardKinematics(model, data, q)
        return [data.oMi[shape.body] * shape.at for shape in self._arms[i]]

    def _apart(self, i: int) -> list[Pair]:
        """Pairs of an arm with more than one joint between them."""
        parents = self._models[i].model.parents
        pairs = itertools.combinations(self._owned[self._cell.arms[i].name], 2)
        of = {k: self.shapes[k].body for k in self._owned[self._cell.arms[i].name]}
        return [(a, b) for a, b in pairs if of[a] != of[b] and parents[of[b]] != of[a] and parents[of[a]] != of[b]]

    def _touch(self, i: int) -> frozenset[tuple[str, str]]:
        """Links of an arm that touch where its controlled joints are zero."""
        neutral = [pin.neutral(model.model) for model in self._models]
        way = self.way([neutral], [self._cell.T_world_object_start])
        pairs = self._apart(i)
        near = zip(pairs, way.distances(pairs)[0].tolist(), strict=True)
        return frozenset((self.shapes[a].link, self.shapes[b].link) for (a, b), distance in near if distance <= 0.0)

    def itself(self, i: int) -> list[Pair]:
        """Pairs of an arm's own shapes that must not meet."""
        out = self.touching[self._cell.arms[i].name]
        return [(a, b) for a, b in self._apart(i) if (self.shapes[a].link, self.shapes[b].link) not in out]

    def between(self, i: int, j: int) -> list[Pair]:
        """Pairs of two arms."""
        first, second = (self._owned[self._cell.arms[k].name] for k in (i, j))
        return list(itertools.product(first, second))

    def with_object(self, i: int) -> list[Pair]:
        """Pairs of an arm, but its gripper, and the object."""
        mine = self._owned[self._cell.arms[i].name]
        return [(k, o) for k in mine if not self.shapes[k].holds for o in self._of(OBJECT)]

    def gripper_with_object(self, i: int) -> list[Pair]:
        """Pairs of an arm's gripper and the object, as long as it does not hold it."""
        mine = self._owned[self._cell.arms[i].name]
        return [(k, o) for k in mine if self.shapes[k].holds for o in self._of(OBJECT)]

    def with_table(self, i: int) -> list[Pair]:
        """Pairs of an arm, but what stands still, and the table; none where the cell has no table."""
        mine = self._owned[self._cell.arms[i].name]
        return [(k, t) for k in mine if self.shapes[k].body for t in self._of(TABLE)]

    def standing(self) -> list[Pair]:
        """Object and table."""
        return list(itertools.product(self._of(OBJECT), self._of(TABLE)))


def _shapes(arm: Arm, model: ArmModel, body: Body) -> Iterator[Shape]:
    frames = model.model.frames
    carrier, _ = body.parents.get(arm.file.ee_frame, (arm.file.ee_frame, ""))
    gripper = body.rigidly_below(carrier)
    for solid in body.solids:
        frame = frames[model.model.getFrameId(solid.link, pin.FrameType.BODY)]
        at = frame.placement * pin.SE3(pin.rpy.rpyToMatrix(*solid.rpy_rad), np.array(solid.xyz_m))
        geometry, radius = _geometry(solid)
        yield Shape(arm.name, solid.link, frame.parentJoint, geometry, radius, at, solid.link in gripper)


def _geometry(solid: Solid) -> tuple[coal.ShapeBase, float]:
    if solid.kind == "box":
        return coal.Box(*solid.size_m), 0.5 * math.hypot(*solid.size_m)
    if solid.kind == "cylinder":
        radius, length = solid.size_m
        return coal.Cylinder(radius, length), math.hypot(radius, 0.5 * length)
    return coal.Sphere(solid.size_m[0]), solid.size_m[0]


def collisions(
    cell: Cell,
    models: Sequence[ArmModel],
    paths: Sequence[Sequence[Vector]],
    instants: Sequence[float],
    scene: Scene | None = None,
) -> list[Finding]:
    """Findings on distances along the trajectory; paths[i][k]: joint angles (n,) of arm i at instants[k], s."""
    scene, times, along = scene or Scene(cell, models), *_places(paths, instants)
    motion = cell.trajectory()
    desired = [motion.at(t) for t in times]
    way = scene.way(along, [placement(d.p, d.quat) for d in desired])
    names, margin = [arm.name for arm in cell.arms], cell.file.safety.collision_margin_m
    found: list[Finding] = []

    def add(what: str, where: str, pairs: list[Pair], remedy: str, least: float = margin) -> None:
        near = way.nearest(pairs)
        if near is not None:
            found.append(_judged(scene, near, times, (what, where, remedy), least))

    for i, name in enumerate(names):
        found += _left_out(scene, i, name)
        add("distance of the arm to itself", name, scene.itself(i), "take another elbow branch (q_near_rad) or base")
        add("distance to the object", name, scene.with_object(i), "grasp farther out, or from another side")
        add("distance to the table", name, scene.with_table(i), "lift the motion, or grasp from above")
    for i, j in itertools.combinations(range(len(names)), 2):
        where = f"{names[i]} and {names[j]}"
        add("distance of the arms", where, scene.between(i, j), "move bases or grasps apart")
    add("distance of object and table", "cell", scene.standing(), "lift the motion or its start", -STANDS_M)
    return found


def _judged(scene: Scene, near: Nearest, times: Sequence[float], words: tuple[str, str, str], least: float) -> Finding:
    what, where, remedy = words
    first, second = (scene.shapes[k].label for k in near.pair)
    size = f"overlap by {-near.distance_m * 1e3:.1f} mm" if near.distance_m < 0.0 else f"{near.distance_m * 1e3:.1f} mm"
    return judged(
        what, where, f"{size} ({first}, {second}, t = {times[near.place]:.2f} s)", f"≥ {least * 1e3:g} mm",
        holds=near.distance_m >= least, remedy=remedy,
    )  # fmt: skip


def _left_out(scene: Scene, i: int, name: str) -> Iterator[Finding]:
    touching, unknown = scene.touching[name], scene.bodies[i].unknown
    if touching:
        listed = ", ".join(sorted("–".join(pair) for pair in touching))
        yield Finding("links that touch by design, not compared", name, listed, "")
    if unknown:
        yield warning(
            "links whose shape is not known", name, ", ".join(unknown), "boxes, cylinders or balls in the URDF",
            "give them <collision> elements of these; a file of triangles is not read",
        )  # fmt: skip


def _places(paths: Sequence[Sequence[Vector]], instants: Sequence[float]) -> tuple[list[float], list[list[Vector]]]:
    """Times and joint angles along the way: the given places and one between each two, thinned where they are many."""
    every = max(1, math.ceil(2 * len(instants) / PLACES_MAX))
    kept = sorted({*range(0, len(instants), every), len(instants) - 1})
    times, along = [], []
    for k, after in itertools.zip_longest(kept, kept[1:]):
        here = [path[k] for path in paths]
        times.append(instants[k])
        along.append(here)
        if after is not None:
            times.append(0.5 * (instants[k] + instants[after]))
            along.append([0.5 * (q + path[after]) for q, path in zip(here, paths, strict=True)])
    return times, along
