"""DYNAMIXEL servo models, their control table and the protocol's code numbers: one table for driver and emulator.

Data; it imports the standard library alone.

Source of every figure, unless a line says otherwise: the ROBOTIS e-manual as of 2026, pages Protocol 2.0, XM430-W350,
XM540-W270, XL430-W250, XC430-W150, MX-64(2.0), MX-28(2.0) and AX-12A.  Ratings are those at 12 V.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum, IntEnum, IntFlag
from types import MappingProxyType

# --- units: the "Unit" column of the control tables ------------------------------------------------------------------

TICKS_PER_TURN = 4096  # 12-bit encoder
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
RATED_VOLTAGE_V = 12.0

MAX_ID = 252
BROADCAST_ID = 0xFE
NO_SECONDARY_ID = 255  # 253 to 255 switch the shadow function off
WATCHDOG_TRIPPED = -1  # what Bus Watchdog reads after it fired; writing 0 clears it
TICK_CENTRE = 2048

# Baud Rate register (8) -> bit/s
BAUD_RATES: Mapping[int, int] = MappingProxyType(
    {0: 9_600, 1: 57_600, 2: 115_200, 3: 1_000_000, 4: 2_000_000, 5: 3_000_000, 6: 4_000_000, 7: 4_500_000}
)


# --- codes: pages Protocol 2.0, Operating Mode, Drive Mode, Shutdown, Hardware Error Status --------------------------


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


class Area(Enum):
    """Memory area of a register: EEPROM is writable only while Torque Enable is 0, RAM is lost on reboot."""

    EEPROM = "EEPROM"
    RAM = "RAM"


class Access(Enum):
    """What an instruction may do with a register."""

    READ = "R"
    READ_WRITE = "RW"


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


# --- control table, X-series and MX(2.0) -----------------------------------------------------------------------------


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

_ALL_REGISTERS = tuple(sorted(_declared, key=lambda register: register.address))


# --- servo models ----------------------------------------------------------------------------------------------------


# Part of its stall current that a servo bears for long.  ROBOTIS publish continuous ratings of the P and PRO series and
# none of X and MX; their staff advise 20 % of stall for continuous use (forum.robotis.com, thread 4220): an estimate.
CONTINUOUS_SHARE = 0.2


@dataclass(frozen=True, slots=True)
class ServoModel:
    """Ratings at 12 V and register table of one servo model.  Torques, speeds and constants are at the output shaft."""

    name: str
    model_number: int
    protocol: float
    gear_ratio: float
    stall_torque_Nm: float
    stall_current_A: float
    no_load_rpm: float
    mass_kg: float
    modes: frozenset[OperatingMode]
    # by e-manual name, in order of address; empty for Protocol 1.0
    registers: Mapping[str, Register] = field(repr=False, compare=False)
    current_unit_mA: float | None = None  # None: the servo senses no current
    fast_sync_min_firmware: int | None = None  # None: never answers fast sync read
    watchdog_min_firmware: int | None = 38  # None: no bus watchdog
    tick_rad: float = TICK_RAD

    def register(self, generic: Register) -> Register:
        """Return this model's version of a register; KeyError when the model does not have it."""
        return self.registers[generic.name]

    def default(self, generic: Register) -> int | None:
        """Return the factory value of a register; None when the model has no such register or no fixed value."""
        register = self.registers.get(generic.name)
        return None if register is None else register.default

    def answers_fast(self, firmware: int) -> bool:
        """Return whether this model with this firmware answers fast sync and fast bulk reads."""
        return self.fast_sync_min_firmware is not None and firmware >= self.fast_sync_min_firmware

    @property
    def has_current_mode(self) -> bool:
        """True when torque can be commanded as a current; otherwise only as a voltage, if at all."""
        return OperatingMode.CURRENT in self.modes

    @property
    def current_limit_lsb(self) -> int | None:
        """Factory Current Limit, also the largest that can be set; above the stall current on every model here."""
        return self.default(CURRENT_LIMIT)

    @property
    def no_load_rad_per_s(self) -> float:
        """No-load speed, rad/s."""
        return self.no_load_rpm * 2.0 * math.pi / 60.0

    @property
    def resistance_ohm(self) -> float:
        """Terminal resistance from the stall point: V / I_stall."""
        return RATED_VOLTAGE_V / self.stall_current_A

    @property
    def continuous_current_A(self) -> float:
        """What it bears for long, root mean square: an estimate, see CONTINUOUS_SHARE."""
        return CONTINUOUS_SHARE * self.stall_current_A

    @property
    def torque_constant_Nm_per_A(self) -> float:
        """Kt = stall torque / stall current; gearbox losses make the true constant before losses larger."""
        return self.stall_torque_Nm / self.stall_current_A

    @property
    def back_emf_V_s_per_rad(self) -> float:
        """Ke = V / no-load speed."""
        return RATED_VOLTAGE_V / self.no_load_rad_per_s

    @property
    def stall_torque_Nm_per_V(self) -> float:
        """Kt / R: torque per volt at standstill, the gain of PWM mode."""
        return self.torque_constant_Nm_per_A / self.resistance_ohm

    @property
    def back_emf_damping_Nm_s_per_rad(self) -> float:
        """Kt Ke / R: the torque that PWM mode loses per rad/s."""
        return self.stall_torque_Nm_per_V * self.back_emf_V_s_per_rad


_VOLTAGE_MODES = frozenset(
    {OperatingMode.VELOCITY, OperatingMode.POSITION, OperatingMode.EXTENDED_POSITION, OperatingMode.PWM}
)
_ALL_MODES = frozenset(OperatingMode)

_CURRENT_SENSE = (CURRENT_LIMIT, GOAL_CURRENT, PRESENT_CURRENT)
_EXTERNAL_PORTS = (*EXTERNAL_PORT_MODES, *EXTERNAL_PORT_DATA)
_NOT_X430 = (ACCELERATION_LIMIT, *_EXTERNAL_PORTS)
_NOT_MX = (STARTUP_CONFIGURATION, BACKUP_READY, *_EXTERNAL_PORTS)


def _control_table(absent: Iterable[Register], *changed: Register) -> Mapping[str, Register]:
    missing = {register.name for register in absent}
    versions = {register.name: register for register in changed}
    kept = (register for register in _ALL_REGISTERS if register.name not in missing)
    return MappingProxyType({register.name: versions.get(register.name, register) for register in kept})


def _voltage(low: int, high: int) -> tuple[Register, Register]:
    return (
        replace(MAX_VOLTAGE_LIMIT, minimum=low, maximum=high, default=high),
        replace(MIN_VOLTAGE_LIMIT, minimum=low, maximum=high, default=low),
    )


def _current(largest: int) -> tuple[Register, Register]:
    return (
        replace(CURRENT_LIMIT, maximum=largest, default=largest),
        replace(GOAL_CURRENT, minimum=-largest, maximum=largest),
    )


_MODELS = (
    ServoModel(
        "XM430-W350", 1020, 2.0, 353.5, 4.1, 2.3, 46.0, 0.082, _ALL_MODES,
        _control_table((*_NOT_X430, PRESENT_LOAD)),
        current_unit_mA=X_CURRENT_UNIT_MA, fast_sync_min_firmware=45,
    ),
    ServoModel(
        "XM540-W270", 1120, 2.0, 272.5, 10.6, 4.4, 30.0, 0.165, _ALL_MODES,
        _control_table(
            (ACCELERATION_LIMIT, PRESENT_LOAD), *_current(2047),
            replace(DRIVE_MODE, maximum=15), replace(VELOCITY_LIMIT, default=128),
        ),
        current_unit_mA=X_CURRENT_UNIT_MA, fast_sync_min_firmware=45,
    ),
    ServoModel(
        "XL430-W250", 1060, 2.0, 258.5, 1.5, 1.4, 61.0, 0.0572, _VOLTAGE_MODES,
        _control_table(
            (*_NOT_X430, *_CURRENT_SENSE), *_voltage(60, 140),
            replace(TEMPERATURE_LIMIT, default=72), replace(VELOCITY_LIMIT, default=265),
            replace(VELOCITY_I_GAIN, default=1000),
            replace(POSITION_P_GAIN, default=640), replace(POSITION_D_GAIN, default=4000),
        ),
        fast_sync_min_firmware=45,
    ),
    ServoModel(
        "XC430-W150", 1070, 2.0, 159.59, 1.6, 1.4, 106.0, 0.065, _VOLTAGE_MODES,
        _control_table(
            (*_NOT_X430, *_CURRENT_SENSE), *_voltage(60, 160),
            replace(MOVING_THRESHOLD, default=20), replace(VELOCITY_LIMIT, default=460),
            replace(POSITION_P_GAIN, default=460),
        ),
        fast_sync_min_firmware=45,
    ),
    ServoModel(  # 126 g in plastic (MX-64T/R), 135 g with metal front (AT/AR)
        "MX-64", 311, 2.0, 200.0, 6.0, 4.1, 63.0, 0.126, _ALL_MODES,
        _control_table(
            (*_NOT_MX, PRESENT_LOAD), *_current(1941),
            replace(DRIVE_MODE, maximum=5), replace(VELOCITY_LIMIT, default=285),
            replace(POSITION_P_GAIN, default=850),
        ),
        current_unit_mA=MX_CURRENT_UNIT_MA,
    ),
    ServoModel(  # 72 g in plastic (MX-28T/R), 77 g with metal front (AT/AR)
        "MX-28", 30, 2.0, 193.0, 2.5, 1.4, 55.0, 0.072, _VOLTAGE_MODES,
        _control_table(
            (*_NOT_MX, *_CURRENT_SENSE),
            replace(DRIVE_MODE, maximum=5), replace(VELOCITY_LIMIT, default=230),
            replace(POSITION_P_GAIN, default=850),
        ),
    ),
    ServoModel(  # Protocol 1.0 for ever: no table, no mode of this stack
        "AX-12A", 12, 1.0, 254.0, 1.5, 1.5, 59.0, 0.0546, frozenset(), MappingProxyType({}),
        watchdog_min_firmware=None, tick_rad=AX_TICK_RAD,
    ),
)  # fmt: skip

SERVOS: Mapping[str, ServoModel] = MappingProxyType({model.name: model for model in _MODELS})
SERVOS_BY_NUMBER: Mapping[int, ServoModel] = MappingProxyType({model.model_number: model for model in _MODELS})
