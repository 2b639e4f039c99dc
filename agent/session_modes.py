"""Which mode follows which in a session from rest to rest: one table, of which docs/session.md is the prose.

HOLD keeps what is gripped; only RELEASE opens a gripper that holds something, and only an arm that holds nothing may be
switched off.  A stop wins over every word that comes with it, also where it changes nothing by itself: while one lasts,
whatever else does, an arm comes to stand, and two modes never take turns.
"""

from __future__ import annotations

from agent.modes import Event, Mode

# By mode; of several events the first of the row counts.
_STOPS = Event.TROUBLE | Event.STOP
_SESSION: dict[Mode, tuple[tuple[Event, Mode], ...]] = {
    Mode.OFF: ((Event.TROUBLE, Mode.OFF), (Event.ENABLED, Mode.REST)),
    Mode.REST: ((Event.STOP, Mode.REST), (Event.RELEASED, Mode.OFF), (Event.APPROACH, Mode.APPROACH)),
    Mode.APPROACH: ((_STOPS, Mode.HALT), (Event.GRASP, Mode.GRASP), (Event.PARK, Mode.PARK)),
    Mode.GRASP: ((_STOPS, Mode.HALT), (Event.NOT_GRIPPED, Mode.APPROACH), (Event.GRIPPED, Mode.READY)),
    Mode.READY: ((_STOPS, Mode.HOLD), (Event.STARTED, Mode.TRACK), (Event.RELEASED, Mode.RELEASE)),
    Mode.TRACK: ((_STOPS, Mode.HOLD),),
    Mode.HOLD: ((Event.STOP, Mode.HOLD), (Event.RELEASED, Mode.RELEASE), (Event.LOWER, Mode.LOWER)),
    Mode.LOWER: ((_STOPS, Mode.HOLD), (Event.RELEASED, Mode.RELEASE)),
    Mode.RELEASE: ((Event.GRIPPED, Mode.HOLD), (_STOPS, Mode.HALT), (Event.PARK, Mode.PARK)),
    Mode.PARK: ((_STOPS, Mode.HALT), (Event.ARRIVED, Mode.REST), (Event.APPROACH, Mode.APPROACH)),
    Mode.HALT: (
        (Event.STOP, Mode.HALT),
        (Event.RELEASED, Mode.OFF),
        (Event.APPROACH, Mode.APPROACH),
        (Event.PARK, Mode.PARK),
    ),
}


def next_in_session(mode: Mode, events: Event) -> Mode:
    """Mode of the next tick of an arm that goes from its rest to the object and back."""
    if Event.SERVO_LOST in events:
        return Mode.FAULT
    return next((after for event, after in _SESSION.get(mode, ()) if events & event), mode)
