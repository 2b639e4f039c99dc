"""The cell as ROS sees it: which frames there are, which of them never move, and how a joint moves the others.

`map` (z up) → `world` (the cell's axes) → `ARM/base_link` → … → `ARM/ee`, all by URDFs and placements alone.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.control.quaternion import Quat, multiply

MAP: Final = "map"
WORLD: Final = "world"
_TURNING: Final = frozenset({"revolute", "continuous"})
_MOVABLE: Final = _TURNING | {"prismatic"}

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Pose:
    """Place of a frame in its parent."""

    p: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quat: Quat = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Joint:
    """A joint of a URDF."""

    name: str
    kind: str
    parent: str
    child: str
    origin: Pose
    axis: tuple[float, float, float]

    @property
    def turns(self) -> bool:
        """Whether its value is an angle; otherwise it is a distance."""
        return self.kind in _TURNING

    @property
    def movable(self) -> bool:
        """Whether it has a value."""
        return self.kind in _MOVABLE

    def pose(self, value: float) -> Pose:
        """Place of the child in the parent at this value (rad or m); a fixed joint has none."""
        if not self.movable:
            return self.origin
        if self.turns:
            half = 0.5 * value
            x, y, z = np.sin(half) * np.array(self.axis)
            return Pose(self.origin.p, multiply(self.origin.quat, (float(np.cos(half)), float(x), float(y), float(z))))
        moved = np.array(self.origin.p) + value * (rotation(self.origin.quat) @ np.array(self.axis))
        return Pose((float(moved[0]), float(moved[1]), float(moved[2])), self.origin.quat)


@dataclass(frozen=True)
class SceneArm:
    """One arm: its URDF, where it stands, how it holds the object."""

    name: str
    joints: tuple[str, ...]  # controlled, in the order of the rows
    locked: Mapping[str, float]  # the other movable joints, rad or m
    urdf_xml: str
    ee_link: str
    T_world_base: Pose = field(default_factory=Pose)
    quat_object_ee: Quat = (1.0, 0.0, 0.0, 0.0)

    @cached_property
    def tree(self) -> tuple[Joint, ...]:
        """All joints of the URDF in its order."""
        return tuple(_joint(element) for element in ET.fromstring(self.urdf_xml).findall("joint"))

    @cached_property
    def root(self) -> str:
        """The link that is no joint's child."""
        children = {joint.child for joint in self.tree}
        links = [str(link.get("name")) for link in ET.fromstring(self.urdf_xml).findall("link")]
        return next((link for link in links if link not in children), "base_link")

    @property
    def movable(self) -> tuple[str, ...]:
        """Names of the joints that have a value, in the URDF's order; of those it lacks, as the cell has them."""
        known = [joint.name for joint in self.tree if joint.movable]
        return (*known, *(name for name in self.joints if name not in known))

    @property
    def moving(self) -> tuple[tuple[int, Joint], ...]:
        """The controlled joints with their column in the rows."""
        return tuple((self.joints.index(j.name), j) for j in self.tree if j.movable and j.name in self.joints)

    def frame(self, link: str) -> str:
        """Name of a link's frame."""
        return f"{self.name}/{link}"


@dataclass(frozen=True)
class Transform:
    """A frame that never moves in its parent."""

    parent: str
    child: str
    pose: Pose


@dataclass(frozen=True)
class Scene:
    """A cell: its name, its arms in order, and where down is."""

    cell: str
    arms: tuple[SceneArm, ...]
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)

    @property
    def joints(self) -> dict[str, tuple[str, ...]]:
        """Controlled joints by arm."""
        return {arm.name: arm.joints for arm in self.arms}

    def statics(self) -> list[Transform]:
        """Every frame that never moves: the world, the bases, the fixed and the locked joints."""
        found = [Transform(MAP, WORLD, Pose(quat=upright(self.gravity)))]
        for arm in self.arms:
            found.append(Transform(WORLD, arm.frame(arm.root), arm.T_world_base))
            for joint in arm.tree:
                if joint.name not in arm.joints:
                    pose = joint.pose(arm.locked.get(joint.name, 0.0))
                    found.append(Transform(arm.frame(joint.parent), arm.frame(joint.child), pose))
        return found


def upright(gravity: tuple[float, float, float]) -> Quat:
    """Attitude of `world` in `map`, whose z points against gravity: the smallest turn, none without gravity."""
    g = np.array(gravity)
    size = float(np.linalg.norm(g))
    if size == 0.0:
        return (1.0, 0.0, 0.0, 0.0)
    up = -g / size
    if up[2] < -1.0 + 1e-9:
        return (0.0, 1.0, 0.0, 0.0)  # upside down: half a turn about x
    quat = np.array([1.0 + up[2], up[1], -up[0], 0.0])  # 1 + up·z, up × z
    w, x, y, z = (quat / np.linalg.norm(quat)).tolist()
    return (w, x, y, z)


def rotation(quat: Quat) -> Array:
    """(3, 3) rotation matrix of a unit quaternion."""
    w, x, y, z = quat
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _joint(element: ET.Element) -> Joint:
    parent, child, axis = element.find("parent"), element.find("child"), element.find("axis")
    direction = np.array(_triple(axis, "xyz", (1.0, 0.0, 0.0)))
    size = float(np.linalg.norm(direction))
    x, y, z = (direction / size if size else direction).tolist()
    origin = element.find("origin")
    return Joint(
        name=str(element.get("name")),
        kind=str(element.get("type")),
        parent="" if parent is None else str(parent.get("link")),
        child="" if child is None else str(child.get("link")),
        origin=Pose(_triple(origin, "xyz"), _of_rpy(*_triple(origin, "rpy"))),
        axis=(x, y, z),
    )


def _triple(
    element: ET.Element | None, attribute: str, otherwise: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> tuple[float, float, float]:
    text = None if element is None else element.get(attribute)
    if text is None:
        return otherwise
    x, y, z = map(float, text.split())
    return (x, y, z)


def _of_rpy(roll: float, pitch: float, yaw: float) -> Quat:
    """Quaternion of turns about the fixed axes x, y, z, in that order."""
    cx, cy, cz = np.cos(0.5 * np.array([roll, pitch, yaw])).tolist()
    sx, sy, sz = np.sin(0.5 * np.array([roll, pitch, yaw])).tolist()
    return multiply((cz, 0.0, 0.0, sz), multiply((cy, 0.0, sy, 0.0), (cx, sx, 0.0, 0.0)))
