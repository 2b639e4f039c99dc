"""Operating modes as one table: what each is called, whether it commands torque, and which mode follows which event.

Whoever runs an arm asks `next_mode` for the mode that follows.  No event leads from HOLD back to TRACK, and none out of
FAULT.  A session from rest to rest has a table beside this one, `agent.session_modes`, where the way into LOWER is.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType


class Mode(enum.IntEnum):
    """What the agent is doing; logged in every row."""

    OFF = 0  # torque off
    READY = 1  # torque on, the arm holds its start pose and waits for the common start
    TRACK = 2  # the object follows the trajectory
    HOLD = 3  # the object is held where it was when the hold began; latched
    LOWER = 4  # the object is lowered to its support
    FAULT = 5  # the arm cannot be commanded; torque off
    # of a session from rest to rest, in which the arm holds nothing (agent.phases)
    REST = 6  # torque on, the arm stands where it rests
    APPROACH = 7  # it goes to its grasp and stands there, gripper open
    GRASP = 8  # it stands there and closes its gripper
    RELEASE = 9  # the object stands: the arm gives back its load share, opens its gripper and stands
    PARK = 10  # it goes back to where it rests
    HALT = 11  # it was stopped on its way and stands there
    # of an arm that a hand guides (agent.floats)
    FLOAT = 12  # its weight is carried, a hand moves it
    STAND = 13  # it was stopped: it brakes and stands where it came to rest
    SINK = 14  # it goes down slowly under its own weight, until it lies


class Event(enum.IntFlag):
    """What can change a mode; several may come at once."""

    NONE = 0
    ENABLED = 1  # the agent has switched torque on
    STARTED = 2  # the common start instant has passed
    STOP = 4  # an operator or the service manager asked for a stop
    TROUBLE = 8  # something is wrong, the servos still obey
    SERVO_LOST = 16  # the arm does not obey any more
    RELEASED = 32  # an operator confirmed that the object is supported
    # of a session: an operator's words, and what the arm finds out by itself
    APPROACH = 64
    GRASP = 128
    LOWER = 256
    PARK = 512
    GRIPPED = (
        1024  # the gripper has closed on something as wide as the object; in RELEASE: stopped, and it holds it still
    )
    NOT_GRIPPED = 2048  # it has closed on nothing, too early, or not at all
    ARRIVED = 4096  # the arm has come to the end of its way
    FLOATED = 8192  # the agent has switched torque on, of an arm that a hand is to guide


_BY_NUMBER = {int(mode): mode for mode in Mode}
FLOATING = frozenset({Mode.FLOAT, Mode.STAND, Mode.SINK})
# of a session, from a stop to rest: what was wrong before the word is borne there, for it is the reason to go back
WAY_BACK = frozenset({Mode.LOWER, Mode.RELEASE, Mode.PARK})


@dataclass(frozen=True, slots=True)
class Entry:
    """One mode's line of the table."""

    says: str  # to the service manager and to whoever asks
    commands: bool  # torque is commanded, so the loop goes on
    follows: tuple[tuple[Event, Mode], ...] = ()  # the first line of which any event has come decides; none: it stays


_LOST = (Event.SERVO_LOST, Mode.FAULT)
_BAD = Event.STOP | Event.TROUBLE
_LET_GO = (Event.RELEASED, Mode.OFF)

TABLE: Mapping[Mode, Entry] = MappingProxyType({
    Mode.OFF: Entry(
        "torque off", False,
        ((Event.TROUBLE | Event.SERVO_LOST, Mode.OFF), (Event.ENABLED, Mode.READY), (Event.FLOATED, Mode.FLOAT)),
    ),
    Mode.READY: Entry(
        "torque on, holding the start pose; `coop start` sets the common start", True,
        (_LOST, (_BAD, Mode.HOLD), (Event.STARTED, Mode.TRACK)),
    ),
    Mode.TRACK: Entry("following the trajectory", True, (_LOST, (_BAD, Mode.HOLD))),
    Mode.HOLD: Entry(
        "HOLDING the object; `coop release` (or SIGUSR1) once it is supported", True, (_LOST, _LET_GO)
    ),
    Mode.LOWER: Entry("lowering the object", True, (_LOST, _LET_GO)),
    Mode.FAULT: Entry("the arm does not obey", False),
    # of a session, in which agent.session_modes says what follows
    Mode.REST: Entry("torque on, at rest; `coop approach`", True),
    Mode.APPROACH: Entry("on its way to its grasp, or there; `coop grasp`", True),
    Mode.GRASP: Entry("closing its gripper", True),
    Mode.RELEASE: Entry("letting go of the object; `coop park` once its gripper is open", True),
    Mode.PARK: Entry("on its way to its rest", True),
    Mode.HALT: Entry("STOPPED on its way; `coop approach` or `coop park`", True),
    Mode.FLOAT: Entry("floating: a hand may guide it", True, (_LOST, (_BAD, Mode.STAND))),
    Mode.STAND: Entry("STOPPED while it floated; put a hand under it", True, (_LOST, (Event.RELEASED, Mode.SINK))),
    Mode.SINK: Entry("sinking slowly, then its torque goes off", True, (_LOST, (Event.ARRIVED, Mode.OFF))),
})  # fmt: skip


def mode_of(number: int) -> Mode | None:
    """The mode that a row names by its number; None where this version has none of that number."""
    return _BY_NUMBER.get(number)


def mode_name(number: int) -> str:
    """Its name, or the number where there is none."""
    mode = mode_of(number)
    return str(number) if mode is None else mode.name


def next_mode(mode: Mode, events: Event) -> Mode:
    """Mode of the next tick by the table.  HOLD is left by a release or a lost arm alone, FAULT not at all."""
    for any_of, following in TABLE[mode].follows:
        if events & any_of:
            return following
    return mode
