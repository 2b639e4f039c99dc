"""What a person sees beside the arms in each mode of a session, and what to say next; the lines of `coop guide`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from agent.modes import TABLE, Mode
from agent.operator.ask import Heard
from agent.operator.message import Reply


@dataclass(frozen=True, slots=True)
class Step:
    """One mode, seen from beside the arms."""

    seen: str
    do: str  # what comes next; CELL stands for the cell
    stop: str  # how it is stopped, and what leads on from there; empty where nothing moves


_STANDS = "coop stop CELL: it stands where it is and opens its gripper; then coop park CELL or coop approach CELL"
_HOLDS = "coop stop CELL: the arms hold the object; then coop lower CELL"

STEPS: Final[Mapping[Mode, Step]] = MappingProxyType({
    Mode.OFF: Step("the arm is limp", "bring it to its rest by hand and start its agent", ""),
    Mode.REST: Step(
        "the arm stands at its rest and pushes back when it is touched",
        "put the object in its place, step back: coop approach CELL (to end: coop release CELL)", "",
    ),
    Mode.APPROACH: Step(
        "the gripper opens and the arm goes slowly to its grasp, stopping once before it",
        "look along each gripper: the object between open fingers? coop grasp CELL, else coop park CELL", _STANDS,
    ),
    Mode.GRASP: Step("the gripper closes", "wait: it holds the object, or says why not and opens again", _STANDS),
    Mode.READY: Step(
        "the grippers hold the object, which still stands", "step back: coop start CELL --in 5", _HOLDS
    ),
    Mode.TRACK: Step("the object is lifted and carried", "wait", _HOLDS),
    Mode.HOLD: Step(
        "the arms hold the object and stand",
        "coop lower CELL sets it down; or support it, then coop release CELL", "",
    ),
    Mode.LOWER: Step("the object goes down to its place", "once it stands: coop release CELL", _HOLDS),
    Mode.RELEASE: Step(
        "the arms give the load back, the grippers open", "once they are open: coop park CELL",
        "coop stop CELL: the arms hold until their grippers begin to open, and stand from then on; then coop release "
        "CELL or coop park CELL",
    ),
    Mode.PARK: Step("the arm backs off and goes to its rest", "wait", _STANDS),
    Mode.HALT: Step("the arm was stopped on its way and stands", "coop park CELL or coop approach CELL", ""),
    Mode.FAULT: Step(
        "the arm does not obey",
        "support it and what it holds; lead the others back; once it has its supply again, fold it into its rest by "
        "hand and start its agent again", "",
    ),
})  # fmt: skip


def lines(heard: Mapping[str, Heard], cell: str) -> list[str]:
    """How each arm is, and what to say to all of them: that of the one that is least far."""
    said, modes = [], []
    for arm, one in heard.items():
        if not isinstance(one, Reply):
            said.append(f"{arm}: does not answer ({one.found})")
            continue
        mode = Mode[one.mode]
        if mode not in STEPS:  # a hand guides it
            said.append(f"{arm}: {one.mode}: {TABLE[mode].says}")
            continue
        modes.append(mode)
        said.append(f"{arm}: {one.mode}: {STEPS[mode].seen}" + (f"; {one.reason}" if one.reason else ""))
    if len(set(modes)) == 1:
        step = STEPS[modes[0]]
        said.append(f"next: {step.do.replace('CELL', cell)}")
        if step.stop:
            said.append(f"to stop: {step.stop.replace('CELL', cell)}")
    elif modes:
        said.append("next: wait until all arms are equally far, or see those that are not")
    return said
