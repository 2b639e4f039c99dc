"""The numbers with a meaning in packets and registers: instructions, errors, modes, bits, baud rates, reserved IDs.

Source: the ROBOTIS e-manual as of 2026, page Protocol 2.0 and, on the pages of the models, Operating Mode, Drive Mode,
Shutdown and Hardware Error Status.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum, IntFlag
from types import MappingProxyType

MAX_ID = 252
BROADCAST_ID = 0xFE
NO_SECONDARY_ID = 255  # 253 to 255 switch the shadow function off
WATCHDOG_TRIPPED = -1  # what Bus Watchdog reads after it fired; writing 0 clears it

# Baud Rate register (8) -> bit/s
BAUD_RATES: Mapping[int, int] = MappingProxyType(
    {0: 9_600, 1: 57_600, 2: 115_200, 3: 1_000_000, 4: 2_000_000, 5: 3_000_000, 6: 4_000_000, 7: 4_500_000}
)


class Instruction(IntEnum):
    """Instruction byte of a Protocol 2.0 packet."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    FACTORY_RESET = 0x06
    REBOOT = 0x08
    CLEAR = 0x10
    CONTROL_TABLE_BACKUP = 0x20
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    FAST_SYNC_READ = 0x8A
    BULK_READ = 0x92
    BULK_WRITE = 0x93
    FAST_BULK_READ = 0x9A


class StatusError(IntEnum):
    """Low seven bits of the error byte of a status packet."""

    NONE = 0
    RESULT_FAIL = 1
    INSTRUCTION = 2
    CRC = 3
    DATA_RANGE = 4
    DATA_LENGTH = 5
    DATA_LIMIT = 6
    ACCESS = 7


ALERT_BIT = 0x80  # top bit of the same byte: Hardware Error Status (70) is not zero


class OperatingMode(IntEnum):
    """Operating Mode register (11).  Changing it resets goals, gains and profile to that mode's defaults."""

    CURRENT = 0
    VELOCITY = 1
    POSITION = 3
    EXTENDED_POSITION = 4
    CURRENT_BASED_POSITION = 5
    PWM = 16


class DriveMode(IntFlag):
    """Bits of the Drive Mode register (10)."""

    REVERSE = 0x01
    SLAVE = 0x02  # X540 and MX-106 only
    TIME_BASED_PROFILE = 0x04  # firmware 42
    TORQUE_ON_BY_GOAL_UPDATE = 0x08  # firmware 45, X-series only


class StartupConfiguration(IntFlag):
    """Bits of the Startup Configuration register (60): what a servo does when power comes."""

    TORQUE_ON = 0x01
    RAM_RESTORE = 0x02  # the RAM that is in its backup, if it has one


class HardwareError(IntFlag):
    """Bits of Hardware Error Status (70); the same bits in Shutdown (63) turn the torque off.  Only REBOOT clears."""

    INPUT_VOLTAGE = 0x01
    OVERHEATING = 0x04
    ENCODER = 0x08
    ELECTRICAL_SHOCK = 0x10
    OVERLOAD = 0x20


SHUTDOWN_DEFAULT = HardwareError.OVERLOAD | HardwareError.ELECTRICAL_SHOCK | HardwareError.OVERHEATING
