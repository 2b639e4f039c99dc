"""What the driver tells besides torque and state: facts for the log."""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass


class EventKind(enum.Enum):
    """What happened."""

    EEPROM_WRITTEN = "EEPROM written"
    RAM_WRITTEN = "left by another program, set anew"
    SLOW_SYNC_READ = "no fast sync read on this bus"
    HARDWARE_WARNING = "hardware error bit that does not stop the servo"
    HOT = "servo is close to its temperature limit"
    HEATING = "servo will reach its temperature limit"
    VOLTAGE = "supply voltage is close to a limit"
    PART_OF_CURRENT = "servo gives a part of the current it was told"
    PAIR_FIGHTING = "servos of one joint push against each other"
    PAIR_APART = "servos of one joint moved apart"
    SLOW_CHECKS = "servo checks take longer than they should"
    PORT_REOPENED = "port came back"
    REARMED = "bus watchdogs had fired and are armed again"
    FAULT = "servo does not do its part"
    EXPLAINED = "what is wrong with a servo has a cause"


@dataclass(frozen=True, slots=True)
class DriverEvent:
    """One event of one servo, or of the arm (servo_id None)."""

    kind: EventKind
    text: str
    servo_id: int | None = None
    joint: str | None = None


EventSink = Callable[[DriverEvent], None]


def ignore(event: DriverEvent) -> None:
    """Sink for those who do not listen."""


class OncePerServo:
    """Passes on an event when it begins, and not again before it has ended."""

    def __init__(self, sink: EventSink) -> None:
        self._sink = sink
        self._active: set[tuple[EventKind, int | None]] = set()

    def tell(self, event: DriverEvent, *, active: bool) -> None:
        """active: the condition holds now."""
        key = (event.kind, event.servo_id)
        if not active:
            self._active.discard(key)
        elif key not in self._active:
            self._active.add(key)
            self._sink(event)

    def is_active(self, kind: EventKind, servo_id: int | None) -> bool:
        """True while the condition holds, so that a caller need not build the event's text again."""
        return (kind, servo_id) in self._active
