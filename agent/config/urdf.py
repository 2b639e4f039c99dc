"""What a URDF must say, in numbers that can be read: its parser leaves a link without mass where it cannot read one.

Weights that are missing would be missing in the torque that carries the arm, so each link's are looked at here.
"""

from __future__ import annotations

import posixpath
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from functools import lru_cache
from typing import Final

import numpy as np

from agent.config.reading import ConfigError, shown
from agent.config.urdf_joints import NUMBER, refuse_macros, refuse_odd_joints
from agent.config.urdf_tree import refuse_no_tree

LARGEST: Final = 100.0  # kg, kg·m², m and rad, as in a cell file
ROUNDED: Final = 0.01  # by which moments of few digits may be off those of a body
_TRIPLES = (("origin", "xyz"), ("origin", "rpy"), ("axis", "xyz"))
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def urdf_beside(arm_file: str, urdf: str) -> str:
    """Name under which the URDF of an arm file of one's own is embedded in its cell."""
    return posixpath.join(posixpath.dirname(arm_file), urdf)


@lru_cache(maxsize=8)  # arms of one kind
def text_of_urdf(raw: bytes, name: str) -> str:
    """The text of a URDF whose numbers can all be read, whose links are bodies, and whose joints move and make a tree.

    Raises ConfigError naming file and element.
    """
    try:
        text = raw.decode()
        robot = ET.fromstring(text)
    except (ET.ParseError, ValueError) as error:
        raise ConfigError(
            name, found=shown(str(error)), expected="XML in UTF-8", remedy="correct that place"
        ) from error
    for where, attribute, written, a_weight in _numbers(robot):
        words = written.split() if written is not None else []
        count, least = 3 if attribute in {"xyz", "rpy"} else 1, 0.0 if a_weight else -LARGEST
        if len(words) != count or not all(NUMBER.fullmatch(word) and least <= float(word) <= LARGEST for word in words):
            raise ConfigError(
                f"{attribute} of {shown(where)} in {name}",
                found="nothing" if written is None else shown(repr(written)),
                expected=(f"{count} numbers" if count > 1 else "a number")
                + (f", not below 0 and at most {LARGEST:g}" if a_weight else f" within ±{LARGEST:g}"),
                remedy="correct it and its unit: what cannot be read would be left out",
            )
    for link in robot.iter("link"):
        _refuse_impossible(link, name)
    refuse_macros(robot, name)
    refuse_no_tree(robot, name)
    refuse_odd_joints(robot, name)
    return text


def _refuse_impossible(link: ET.Element, name: str) -> None:
    """Raise ConfigError for moments of inertia, all of which can be read, that no body has."""
    where = shown(f"link {link.get('name')}")
    for inertia in link.iterfind("inertial/inertia"):
        xx, xy, xz, yy, yz, zz = (float(inertia.get(moment, "")) for moment in _MOMENTS)
        least, middle, most = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).tolist()
        if most > (1.0 + ROUNDED) * (least + middle):  # nor is one of them negative then
            raise ConfigError(
                f"inertia of {where} in {name}",
                found=f"principal moments {least:.3g}, {middle:.3g}, {most:.3g} kg·m²",
                expected="those of a body: none negative, the largest not above the sum of the others",
                remedy="correct its entries: about the centre of mass, ixy, ixz, iyz with the tensor's sign, in kg·m²",
            )


def _numbers(robot: ET.Element) -> Iterator[tuple[str, str, str | None, bool]]:
    """Element, attribute, text, and whether it cannot be negative, of every number an arm's motion depends on."""
    for parent in robot.iter():
        if parent.tag == "joint":
            yield from _triples(parent, f"joint {parent.get('name')}")
        if parent.tag != "link":
            continue
        where = f"link {parent.get('name')}"
        for inertial in parent.iter("inertial"):
            yield from _triples(inertial, where)
            mass, inertia = inertial.find("mass"), inertial.find("inertia")
            yield where, "mass", None if mass is None else mass.get("value"), True
            for moment in _MOMENTS:
                yield where, moment, None if inertia is None else inertia.get(moment), moment[1] == moment[2]


def _triples(element: ET.Element, where: str) -> Iterator[tuple[str, str, str | None, bool]]:
    for tag, attribute in _TRIPLES:
        for found in element.findall(tag):
            if attribute in found.attrib:
                yield where, attribute, found.get(attribute), False
