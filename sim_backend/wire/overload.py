"""When a servo calls its load an overload: a current above a share of its stall current, for longer than a time.

The e-manual says no more than "persistent load that exceeds maximum output".  What owners report of an XM430 at 12 V:
0.94 A (41 % of its stall current) held in position mode trips after about 5 s, whatever the Current Limit (DynamixelSDK
issue 285); a blocked one trips in position mode and, at a lower current, in current-based position mode (ROBOTIS forum,
topic 5730); one in velocity mode trips too.  Nobody reports it of current or PWM mode, and nobody rules it out.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from drivers.dynamixel.servo.codes import OperatingMode
from drivers.dynamixel.servo.models import OVERLOAD_SHARE

_OPEN_LOOP = frozenset({OperatingMode.CURRENT, OperatingMode.PWM})


class OverloadModes(Enum):
    """In which operating modes a servo looks for overload."""

    NONE = "none"
    CLOSED_LOOP = "closed_loop"  # velocity and all position modes: what is reported
    ALL = "all"  # current and PWM mode too

    def watch(self, mode: OperatingMode) -> bool:
        """Return whether a servo in this mode is watched."""
        return self is OverloadModes.ALL or (self is OverloadModes.CLOSED_LOOP and mode not in _OPEN_LOOP)


@dataclass(frozen=True, slots=True)
class OverloadOptions:
    """How much for how long; the share is below the reported 41 %, at which servos do trip."""

    modes: OverloadModes = OverloadModes.CLOSED_LOOP
    share_of_stall: float = OVERLOAD_SHARE
    trips_after_s: float = 5.0


REPORTED = OverloadOptions()


class OverloadWatch:
    """Time that one servo has spent above the threshold; time below it counts back (an assumption)."""

    def __init__(self, options: OverloadOptions, stall_current_A: float) -> None:
        self._options = options
        self._threshold_A = options.share_of_stall * stall_current_A
        self._above_s = 0.0

    def reset(self) -> None:
        """Forget, as a boot does."""
        self._above_s = 0.0

    def step(self, dt_s: float, current_A: float, mode: OperatingMode) -> bool:
        """Count `dt_s` at this current; True while the load is an overload."""
        if not self._options.modes.watch(mode):
            self._above_s = 0.0
            return False
        above = abs(current_A) >= self._threshold_A
        self._above_s = max(0.0, self._above_s + (dt_s if above else -dt_s))
        return self._above_s >= self._options.trips_after_s
