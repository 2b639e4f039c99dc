"""Register counts to SI and back.  Pure; the only place where a count becomes a radian, an ampere or a volt.

An absolute encoder knows the angle within a turn, and Present Position may come with whole turns added or lost (after a
reboot, a mode change, or past the end of the scale).  So an angle is never the difference of raw counts: it is the one
angle within the turn centred on the joint's range.
"""

from __future__ import annotations

from drivers.dynamixel.arm_map import TICKS_PER_TURN, JointMap
from drivers.dynamixel.servo.table import (
    TICK_RAD,
    VELOCITY_UNIT_RAD_PER_S,
    VOLTAGE_UNIT_V,
    WATCHDOG_UNIT_S,
    ServoModel,
)


class AngleScale:
    """Counts of one joint's position to its angle, right for any number of whole turns in the count."""

    def __init__(self, joint: JointMap) -> None:
        low, high = joint.position_limit_ticks
        self._first = low - (TICKS_PER_TURN - 1 - (high - low)) // 2  # where the turn around the range begins
        self._zero = joint.zero_tick

    def angle_rad(self, tick: int) -> float:
        """Joint angle of a Present Position."""
        return ((tick - self._first) % TICKS_PER_TURN + self._first - self._zero) * TICK_RAD


def velocity_rad_per_s(count: int) -> float:
    """Joint speed of a Present Velocity."""
    return count * VELOCITY_UNIT_RAD_PER_S


def volts(count: int) -> float:
    """Supply voltage of a Present Input Voltage."""
    return count * VOLTAGE_UNIT_V


def watchdog_count(seconds: float) -> int:
    """Bus Watchdog value of a time."""
    return round(seconds / WATCHDOG_UNIT_S)


def current_unit_A(model: ServoModel) -> float:
    """Amperes per count.  Raises ValueError for a servo without a current sensor."""
    if model.current_unit_mA is None:
        raise ValueError(f"{model.name} senses no current")
    return model.current_unit_mA * 1e-3
