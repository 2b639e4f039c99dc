"""What one count of a register stands for: the "Unit" column of the control tables in the ROBOTIS e-manual of 2026."""

from __future__ import annotations

import math
from enum import Enum

TICKS_PER_TURN = 4096  # 12-bit encoder
TICK_CENTRE = 2048
TICK_RAD = 2.0 * math.pi / TICKS_PER_TURN
AX_TICK_RAD = math.radians(300.0) / 1024.0  # AX-12A: 10-bit potentiometer over 300 degrees
VELOCITY_UNIT_RAD_PER_S = 0.229 * 2.0 * math.pi / 60.0  # 0.229 rev/min
ACCELERATION_UNIT_RAD_PER_S2 = 214.577 * 2.0 * math.pi / 3600.0  # 214.577 rev/min^2
PWM_UNIT_DUTY = 1.0 / 885.0  # printed as 0.113 %; 885 is full duty
LOAD_UNIT_DUTY = 0.001  # Present Load: 0.1 % of the servo's own estimate
VOLTAGE_UNIT_V = 0.1
WATCHDOG_UNIT_S = 0.020
RETURN_DELAY_UNIT_S = 2e-6
X_CURRENT_UNIT_MA = 2.69
MX_CURRENT_UNIT_MA = 3.36


class Unit(Enum):
    """What one count of a register means; the factors are the constants of this module."""

    NONE = "-"
    TICK = "tick"
    VELOCITY = "0.229 rev/min"
    ACCELERATION = "214.577 rev/min^2"
    PWM = "1/885 duty"
    CURRENT = "mA, per model"
    LOAD = "0.1 %"
    VOLTAGE = "0.1 V"
    CELSIUS = "degree C"
    RETURN_DELAY = "2 us"
    WATCHDOG = "20 ms"
    MILLISECOND = "ms"
    ADDRESS = "address"
