"""Where a log that is played stands, and what a person may ask of it: pause, step, seek, pace, end."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Final

SEEK_S: Final = 5.0
PACE: Final = 2.0  # factor of faster and slower
SPEED_MIN, SPEED_MAX = 1e-3, 1e3


class Order(enum.Enum):
    """What may be asked while it plays."""

    PAUSE = enum.auto()  # and go on again
    STEP = enum.auto()  # to the next message, and stay there
    BACK = enum.auto()
    AHEAD = enum.auto()
    BEGIN = enum.auto()
    FASTER = enum.auto()
    SLOWER = enum.auto()
    QUIT = enum.auto()


@dataclass(slots=True)
class Playhead:
    """Position and pace; at_s counts from the first message that is played."""

    length_s: float
    speed: float
    at_s: float = 0.0
    paused: bool = False
    quit: bool = False

    def pass_time(self, elapsed_s: float) -> None:
        """Go on for so much of real time, to the end at most."""
        if not self.paused:
            self.at_s = min(self.at_s + elapsed_s * self.speed, self.length_s)

    def take(self, order: Order, next_s: float | None) -> bool:
        """Do as asked; next_s: where the next message is.  True when what follows is not what followed before."""
        if order is Order.PAUSE:
            self.paused = not self.paused
        elif order is Order.STEP:
            self.paused = True
            if next_s is not None:
                self.at_s = next_s
        elif order is Order.QUIT:
            self.quit = True
        elif order is Order.FASTER:
            self.speed = min(self.speed * PACE, max(self.speed, SPEED_MAX))
        elif order is Order.SLOWER:
            self.speed = max(self.speed / PACE, min(self.speed, SPEED_MIN))
        else:
            return self._seek({Order.BACK: self.at_s - SEEK_S, Order.AHEAD: self.at_s + SEEK_S}.get(order, 0.0))
        return False

    def _seek(self, to_s: float) -> bool:
        self.at_s = min(max(to_s, 0.0), self.length_s)
        return True
