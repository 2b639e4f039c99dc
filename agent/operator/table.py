"""What each of an operator's words does in each mode of an agent: one table for agent, command and documents.

A word that is refused changes nothing.  A further word is a member of Verb, a row of TABLE and an entry of EVENT_OF; a
further mode is a column, and a row without it fails while it is being imported.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Final

from agent.modes import Event, Mode


class Verb(StrEnum):
    """What an operator can ask for."""

    START = "start"  # follow the trajectory from a common instant on
    CANCEL = "cancel"  # take a start back; `coop start` says it when not every arm has taken it
    STOP = "stop"  # hold the object where it is
    RELEASE = "release"  # the object is supported: torque off
    STATUS = "status"  # say how things are
    APPROACH = "approach"  # of a session (agent.operator.session_table): go to the grasp
    GRASP = "grasp"  # close the gripper
    LOWER = "lower"  # set the object down where it stood
    PARK = "park"  # go back to rest


@dataclass(frozen=True, slots=True)
class Effect:
    """What a word does in one mode."""

    becomes: Mode | None  # mode that follows at once; None: the word is refused
    does: str  # what the arm does then; of a refused word what it is doing, and why that stands in the way
    remedy: str = ""  # of a refused word

    @property
    def accepted(self) -> bool:
        """Whether the agent takes the word."""
        return self.becomes is not None


EVENT_OF: Final[Mapping[Verb, Event]] = MappingProxyType({
    Verb.STOP: Event.STOP, Verb.RELEASE: Event.RELEASED, Verb.APPROACH: Event.APPROACH, Verb.GRASP: Event.GRASP,
    Verb.LOWER: Event.LOWER, Verb.PARK: Event.PARK,
})  # fmt: skip
MODES: Final = tuple(mode for mode in Mode if mode <= Mode.FAULT)  # of an agent that begins with the object in its grip

_OF_SESSION = (Verb.APPROACH, Verb.GRASP, Verb.LOWER, Verb.PARK)
_NO_SESSION = Effect(None, "it began with the object in its gripper", "start its agent with --whole, arms at rest")
_NOT_YET = Effect(
    None,
    "its torque is off, for it is starting or ending",
    "wait until it is at REST; one that says READY instead began with the object in its gripper: start it with --whole",
)
_AGAIN = "release it once the object is supported, and start its agent again"
_UNBEGUN = "has no torque yet: it stays off, and its agent ends (a simulated arm begins all the same"
_LETS_GO = "lets go and ends, as a simulated arm does"
_STOP_FIRST = "stop it first, support the object, then release it"


def _in_each(row: Mapping[Mode, Effect]) -> Mapping[Mode, Effect]:
    missing = set(MODES) - set(row)
    if missing:
        raise ValueError(f"no effect in {', '.join(sorted(mode.name for mode in missing))}")
    return MappingProxyType(dict(row))


TABLE: Final[Mapping[Verb, Mapping[Mode, Effect]]] = MappingProxyType({
    Verb.START: _in_each({
        Mode.OFF: Effect(None, "its torque is off", "start its agent, and wait until it is READY"),
        Mode.READY: Effect(Mode.READY, "follows the trajectory from the instant on, which replaces an earlier one"),
        Mode.TRACK: Effect(None, "it follows the trajectory already", "stop and release it, start its agent again"),
        Mode.HOLD: Effect(None, "it holds the object, and nothing leads from there to a motion", _AGAIN),
        Mode.LOWER: Effect(None, "it lowers the object", "wait until it is down, and start its agent again"),
        Mode.FAULT: Effect(None, "it does not obey", "see its log, and start its agent again"),
    }),
    Verb.CANCEL: _in_each({
        Mode.OFF: Effect(Mode.OFF, "has nothing to take back"),
        Mode.READY: Effect(Mode.READY, "forgets the instant"),
        Mode.TRACK: Effect(Mode.HOLD, "holds: the start to be taken back has been"),
        Mode.HOLD: Effect(Mode.HOLD, "has nothing to take back"),
        Mode.LOWER: Effect(Mode.LOWER, "has nothing to take back"),
        Mode.FAULT: Effect(Mode.FAULT, "has nothing to take back"),
    }),
    Verb.STOP: _in_each({
        Mode.OFF: Effect(Mode.OFF, f"{_UNBEGUN}, and is stopped then)"),
        Mode.READY: Effect(Mode.HOLD, "holds; a start that was given counts no more"),
        Mode.TRACK: Effect(Mode.HOLD, "holds the object where it is"),
        Mode.HOLD: Effect(Mode.HOLD, "goes on holding"),
        Mode.LOWER: Effect(Mode.LOWER, "goes on lowering, at the bounded speed"),
        Mode.FAULT: Effect(Mode.FAULT, "cannot do more"),
    }),
    Verb.RELEASE: _in_each({
        Mode.OFF: Effect(Mode.OFF, f"{_UNBEGUN})"),
        Mode.READY: Effect(None, "it waits for the start with torque on", _STOP_FIRST),
        Mode.TRACK: Effect(None, "it follows the trajectory", _STOP_FIRST),
        Mode.HOLD: Effect(Mode.OFF, "switches its torque off, and its agent ends"),
        Mode.LOWER: Effect(Mode.OFF, "switches its torque off, and its agent ends"),
        Mode.FAULT: Effect(None, "it does not obey, and its agent ends by itself", "support it, then cut its supply"),
    }),
    Verb.STATUS: _in_each({mode: Effect(mode, "says how things are") for mode in MODES}),
    **{verb: _in_each({**dict.fromkeys(MODES, _NO_SESSION), Mode.OFF: _NOT_YET}) for verb in _OF_SESSION},
})  # fmt: skip


# what a stop does to an agent that lets go at one, as it says of itself (`drops_on_stop`), where it is not as in TABLE
LETS_GO: Final[Mapping[Mode, str]] = MappingProxyType(
    {
        Mode.READY: f"holds for a moment, then {_LETS_GO}; a start that was given counts no more",
        Mode.TRACK: f"holds the object for a moment, then {_LETS_GO}",
        Mode.HOLD: _LETS_GO,
        Mode.LOWER: _LETS_GO,
        **dict.fromkeys(
            (Mode.REST, Mode.APPROACH, Mode.GRASP, Mode.RELEASE, Mode.PARK, Mode.HALT),
            f"stands for a moment, then {_LETS_GO}",
        ),
    }
)


def effect(verb: Verb, mode: Mode) -> Effect:
    """What the word does to an agent in this mode."""
    return TABLE[verb][mode]


def markdown() -> str:
    """The table as it stands in docs/commands.md, one line per word and mode."""
    lines = ["| word | in | does | mode then |", "|---|---|---|---|"]
    for verb, row in TABLE.items():
        if verb is Verb.STATUS or verb in _OF_SESSION:
            continue
        for mode, found in row.items():
            if found.becomes is None:
                lines.append(f"| {verb} | {mode.name} | **refused**: {found.does}; {found.remedy} | {mode.name} |")
            else:
                lines.append(f"| {verb} | {mode.name} | {found.does} | {found.becomes.name} |")
    return "\n".join(lines) + "\n"
