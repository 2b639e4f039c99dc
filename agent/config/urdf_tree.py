"""Whether links and joints of a URDF are one tree: its parser says on standard error alone, or nowhere, why not."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from agent.config.reading import ConfigError, shown
from agent.config.schema.types import nearest

KINDS: Final = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
ENDS: Final = ("parent", "child")
NAMES_SHOWN: Final = 400  # characters


def refuse_no_tree(robot: ET.Element, name: str) -> None:
    """Raise ConfigError with the link or joint for which the URDF of this name is no tree, or where it is no URDF."""
    if robot.tag != "robot":  # with a namespace, too: the names of all elements have it then, and none is looked at
        raise ConfigError(
            name, found=f"a root element {shown(repr(robot.tag))}", expected="<robot>, without an xmlns of its own",
            remedy="give the URDF of the arm",
        )  # fmt: skip
    links = [link.get("name", "") for link in robot.iterfind("link")]
    joints = list(robot.iterfind("joint"))
    _refuse_repeated("link", links, name)
    _refuse_repeated("joint", [joint.get("name", "") for joint in joints], name)
    for joint in joints:
        _refuse_odd_type(joint, name)
    edges = [_ends(joint, links, name) for joint in joints]
    _refuse_two_parents(joints, edges, name)
    _refuse_apart(links, edges, name)


def _refuse_repeated(what: str, names: Iterable[str], name: str) -> None:
    for one, count in Counter(names).items():
        if count > 1 or not one:
            raise ConfigError(
                f"{what} {shown(repr(one))} in {name}" if one else f"a {what} in {name}",
                found=f"{count} of that name" if one else "no name",
                expected=f"a name of its own for each {what}",
                remedy=f"rename or remove one {what}" if one else "name it",
            )


def _refuse_odd_type(joint: ET.Element, name: str) -> None:
    kind = joint.get("type")
    if kind not in KINDS:
        raise ConfigError(
            f"type of joint {shown(str(joint.get('name')))} in {name}",
            found="nothing" if kind is None else shown(repr(kind)),
            expected=f"one of {', '.join(KINDS)}",
            remedy=nearest(kind or "", KINDS) or "say how it moves",
        )


def _ends(joint: ET.Element, links: Sequence[str], name: str) -> tuple[str, str]:
    """Parent and child link of a joint.  Raises ConfigError for one that is not there."""
    ends = []
    for end in ENDS:
        found = joint.find(end)
        link = None if found is None else found.get("link")
        if link is None or link not in links:
            raise ConfigError(
                f"{end} of joint {shown(str(joint.get('name')))} in {name}",
                found="nothing" if link is None else f"{shown(repr(link))}, a link that the file does not have",
                expected="one of its links: " + shown(", ".join(links) or "it has none", NAMES_SHOWN),
                remedy=nearest(link or "", links) or "correct it, or add that <link>",
            )
        ends.append(link)
    return ends[0], ends[1]


def _refuse_two_parents(joints: Sequence[ET.Element], edges: Sequence[tuple[str, str]], name: str) -> None:
    moved_by = defaultdict[str, list[str]](list)
    for joint, (_, child) in zip(joints, edges, strict=True):
        moved_by[child].append(joint.get("name", ""))
    for link, by in moved_by.items():
        if len(by) > 1:
            raise ConfigError(
                f"link {shown(link)} in {name}", found=f"the child of joints {shown(', '.join(by))}",
                expected="one joint whose child it is", remedy="correct the child of the others",
            )  # fmt: skip


def _refuse_apart(links: Sequence[str], edges: Sequence[tuple[str, str]], name: str) -> None:
    """Raise ConfigError unless every link hangs on the one that is no joint's child."""
    children = defaultdict[str, list[str]](list)
    for parent, child in edges:
        children[parent].append(child)
    roots = [link for link in links if all(link != child for _, child in edges)]
    lost = set(links) - _below(roots, children)
    if lost:
        raise ConfigError(
            f"joints in {name}",
            found="links that hang on each other in a ring: "
            + shown(", ".join(link for link in links if link in lost), NAMES_SHOWN),
            expected="a tree with one base", remedy="correct parent and child of their joints",
        )  # fmt: skip
    if len(roots) != 1:
        raise ConfigError(
            f"links in {name}",
            found=f"{shown(' and '.join(roots), NAMES_SHOWN)}, none of them the child of a joint" if roots else "none",
            expected="one base on which all others hang", remedy="add the joint that is missing, or remove the link",
        )  # fmt: skip


def _below(roots: Iterable[str], children: Mapping[str, Sequence[str]]) -> set[str]:
    """These links and all that hang on them, where each is one joint's child at most."""
    found, ahead = set[str](), list(roots)
    while ahead:
        link = ahead.pop()
        found.add(link)
        ahead += children.get(link, ())
    return found
