"""Register counts to SI and back, for driver, servo tools and doctor: each of these factors is applied here.

An absolute encoder knows the angle within a turn, and Present Position may come with whole turns added or lost (after a
reboot, a mode change, or past the end of the scale).  So an angle is not the difference of raw counts: it is the one
angle within the turn centred on the joint's range.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from drivers.dynamixel.servo.counts import (
    LOAD_UNIT_DUTY,
    PWM_UNIT_DUTY,
    RETURN_DELAY_UNIT_S,
    TICK_RAD,
    TICKS_PER_TURN,
    VELOCITY_UNIT_RAD_PER_S,
    VOLTAGE_UNIT_V,
    WATCHDOG_UNIT_S,
)
from drivers.dynamixel.servo.models import ServoModel

if TYPE_CHECKING:
    from drivers.dynamixel.arm_map import JointMap


class AngleScale:
    """Counts of one joint's position to its angle, right for any number of whole turns in the count."""

    def __init__(self, joint: JointMap) -> None:
        low, high = joint.position_limit_ticks
        self._first = low - (TICKS_PER_TURN - 1 - (high - low)) // 2  # where the turn around the range begins
        self._zero = joint.zero_tick
        self.limits_rad = (ticks_rad(low - joint.zero_tick), ticks_rad(high - joint.zero_tick))

    def angle_rad(self, tick: int) -> float:
        """Joint angle of a Present Position."""
        return ((tick - self._first) % TICKS_PER_TURN + self._first - self._zero) * TICK_RAD


def ticks_rad(count: int) -> float:
    """Angle that a number of ticks makes."""
    return count * TICK_RAD


def angle_ticks(angle_rad: float) -> int:
    """Number of ticks nearest to an angle."""
    return round(angle_rad / TICK_RAD)


def velocity_rad_per_s(count: int) -> float:
    """Joint speed of a Present Velocity."""
    return count * VELOCITY_UNIT_RAD_PER_S


def velocity_count(rad_per_s: float) -> int:
    """Largest Present Velocity count that is not above a speed."""
    return int(rad_per_s / VELOCITY_UNIT_RAD_PER_S)


def volts(count: int) -> float:
    """Supply voltage of a Present Input Voltage, or of a limit of it."""
    return count * VOLTAGE_UNIT_V


def pwm_count_V(supply_V: float) -> float:
    """Voltage at the winding that one count of Goal PWM makes."""
    return supply_V * PWM_UNIT_DUTY


def watchdog_count(seconds: float) -> int:
    """Bus Watchdog value nearest to a time."""
    return round(seconds / WATCHDOG_UNIT_S)


def watchdog_s(count: int) -> float:
    """Time of a Bus Watchdog value."""
    return count * WATCHDOG_UNIT_S


def return_delay_s(count: float) -> float:
    """Pause before a reply of a Return Delay Time."""
    return count * RETURN_DELAY_UNIT_S


def current_unit_A(model: ServoModel) -> float:
    """Amperes per count.  Raises ValueError for a servo without a current sensor."""
    if model.current_unit_mA is None:
        raise ValueError(f"{model.name} senses no current")
    return model.current_unit_mA * 1e-3


def current_or_load(model: ServoModel, count: float) -> tuple[float, float]:
    """A of a Present Current, or the share of what a Present Load counts; NaN for the one that the servo lacks."""
    if model.current_unit_mA is None:
        return math.nan, count * LOAD_UNIT_DUTY
    return count * current_unit_A(model), math.nan
