"""An arm as its URDF draws it: the solids of each link, and where the links are for given joint angles."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pinocchio as pin

from agent.config.urdf import text_of_urdf
from agent.view.error import ViewError
from agent.view.pose import Array
from agent.view.shapes import Colour, Mesh, ball, box, by_colour, cylinder

_DARK: Final = 0.3  # a material darker than this is a shell, which takes the arm's colour


@dataclass(frozen=True, slots=True)
class ArmDrawing:
    """What is known of an arm before it moves."""

    name: str
    urdf_xml: str
    urdf: str  # its name, for errors
    controlled: tuple[str, ...]
    locked_rad: Mapping[str, float]
    p_world_base: Sequence[float]
    quat_world_base: Sequence[float]
    ee_frame: str
    colour: Colour


class ArmBody:
    """The links of one arm.  Raises ViewError for a URDF that names a joint or frame that it does not have."""

    def __init__(self, drawing: ArmDrawing) -> None:
        self.name = drawing.name
        self._model = _model(drawing)
        self._data = self._model.createData()
        self._base = pin.SE3(pin.Quaternion(*drawing.quat_world_base), np.array(drawing.p_world_base, float))
        self._ee = self._model.getFrameId(drawing.ee_frame)
        self._controlled = [self._velocity_index(drawing, name) for name in drawing.controlled]
        self._rest = np.zeros(self._model.nv)
        for name, angle in drawing.locked_rad.items():
            if self._model.existJointName(name):
                self._rest[self._velocity_index(drawing, name)] = angle
        if self._ee >= self._model.nframes:
            raise _absent(drawing, f"frame {drawing.ee_frame}")
        self.links = _solids(self._model, drawing)  # by the name of the joint that moves them; "base" stands still

    def _velocity_index(self, drawing: ArmDrawing, name: str) -> int:
        if not self._model.existJointName(name):
            raise _absent(drawing, f"joint {name}")
        index: int = self._model.joints[self._model.getJointId(name)].idx_v
        return index

    def placements(self, q: Array) -> tuple[dict[str, Array], Array]:
        """Poses (k, 7) of every link in the world, and of the end effector, for controlled joint angles (k, n)."""
        names = list(self.links)
        ids = [0 if name == "base" else self._model.getJointId(name) for name in names]
        out, ee = np.empty((len(ids), len(q), 7)), np.empty((len(q), 7))
        neutral, turned = pin.neutral(self._model), self._rest.copy()
        for row, angles in enumerate(q):
            turned[self._controlled] = angles
            pin.forwardKinematics(self._model, self._data, pin.integrate(self._model, neutral, turned))
            for place, joint in enumerate(ids):
                out[place, row] = _seven(self._base * self._data.oMi[joint])
            ee[row] = _seven(self._base * pin.updateFramePlacement(self._model, self._data, self._ee))
        return dict(zip(names, out, strict=True)), ee


def _model(drawing: ArmDrawing) -> pin.Model:
    try:
        return pin.buildModelFromXML(text_of_urdf(drawing.urdf_xml.encode(), drawing.urdf))
    except (ValueError, RuntimeError) as error:
        raise ViewError(
            f"{drawing.urdf} of arm {drawing.name}", found=str(error).splitlines()[0], expected="a URDF",
            remedy="take a log that `coop record` made",
        ) from error  # fmt: skip


def _absent(drawing: ArmDrawing, what: str) -> ViewError:
    return ViewError(
        f"{drawing.urdf} of arm {drawing.name}", found=f"no {what}", expected="every name that the cell file uses",
        remedy="take the cell file and the URDF of one release",
    )  # fmt: skip


def _seven(T: pin.SE3) -> Array:
    x, y, z, qx, qy, qz, qw = pin.SE3ToXYZQUAT(T)
    return np.array([x, y, z, qw, qx, qy, qz])


def _solids(model: pin.Model, drawing: ArmDrawing) -> dict[str, tuple[Mesh, ...]]:
    robot = ET.fromstring(drawing.urdf_xml)
    materials = {m.get("name"): m for m in robot.findall("material")}
    found: dict[str, list[Mesh]] = {}
    for link in robot.findall("link"):
        frame = model.frames[model.getFrameId(str(link.get("name")), pin.FrameType.BODY)]
        joint = "base" if frame.parentJoint == 0 else model.names[frame.parentJoint]
        for visual in link.findall("visual"):
            mesh = _mesh(visual, _colour(visual, materials, drawing.colour))
            if mesh is not None:
                at = frame.placement * _origin(visual.find("origin"))
                found.setdefault(joint, []).append(mesh.placed(at.rotation, at.translation))
    return {joint: by_colour(meshes) for joint, meshes in found.items()}


def _mesh(visual: ET.Element, colour: Colour) -> Mesh | None:
    """The solid of a <visual>; None for one that is a file, which a log does not hold."""
    geometry = visual.find("geometry")
    solid = None if geometry is None else next(iter(geometry), None)
    if solid is None:
        return None
    if solid.tag == "box":
        return box(_numbers(solid.get("size", "0 0 0")), colour)
    if solid.tag == "cylinder":
        return cylinder(float(solid.get("radius", "0")), float(solid.get("length", "0")), colour)
    return ball(float(solid.get("radius", "0")), colour) if solid.tag == "sphere" else None


def _origin(origin: ET.Element | None) -> pin.SE3:
    if origin is None:
        return pin.SE3.Identity()
    roll, pitch, yaw = _numbers(origin.get("rpy", "0 0 0"))
    return pin.SE3(pin.rpy.rpyToMatrix(roll, pitch, yaw), _numbers(origin.get("xyz", "0 0 0")))


def _colour(visual: ET.Element, materials: Mapping[str | None, ET.Element], arm: Colour) -> Colour:
    """Dark shells in the arm's own colour, so that arms are told apart; servos and the rest as the URDF has them."""
    named = visual.find("material")
    material = materials.get(named.get("name"), named) if named is not None else None
    colour = None if material is None else material.find("color")
    if colour is None:
        return arm
    red, green, blue = _numbers(colour.get("rgba", "0 0 0 1"))[:3]
    if math.fsum((red, green, blue)) / 3.0 < _DARK:
        return arm
    return round(255 * red), round(255 * green), round(255 * blue)


def _numbers(text: str) -> Array:
    return np.array([float(word) for word in text.split()])
