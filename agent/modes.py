"""Operating modes, and which one follows when something happens; no event leads from HOLD back to TRACK.

`agent.runner` asks after every cycle.  FAULT it enters by itself, when an arm gives no state any more; no process
that ships raises ENABLED or SERVO_LOST yet, or enters LOWER.
"""

from __future__ import annotations

import enum


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


class Event(enum.IntFlag):
    """What can change a mode; several may come at once."""

    NONE = 0
    ENABLED = 1
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
    GRIPPED = 1024  # the gripper has closed on something as wide as the object
    NOT_GRIPPED = 2048  # it has closed on nothing, too early, or not at all
    ARRIVED = 4096  # the arm has come to the end of its way


def next_mode(mode: Mode, events: Event) -> Mode:
    """Mode of the next tick.  The worst event wins; HOLD and FAULT are latched until an operator releases."""
    if mode is Mode.OFF:
        return Mode.READY if Event.ENABLED in events and not events & (Event.TROUBLE | Event.SERVO_LOST) else Mode.OFF
    if Event.SERVO_LOST in events:
        return Mode.FAULT
    if mode is Mode.READY:
        if events & (Event.TROUBLE | Event.STOP):
            return Mode.HOLD
        return Mode.TRACK if Event.STARTED in events else Mode.READY
    if mode is Mode.TRACK:
        return Mode.HOLD if events & (Event.TROUBLE | Event.STOP) else Mode.TRACK
    return Mode.OFF if Event.RELEASED in events else mode  # HOLD, LOWER, FAULT
