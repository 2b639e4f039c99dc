"""What a person sees beside the arms in each mode, and what to say next; the lines of `coop guide`.

Arms of a session fetch the object and bring it back; others begin with it in their grippers and know fewer words.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final

from agent.modes import TABLE, Mode
from agent.operator.show import ENDED, HUNG, NONE, STARTING, silent, unfit


@dataclass(frozen=True, slots=True)
class Step:
    """One mode, seen from beside the arms."""

    seen: str
    do: str  # what comes next; CELL stands for the cell
    stop: str  # how it is stopped, and what leads on from there; empty where nothing moves


_STANDS_AND_GOES_BACK = "coop stop CELL: it stands where it is and opens its gripper; then coop park CELL"
_STANDS = f"{_STANDS_AND_GOES_BACK} or coop approach CELL"
_HOLDS = "coop stop CELL: the arms hold the object; then coop lower CELL"

STEPS: Final[Mapping[Mode, Step]] = MappingProxyType({
    Mode.OFF: Step("the arm is limp, its agent begins", "fold it into its rest by hand, and wait", ""),
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
        "support it, and the object if it holds it; lead the others back; once it has its supply and its port again, "
        "fold it into its rest by hand and start its agent again", "",
    ),
})  # fmt: skip


_SUPPORT = "support the object; then coop release CELL"
_HOLDS_FOR_GOOD = "coop stop CELL: the arms hold the object; support it, then coop release CELL"

STEPS_HELD: Final[Mapping[Mode, Step]] = MappingProxyType({  # of arms that began with the object in their grippers
    Mode.OFF: Step("the arm has no torque yet, its agent begins", "wait", ""),
    Mode.READY: Step(
        "the arms hold the object and wait for the start", "step back: coop start CELL --in 5", _HOLDS_FOR_GOOD
    ),
    Mode.TRACK: Step("the object is carried", "wait", _HOLDS_FOR_GOOD),
    Mode.HOLD: Step("the arms hold the object and stand", _SUPPORT, ""),
    Mode.LOWER: Step("the arm goes down slowly", _SUPPORT, ""),
    Mode.FAULT: Step("the arm does not obey", "support it and what it holds; then cut its supply", ""),
})  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Way:
    """What is said to arms of one kind."""

    steps: Mapping[Mode, Step]
    going_on: Mapping[Mode, str]  # beside arms that are elsewhere
    going_back: Mapping[Mode, str]  # beside one that is gone, does not obey, or cannot be started
    set_down: str  # behind a stop, where one moves what another holds
    begin: str  # an arm that has ended in order
    lost: str  # one that died where it was; with places for what to support, and for what the others do first
    others_first: str


_IN_SESSION = _Way(
    STEPS,
    going_on={
        Mode.REST: "wait, or coop approach CELL where the others stand at their grasps; to end it coop release CELL",
        Mode.READY: "wait for the others; or coop release CELL, for the object still stands",
    },
    going_back={
        Mode.REST: "coop release CELL ends it",
        Mode.APPROACH: "coop park CELL",
        Mode.READY: "coop release CELL, for the object still stands",
        Mode.HALT: "coop park CELL",
    },
    set_down="coop lower CELL sets the object down",
    begin="bring it to its rest by hand and start its agent",
    lost="{}; {}then fold it into its rest by hand and start its agent",
    others_first="lead the others back; ",
)
_HELD = _Way(
    STEPS_HELD,
    going_on={Mode.READY: f"wait for the others; or coop stop CELL, {_SUPPORT}"},
    going_back={Mode.READY: f"coop stop CELL; {_SUPPORT}"},
    set_down="support the object and coop release CELL",
    begin="start its agent",
    lost="{}; {}then start its agent",
    others_first="stop and release the others; ",
)
_HELD_BRIEFLY = replace(  # of agents that let go where they are stopped
    _HELD,
    going_on={Mode.READY: "wait for the others; or support the object, then coop stop CELL"},
    going_back={Mode.READY: "support the object; then coop stop CELL"},
    others_first="stop the others; ",
)
_CARRIES = frozenset({Mode.READY, Mode.TRACK, Mode.HOLD, Mode.LOWER})
_EMPTY = frozenset({Mode.REST, Mode.APPROACH, Mode.PARK, Mode.HALT})  # it holds nothing
_STAYS = frozenset({Mode.READY, Mode.HOLD})
_ALONE = {  # by how the guard is
    "gone": "its guard is gone, and nobody goes on should its agent end: start it",
    "hangs": "its guard hangs, and nobody goes on should its agent end: look at its log, start it anew",
}
_DEAF = "{}: no word reaches it; its log says why, then end its process"
_WAIT = "wait until it answers"
_NOT_SEEN = (
    "look at it: its agent may run as another user, with another XDG_RUNTIME_DIR or name of the cell, and hears words "
    "that are said from there; where none runs, start its agent"
)
_OTHER_FILE = (
    "next for {}: coop guide with the cell file that its agent was started with; of words with this one it takes "
    "coop stop CELL and coop release CELL alone"
)
_STOPS = "what moves stops, what holds the object goes on holding it"
_ALL_LET_GO = "coop stop CELL: the arms stop for a moment, then let go and end"


def lines(arms: Sequence[Mapping[str, Any]], cell: str, option: str = "--arm") -> list[str]:
    """How each arm is, and what to say: one word to all where all are alike, else the stop first and words by arm.

    arms: as in the document of agent.operator.status; option: that which names them to a word.
    """
    said, modes, silenced = list[str](), dict[str, Mode](), dict[str, tuple[str, str | None]]()
    heard = [arm for arm in arms if arm["answers"]]
    lets_go = [arm["arm"] for arm in heard if arm["drops_on_stop"]]
    ends = _End(lets_go, everyone=len(lets_go) == len(heard))
    held = {arm["session"] for arm in heard} == {False}
    way = _IN_SESSION if not held else _HELD_BRIEFLY if ends.everyone else _HELD
    for arm in arms:
        name: str = arm["arm"]
        head, why = (arm["mode"], "") if arm["answers"] else silent(arm)
        mode = Mode.__members__.get(head)
        if head == NONE:
            said.append(f"{name}: NOT SEEN from here: {why}")
            silenced[name] = head, None
            continue
        if mode is None:
            last = f"last {arm['mode']}" if arm["mode"] else ""
            said.append(f"{name}: " + "; ".join([head, *filter(None, (why, last))]))
            silenced[name] = head, arm["mode"]
            continue
        if mode in way.steps:  # else a hand guides it
            modes[name] = mode
        what = way.steps[mode].seen if mode in way.steps else TABLE[mode].says
        whole = what, _ALONE.get(arm["guard"]), *unfit(arm), arm["reason"]
        said.append(f"{name}: {mode.name}: " + "; ".join(filter(None, whole)))
    back = any(arm["no_start"] or arm["guard"] in _ALONE for arm in heard)
    elsewhere = [arm["arm"] for arm in heard if arm["same_cell"] is False]
    if elsewhere:
        told = [_OTHER_FILE.format(", ".join(elsewhere))]
    elif silenced or len(set(modes.values())) > 1:
        gone = {name: _begin_again(way, *how, others=bool(modes)) for name, how in silenced.items()}
        told = _apart(way, modes, back, gone, ends)
    else:
        told = _alike(way, next(iter(modes.values())), back, ends) if modes else []
    return said + [line.replace("--arm", option).replace("CELL", cell) for line in told]


def missing(arms: Sequence[Mapping[str, Any]]) -> bool:
    """Whether one of them is not there to be told anything; of one that a hand guides nobody expects it."""
    return any(not arm["answers"] and silent(arm)[0] not in Mode.__members__ for arm in arms)


@dataclass(frozen=True, slots=True)
class _End:
    """Whom a stop ends."""

    arms: Sequence[str]  # that let go at one, as simulated arms do
    everyone: bool  # of those that answer

    def of(self, stop: str) -> str:
        """What a stop does, where `stop` is true of arms that hold."""
        if not self.arms:
            return stop
        return _ALL_LET_GO if self.everyone else f"{stop} ({', '.join(self.arms)}: let go and end)"


def _alike(way: _Way, mode: Mode, back: bool, ends: _End) -> list[str]:
    """What to say to arms that are equally far; back: there will be no carry."""
    step = way.steps[mode]
    do = way.going_back.get(mode, step.do) if back else step.do
    stop = _STANDS_AND_GOES_BACK if back and step.stop is _STANDS else step.stop
    return [f"next: {do}", *([f"to stop: {ends.of(stop)}"] if stop else [])]


def _apart(way: _Way, modes: Mapping[str, Mode], back: bool, gone: Mapping[str, str], ends: _End) -> list[str]:
    """What to say to arms that are not equally far; gone: what to do with those that hear nothing."""
    moves = any(way.steps[mode].stop for mode in modes.values())
    told = [f"to stop: {ends.of(f'coop stop CELL: {_STOPS}')}"] if moves else []
    carry = [name for name, mode in modes.items() if mode in _CARRIES]
    how = {modes[name] for name in carry}
    if Mode.TRACK in how or (Mode.LOWER in how and how & _STAYS):  # one moves what another one holds, or has lost
        everyone = len(carry) == len(modes) + len(gone)
        then = "coop stop CELL; then " + _to(way.set_down, [] if everyone else carry)
        told.append(f"next: {'support the object; then coop stop CELL' if ends.everyone else then}")
    else:
        carry = []
    back = back or Mode.FAULT in modes.values() or any(text != _WAIT for text in gone.values())
    beside = way.going_back if back else way.going_on
    steps = {name: beside.get(mode, way.steps[mode].do) for name, mode in modes.items()}
    left = {name: text for name, text in {**steps, **gone}.items() if name not in carry}
    for text in dict.fromkeys(left.values()):
        meant = [name for name, own in left.items() if own == text]
        told.append(f"next for {', '.join(meant)}: {_to(text, meant)}")
    return told


def _begin_again(way: _Way, head: str, last: str | None, *, others: bool) -> str:
    """What to do with an arm that hears nothing, by how it is and its last mode; others: some hear."""
    if head == STARTING:
        return _WAIT
    support = _to_support(last)
    if head == HUNG:
        return _DEAF.format(support)
    if head == NONE:
        return _NOT_SEEN
    if head == ENDED and last != Mode.FAULT.name:
        return way.begin
    return way.lost.format(support, way.others_first if others else "")


def _to_support(last: str | None) -> str:
    """What a hand is put under, of an arm whose mode was the last that is known."""
    mode = Mode.__members__.get(last or "")
    if mode in _EMPTY:
        return "support it"
    return "support it, and the object if it holds it" if mode is Mode.FAULT else "support it and what it holds"


def _to(text: str, arms: Sequence[str]) -> str:
    """The words of a text, said to these arms alone; none: to all."""
    return re.sub(r"coop (\w+) CELL", "".join([r"coop \1 CELL", *(f" --arm {arm}" for arm in arms)]), text)
