"""What a person sees beside the arms in each mode of a session, and what to say next; the lines of `coop guide`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from agent.modes import Mode
from agent.operator.ask import Heard
from agent.operator.message import Reply


@dataclass(frozen=True, slots=True)
class Step:
    """One mode, seen from beside the arms."""

    seen: str
    do: str  # what comes next; CELL stands for the cell


STEPS: Final[Mapping[Mode, Step]] = MappingProxyType({
    Mode.OFF: Step("the arm is limp", "bring it to its rest by hand and start its agent"),
    Mode.REST: Step(
        "the arm stands at its rest and pushes back when it is touched",
        "put the object in its place, step back: coop approach CELL (to end: coop release CELL)",
    ),
    Mode.APPROACH: Step(
        "the gripper opens and the arm goes slowly to its grasp, stopping once before it",
        "look along each gripper: the object between open fingers? coop grasp CELL, else coop park CELL",
    ),
    Mode.GRASP: Step("the gripper closes", "wait: it holds the object, or says why not and opens again"),
    Mode.READY: Step(
        "the grippers hold the object, which still stands", "step back: coop start CELL --in 5"
    ),
    Mode.TRACK: Step("the object is lifted and carried", "wait; coop stop CELL holds it where it is"),
    Mode.HOLD: Step(
        "the arms hold the object and stand", "coop lower CELL sets it down; or support it, then coop release CELL"
    ),
    Mode.LOWER: Step("the object goes down to its place", "once it stands: coop release CELL"),
    Mode.RELEASE: Step("the arms give the load back, the grippers open", "once they are open: coop park CELL"),
    Mode.PARK: Step("the arm backs off and goes to its rest", "wait"),
    Mode.HALT: Step("the arm was stopped on its way and stands", "coop park CELL or coop approach CELL"),
    Mode.FAULT: Step("the arm does not obey", "support it, cut its supply, read its log"),
})  # fmt: skip


def lines(heard: Mapping[str, Heard], cell: str) -> list[str]:
    """How each arm is, and what to say to all of them: that of the one that is least far."""
    said, modes = [], []
    for arm, one in heard.items():
        if not isinstance(one, Reply):
            said.append(f"{arm}: does not answer ({one.found})")
            continue
        mode = Mode[one.mode]
        modes.append(mode)
        said.append(f"{arm}: {one.mode}: {STEPS[mode].seen}" + (f"; {one.reason}" if one.reason else ""))
    if len(set(modes)) == 1:
        said.append(f"next: {STEPS[modes[0]].do.replace('CELL', cell)}")
    elif modes:
        said.append("next: wait until all arms are equally far, or see those that are not")
    return said
