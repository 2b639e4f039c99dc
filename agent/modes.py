"""Operating modes as one table: what each is called, whether it commands torque, and which mode follows which event.

Whoever runs an arm asks `next_mode` and never assigns a mode.  No event leads from HOLD back to TRACK, and none out of
FAULT.  Nothing that ships enters LOWER yet.
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


class Event(enum.IntFlag):
    """What can change a mode; several may come at once."""

    NONE = 0
    ENABLED = 1  # the agent has switched torque on
    STARTED = 2  # the common start instant has passed
    STOP = 4  # an operator or the service manager asked for a stop
    TROUBLE = 8  # something is wrong, the servos still obey
    SERVO_LOST = 16  # the arm does not obey any more
    RELEASED = 32  # an operator confirmed that the object is supported


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
        "torque off", False, ((Event.TROUBLE | Event.SERVO_LOST, Mode.OFF), (Event.ENABLED, Mode.READY))
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
})  # fmt: skip


def next_mode(mode: Mode, events: Event) -> Mode:
    """Mode of the next tick by the table.  HOLD is left by a release or a lost arm alone, FAULT not at all."""
    for any_of, following in TABLE[mode].follows:
        if events & any_of:
            return following
    return mode
