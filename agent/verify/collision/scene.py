"""The bodies of a cell as shapes, where they are at given joint angles, and which pairs of them must not meet."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Final

import coal
import numpy as np
import pinocchio as pin

from agent.config.cell import Arm, Cell
from agent.config.solids import Body, Solid, body_of
from agent.control.models import ArmModel
from agent.verify.collision.way import OBJECT, TABLE, Pair, Shape, Way
from drivers.interface import Vector

EVERYWHERE_M: Final = 1e3  # radius of the table


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
