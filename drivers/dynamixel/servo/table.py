"""The control table of X-series and MX(2.0) servos, register by register: one table for driver and emulator.

Source of every figure, unless a line says otherwise: the ROBOTIS e-manual as of 2026.  Ranges and defaults are those of
the XM430-W350 where it has the register; which models have which registers, and what differs there, is in models.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType

from drivers.dynamixel.servo.codes import MAX_ID, NO_SECONDARY_ID, SHUTDOWN_DEFAULT
from drivers.dynamixel.servo.counts import Unit


class Area(Enum):
    """Memory area of a register: EEPROM is writable only while Torque Enable is 0, RAM is lost on reboot."""

    EEPROM = "EEPROM"
    RAM = "RAM"


class Access(Enum):
    """What an instruction may do with a register."""

    READ = "R"
    READ_WRITE = "RW"


@dataclass(frozen=True, slots=True)
class Register:
    """One entry of the control table, little-endian; `minimum` and `maximum` bound what may be written."""

    address: int
    length: int  # bytes
    name: str  # the e-manual's data name
    access: Access
    unit: Unit
    signed: bool
    minimum: int | None  # None: read-only
    maximum: int | None
    default: int | None  # None: the e-manual gives none (it depends on the mode or on the state)

    @property
    def area(self) -> Area:
        """EEPROM below address 64, RAM from there on."""
        return Area.EEPROM if self.address < 64 else Area.RAM


_declared: list[Register] = []


def _ro(address: int, length: int, name: str, unit: Unit = Unit.NONE, default: int | None = None) -> Register:
    signed = unit in (Unit.TICK, Unit.VELOCITY, Unit.PWM, Unit.CURRENT, Unit.LOAD)
    register = Register(address, length, name, Access.READ, unit, signed, None, None, default)
    _declared.append(register)
    return register


def _rw(
    address: int, length: int, name: str, low: int, high: int, default: int | None = None, unit: Unit = Unit.NONE
) -> Register:
    signed = low < 0 or unit is Unit.WATCHDOG  # the watchdog reads -1 when it fired
    register = Register(address, length, name, Access.READ_WRITE, unit, signed, low, high, default)
    _declared.append(register)
    return register


_GAIN_MAX = 16383
_EXTENDED_MAX = 1_048_575

MODEL_NUMBER = _ro(0, 2, "Model Number")
MODEL_INFORMATION = _ro(2, 4, "Model Information")
FIRMWARE_VERSION = _ro(6, 1, "Firmware Version")
ID = _rw(7, 1, "ID", 0, MAX_ID, 1)
BAUD_RATE = _rw(8, 1, "Baud Rate", 0, 7, 1)
RETURN_DELAY_TIME = _rw(9, 1, "Return Delay Time", 0, 254, 250, Unit.RETURN_DELAY)
DRIVE_MODE = _rw(10, 1, "Drive Mode", 0, 13, 0)
OPERATING_MODE = _rw(11, 1, "Operating Mode", 0, 16, 3)
SECONDARY_ID = _rw(12, 1, "Secondary(Shadow) ID", 0, 255, NO_SECONDARY_ID)
PROTOCOL_TYPE = _rw(13, 1, "Protocol Type", 1, 2, 2)
HOMING_OFFSET = _rw(20, 4, "Homing Offset", -1_044_479, 1_044_479, 0, Unit.TICK)
MOVING_THRESHOLD = _rw(24, 4, "Moving Threshold", 0, 1023, 10, Unit.VELOCITY)
TEMPERATURE_LIMIT = _rw(31, 1, "Temperature Limit", 0, 100, 80, Unit.CELSIUS)
MAX_VOLTAGE_LIMIT = _rw(32, 2, "Max Voltage Limit", 95, 160, 160, Unit.VOLTAGE)
MIN_VOLTAGE_LIMIT = _rw(34, 2, "Min Voltage Limit", 95, 160, 95, Unit.VOLTAGE)
PWM_LIMIT = _rw(36, 2, "PWM Limit", 0, 885, 885, Unit.PWM)
CURRENT_LIMIT = _rw(38, 2, "Current Limit", 0, 1193, 1193, Unit.CURRENT)
ACCELERATION_LIMIT = _rw(40, 4, "Acceleration Limit", 0, 32767, 32767, Unit.ACCELERATION)
VELOCITY_LIMIT = _rw(44, 4, "Velocity Limit", 0, 1023, 200, Unit.VELOCITY)
MAX_POSITION_LIMIT = _rw(48, 4, "Max Position Limit", 0, 4095, 4095, Unit.TICK)
MIN_POSITION_LIMIT = _rw(52, 4, "Min Position Limit", 0, 4095, 0, Unit.TICK)
EXTERNAL_PORT_MODES = tuple(_rw(55 + n, 1, f"External Port Mode {n}", 0, 3, 0) for n in (1, 2, 3))
STARTUP_CONFIGURATION = _rw(60, 1, "Startup Configuration", 0, 3, 0)
SHUTDOWN = _rw(63, 1, "Shutdown", 0, 0x3D, int(SHUTDOWN_DEFAULT))
TORQUE_ENABLE = _rw(64, 1, "Torque Enable", 0, 1, 0)
LED = _rw(65, 1, "LED", 0, 1, 0)
STATUS_RETURN_LEVEL = _rw(68, 1, "Status Return Level", 0, 2, 2)
REGISTERED_INSTRUCTION = _ro(69, 1, "Registered Instruction", default=0)
HARDWARE_ERROR_STATUS = _ro(70, 1, "Hardware Error Status", default=0)
VELOCITY_I_GAIN = _rw(76, 2, "Velocity I Gain", 0, _GAIN_MAX, 1920)
VELOCITY_P_GAIN = _rw(78, 2, "Velocity P Gain", 0, _GAIN_MAX, 100)
POSITION_D_GAIN = _rw(80, 2, "Position D Gain", 0, _GAIN_MAX, 0)
POSITION_I_GAIN = _rw(82, 2, "Position I Gain", 0, _GAIN_MAX, 0)
POSITION_P_GAIN = _rw(84, 2, "Position P Gain", 0, _GAIN_MAX, 800)
FEEDFORWARD_2ND_GAIN = _rw(88, 2, "Feedforward 2nd Gain", 0, _GAIN_MAX, 0)
FEEDFORWARD_1ST_GAIN = _rw(90, 2, "Feedforward 1st Gain", 0, _GAIN_MAX, 0)
BUS_WATCHDOG = _rw(98, 1, "Bus Watchdog", 0, 127, 0, Unit.WATCHDOG)
GOAL_PWM = _rw(100, 2, "Goal PWM", -885, 885, unit=Unit.PWM)
GOAL_CURRENT = _rw(102, 2, "Goal Current", -1193, 1193, unit=Unit.CURRENT)
GOAL_VELOCITY = _rw(104, 4, "Goal Velocity", -1023, 1023, unit=Unit.VELOCITY)
PROFILE_ACCELERATION = _rw(108, 4, "Profile Acceleration", 0, 32767, 0, Unit.ACCELERATION)
PROFILE_VELOCITY = _rw(112, 4, "Profile Velocity", 0, 32767, 0, Unit.VELOCITY)
# the range of extended position mode; in position mode Min and Max Position Limit bound it
GOAL_POSITION = _rw(116, 4, "Goal Position", -_EXTENDED_MAX, _EXTENDED_MAX, unit=Unit.TICK)
REALTIME_TICK = _ro(120, 2, "Realtime Tick", Unit.MILLISECOND)  # wraps after 32767
MOVING = _ro(122, 1, "Moving", default=0)
MOVING_STATUS = _ro(123, 1, "Moving Status", default=0)
PRESENT_PWM = _ro(124, 2, "Present PWM", Unit.PWM)
PRESENT_CURRENT = _ro(126, 2, "Present Current", Unit.CURRENT)
PRESENT_LOAD = _ro(126, 2, "Present Load", Unit.LOAD)  # takes the place of Present Current where there is no sensor
PRESENT_VELOCITY = _ro(128, 4, "Present Velocity", Unit.VELOCITY)
PRESENT_POSITION = _ro(132, 4, "Present Position", Unit.TICK)
VELOCITY_TRAJECTORY = _ro(136, 4, "Velocity Trajectory", Unit.VELOCITY)
POSITION_TRAJECTORY = _ro(140, 4, "Position Trajectory", Unit.TICK)
PRESENT_INPUT_VOLTAGE = _ro(144, 2, "Present Input Voltage", Unit.VOLTAGE)
PRESENT_TEMPERATURE = _ro(146, 1, "Present Temperature", Unit.CELSIUS)
BACKUP_READY = _ro(147, 1, "Backup Ready")  # firmware 45
EXTERNAL_PORT_DATA = tuple(_rw(150 + 2 * n, 2, f"External Port Data {n}", 0, 4095) for n in (1, 2, 3))

# registers that came with a firmware: absent on older ones
SINCE_FIRMWARE: Mapping[str, int] = MappingProxyType({STARTUP_CONFIGURATION.name: 45, BACKUP_READY.name: 45})

# Indirect n is element n - 1; 1 to 28 and 29 to 56 lie in two blocks, and only addresses 64 to 661 can be mapped.
INDIRECT_DATA = tuple(_rw((223 if n <= 28 else 605) + n, 1, f"Indirect Data {n}", 0, 255, 0) for n in range(1, 57))
INDIRECT_ADDRESSES = tuple(
    _rw(
        (166 if n <= 28 else 520) + 2 * n,
        2,
        f"Indirect Address {n}",
        64,
        661,
        INDIRECT_DATA[n - 1].address,
        Unit.ADDRESS,
    )
    for n in range(1, 57)
)

REGISTERS = tuple(sorted(_declared, key=lambda register: register.address))  # of all models together
