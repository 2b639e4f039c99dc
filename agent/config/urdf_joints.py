"""Whether joints of a URDF can move: its parser takes an axis of any length, and names no joint that it stops at."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from functools import lru_cache
from typing import Final

from agent.config.reading import ConfigError, shown

NUMBER: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?")
_ROUNDED: Final = 1e-3  # by which the length of an axis of few digits may be off
_TURN_RAD: Final = 2.0 * math.pi
_LIMITED: Final = ("revolute", "prismatic")
_LIMITS: Final = ("lower", "upper", "effort", "velocity")


def refuse_odd_joints(robot: ET.Element, name: str) -> None:
    """Raise ConfigError with the joint of the URDF of this name that is none, all of whose triples can be read."""
    for joint in robot.iterfind("joint"):
        kind, where = joint.get("type"), shown(f"joint {joint.get('name')}")
        if kind == "fixed":
            continue
        axis = joint.find("axis")
        words = ("1 0 0" if axis is None else axis.get("xyz", "1 0 0")).split()
        if abs(math.hypot(*map(float, words)) - 1.0) > _ROUNDED:
            raise ConfigError(
                f"axis of {where} in {name}", found=" ".join(words), expected="three numbers of length 1",
                remedy="say about, or along, which axis of its own it moves",
            )  # fmt: skip
        if kind in _LIMITED:
            _refuse_limits(joint, where, name, turns=kind == "revolute")


def _refuse_limits(joint: ET.Element, where: str, name: str, *, turns: bool) -> None:
    limit, numbers = joint.find("limit"), list[float]()
    for key in _LIMITS:
        text = None if limit is None else limit.get(key)
        if text is None or not NUMBER.fullmatch(text):
            raise ConfigError(
                f"limit {key} of {where} in {name}", found="nothing" if text is None else shown(repr(text)),
                expected='a number in <limit lower="" upper="" effort="" velocity="">',
                remedy="give it, in rad, N·m and rad/s" if turns else "give it, in m, N and m/s",
            )  # fmt: skip
        numbers.append(float(text))
    lower, upper, _, _ = numbers
    if not lower < upper:
        raise ConfigError(
            f"limits of {where} in {name}", found=f"{lower:g} to {upper:g}", expected="the lower one first",
            remedy="exchange them, or say how far it moves",
        )  # fmt: skip
    if turns and max(-lower, upper) > _TURN_RAD:
        raise ConfigError(
            f"limits of {where} in {name}", found=f"{lower:g} to {upper:g}", expected="rad, within one turn",
            remedy="give them in rad, as far as the joint may turn; its encoder knows one turn",
        )  # fmt: skip


@lru_cache(maxsize=8)  # arms of one kind
def moving(urdf_xml: str) -> Mapping[str, str]:
    """Names and kinds of the joints of a URDF that move."""
    joints = ET.fromstring(urdf_xml).iterfind("joint")
    return {joint.get("name", ""): kind for joint in joints if (kind := joint.get("type", "")) != "fixed"}


def refuse_macros(robot: ET.Element, name: str) -> None:
    """Raise ConfigError where elements are left of which xacro makes links and joints, and a parser of URDF nothing."""
    found = sorted({element.tag.rpartition("}")[2] for element in robot.iter() if "xacro}" in element.tag})
    if found:
        raise ConfigError(
            name, found=f"elements of xacro: {shown(', '.join(found))}",
            expected="a URDF without macros", remedy="expand it: `xacro FILE.xacro > FILE.urdf`",
        )  # fmt: skip
