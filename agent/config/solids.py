"""The boxes, cylinders and balls of a URDF, link by link; shapes that are files of triangles are named, not read."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import Final

from agent.config.reading import ConfigError

_SIZES: Final = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}


@dataclass(frozen=True, slots=True)
class Solid:
    """One solid in the frame of its link."""

    link: str
    kind: str  # box, cylinder (along z) or sphere
    size_m: tuple[float, ...]  # sides; radius and length; radius
    xyz_m: tuple[float, ...]
    rpy_rad: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Body:
    """What is known of the shape of an arm."""

    solids: tuple[Solid, ...]
    unknown: tuple[str, ...]  # links that have a shape, but one in a file
    parents: dict[str, tuple[str, str]]  # of each link: the link that carries it, and the type of the joint between

    def rigidly_below(self, link: str) -> set[str]:
        """This link and all that fixed joints hang on it."""
        found = {link}
        while more := {c for c, (p, kind) in self.parents.items() if p in found and kind == "fixed"} - found:
            found |= more
        return found


def body_of(urdf_xml: str, name: str) -> Body:
    """Of each link what its <collision> elements say, or where it has none, what its <visual> elements show.

    Raises ConfigError, naming the file, for a number that cannot be read.
    """
    robot = ET.fromstring(urdf_xml)
    solids, unknown, parents = [], [], {}
    for link in robot.findall("link"):
        shapes = link.findall("collision") or link.findall("visual")
        found = [solid for shape in shapes if (solid := _solid(str(link.get("name")), shape, name)) is not None]
        solids += found
        if shapes and not found:
            unknown.append(str(link.get("name")))
    for joint in robot.findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        if parent is not None and child is not None:
            parents[str(child.get("link"))] = (str(parent.get("link")), str(joint.get("type")))
    return Body(tuple(solids), tuple(unknown), parents)


def _solid(link: str, shape: ET.Element, name: str) -> Solid | None:
    geometry = shape.find("geometry")
    kind = None if geometry is None else next(iter(geometry), None)
    if kind is None or kind.tag not in _SIZES:
        return None
    origin = shape.find("origin")
    written = [kind.get(key, "") for key in _SIZES[kind.tag]]
    placed = ["0 0 0"] * 2 if origin is None else [origin.get("xyz", "0 0 0"), origin.get("rpy", "0 0 0")]
    try:
        size = tuple(float(word) for text in written for word in text.split())
        xyz, rpy = (tuple(float(word) for word in text.split()) for text in placed)
    except ValueError:
        size, xyz, rpy = (), (), ()
    if len(size) != (3 if kind.tag == "box" else len(written)) or not all(0.0 < s < 100.0 for s in size) or (
        len(xyz), len(rpy)
    ) != (3, 3):  # fmt: skip
        raise ConfigError(
            f"{kind.tag} of link {link} in {name}", found=" ".join([*written, *placed]),
            expected="its sides, or radius and length, in m, and an origin of three numbers each",
            remedy="correct it: a shape that cannot be read would be left out",
        )  # fmt: skip
    return Solid(link, kind.tag, size, xyz, rpy)
