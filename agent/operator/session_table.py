"""What each word does in each mode of an agent that goes from its rest to the object and back; made of its modes.

What leads where is `agent.session_modes` and `agent.session.WORDS`; here it gets its words for a person.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from agent.modes import FLOATING, Event, Mode
from agent.operator.table import EVENT_OF, Effect, Verb
from agent.session import WORDS
from agent.session_modes import next_in_session

DOING: Final[Mapping[Mode, str]] = MappingProxyType({
    Mode.OFF: "its torque is off",
    Mode.READY: "it holds the object and waits for the start",
    Mode.TRACK: "it follows the trajectory",
    Mode.HOLD: "it holds the object",
    Mode.LOWER: "it lowers the object",
    Mode.FAULT: "it does not obey",
    Mode.REST: "it stands at its rest",
    Mode.APPROACH: "it goes to its grasp, or stands there",
    Mode.GRASP: "its gripper closes",
    Mode.RELEASE: "it lets go of the object, or has",
    Mode.PARK: "it goes back to its rest",
    Mode.HALT: "it was stopped on its way, and stands",
})  # fmt: skip
_DOES: Final[Mapping[tuple[Verb, Mode], str]] = MappingProxyType({
    (Verb.APPROACH, Mode.APPROACH): "opens its gripper and goes to its grasp",
    (Verb.GRASP, Mode.GRASP): "closes its gripper; on the object it takes up its load share, else it opens again",
    (Verb.LOWER, Mode.LOWER): "lowers the object to its place",
    (Verb.PARK, Mode.PARK): "goes back to its rest",
    (Verb.RELEASE, Mode.RELEASE): "gives its load share back and opens its gripper",
    (Verb.RELEASE, Mode.OFF): "switches its torque off, and its agent ends",
    (Verb.START, Mode.TRACK): "follows the trajectory from the instant on, which replaces an earlier one",
    (Verb.STOP, Mode.HOLD): "holds the object where it is, gripper closed",
    (Verb.STOP, Mode.HALT): "stops where it is, and opens its gripper",
    (Verb.CANCEL, Mode.HOLD): "holds: what is taken back had begun",
})  # fmt: skip
MODES: Final = tuple(mode for mode in Mode if mode not in FLOATING)
_EVENT: Final = {**EVENT_OF, Verb.START: Event.STARTED}


def _effect(verb: Verb, mode: Mode) -> Effect:
    if verb is Verb.STATUS:
        return Effect(mode, "says how things are")
    if verb is Verb.CANCEL:
        begun = mode in (Mode.TRACK, Mode.LOWER)
        return Effect(Mode.HOLD, _DOES[verb, Mode.HOLD]) if begun else Effect(mode, "does not begin any more")
    after = next_in_session(mode, _EVENT[verb])
    if verb is Verb.STOP and mode is Mode.RELEASE:
        return Effect(after, "stops where it is; holds the object (HOLD) as long as its gripper has not begun to open")
    if verb is Verb.STOP:
        return Effect(after, _DOES.get((verb, after), "") if after is not mode else "goes on: nothing moves it")
    if not WORDS.get(mode, Event.NONE) & _EVENT[verb]:
        return Effect(None, DOING[mode], _way(mode))
    return Effect(mode if verb is Verb.START else after, _DOES[verb, after])


def _way(mode: Mode) -> str:
    """What may be said instead."""
    words = WORDS.get(mode, Event.NONE)
    said = [f"`coop {verb.value}`" for verb, event in _EVENT.items() if words & event]
    if said:
        return f"from here: {' or '.join(said)}"
    waits = {Mode.GRASP: "wait until it has", Mode.TRACK: "stop it first", Mode.PARK: "wait until it is there"}
    return waits.get(mode, "start its agent again")


SESSION: Final[Mapping[Verb, Mapping[Mode, Effect]]] = MappingProxyType(
    {verb: MappingProxyType({mode: _effect(verb, mode) for mode in MODES}) for verb in Verb}
)


def markdown() -> str:
    """The words that are taken, by mode, as they stand in docs/session.md."""
    lines = ["| in | word | does | mode then |", "|---|---|---|---|"]
    for mode in MODES:
        for verb, row in SESSION.items():
            found = row[mode]
            plain = verb in (Verb.STATUS, Verb.CANCEL) or (verb is Verb.STOP and found.becomes is mode)
            if found.becomes is not None and not plain:
                then = Mode.TRACK if verb is Verb.START else found.becomes
                lines.append(f"| {mode.name} | {verb.value} | {found.does} | {then.name} |")
    return "\n".join(lines) + "\n"
