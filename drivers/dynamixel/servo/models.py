"""The servo models: their ratings at 12 V, the motor constants that follow from them, and the registers each has.

Source of every figure, unless a line says otherwise: the ROBOTIS e-manual as of 2026, pages XM430-W350, XM540-W270,
XL430-W250, XC430-W150, MX-64(2.0), MX-28(2.0) and AX-12A.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from drivers.dynamixel.servo.codes import OperatingMode
from drivers.dynamixel.servo.counts import AX_TICK_RAD, MX_CURRENT_UNIT_MA, TICK_RAD, X_CURRENT_UNIT_MA, Unit
from drivers.dynamixel.servo.table import (
    ACCELERATION_LIMIT,
    BACKUP_READY,
    CURRENT_LIMIT,
    DRIVE_MODE,
    EXTERNAL_PORT_DATA,
    EXTERNAL_PORT_MODES,
    GOAL_CURRENT,
    MAX_VOLTAGE_LIMIT,
    MIN_VOLTAGE_LIMIT,
    MOVING_THRESHOLD,
    POSITION_D_GAIN,
    POSITION_P_GAIN,
    PRESENT_CURRENT,
    PRESENT_LOAD,
    REGISTERS,
    STARTUP_CONFIGURATION,
    TEMPERATURE_LIMIT,
    VELOCITY_I_GAIN,
    VELOCITY_LIMIT,
    Register,
)

RATED_VOLTAGE_V = 12.0

# Part of its stall current that a servo bears for long.  ROBOTIS publish continuous ratings of the P and PRO series and
# none of X and MX; their staff advise 20 % of stall for continuous use (forum.robotis.com, thread 4220): an estimate.
CONTINUOUS_SHARE = 0.2

# Part of it at which one that holds a position or grips calls its load an overload and lets go: below the 41 % at
# which owners report it after 5 s (DynamixelSDK issue 285).
OVERLOAD_SHARE = 0.4


@dataclass(frozen=True, slots=True)
class ServoModel:
    """Ratings at 12 V and register table of one servo model.  Torques, speeds and constants are at the output shaft."""

    name: str
    model_number: int
    protocol: float
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

    def share_count(self, generic: Register, share: float) -> int:
        """Return the count of a current or a voltage at which a standing servo gives this share of its stall torque.

        Of a voltage that is this share of the largest count; the largest current is beyond that of the stall.
        """
        if self.register(generic).unit is Unit.CURRENT:
            assert self.current_unit_mA is not None
            return round(share * 1e3 * self.stall_current_A / self.current_unit_mA)
        return round(share * (self.register(generic).maximum or 0))

    def answers_fast(self, firmware: int) -> bool:
        """Return whether this model with this firmware answers fast sync and fast bulk reads."""
        return self.fast_sync_min_firmware is not None and firmware >= self.fast_sync_min_firmware

    @property
    def has_current_mode(self) -> bool:
        """True when torque can be commanded as a current; otherwise only as a voltage, if at all."""
        return OperatingMode.CURRENT in self.modes

    @property
    def no_load_rad_per_s(self) -> float:
        """No-load speed, rad/s."""
        return self.no_load_rpm * 2.0 * math.pi / 60.0

    @property
    def resistance_ohm(self) -> float:
        """Terminal resistance from the stall point: V / I_stall."""
        return RATED_VOLTAGE_V / self.stall_current_A

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
    kept = (register for register in REGISTERS if register.name not in missing)
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
        "XM430-W350", 1020, 2.0, 4.1, 2.3, 46.0, 0.082, _ALL_MODES,
        _control_table((*_NOT_X430, PRESENT_LOAD)),
        current_unit_mA=X_CURRENT_UNIT_MA, fast_sync_min_firmware=45,
    ),
    ServoModel(
        "XM540-W270", 1120, 2.0, 10.6, 4.4, 30.0, 0.165, _ALL_MODES,
        _control_table(
            (ACCELERATION_LIMIT, PRESENT_LOAD), *_current(2047),
            replace(DRIVE_MODE, maximum=15), replace(VELOCITY_LIMIT, default=128),
        ),
        current_unit_mA=X_CURRENT_UNIT_MA, fast_sync_min_firmware=45,
    ),
    ServoModel(
        "XL430-W250", 1060, 2.0, 1.5, 1.4, 61.0, 0.0572, _VOLTAGE_MODES,
        _control_table(
            (*_NOT_X430, *_CURRENT_SENSE), *_voltage(60, 140),
            replace(TEMPERATURE_LIMIT, default=72), replace(VELOCITY_LIMIT, default=265),
            replace(VELOCITY_I_GAIN, default=1000),
            replace(POSITION_P_GAIN, default=640), replace(POSITION_D_GAIN, default=4000),
        ),
        fast_sync_min_firmware=45,
    ),
    ServoModel(
        "XC430-W150", 1070, 2.0, 1.6, 1.4, 106.0, 0.065, _VOLTAGE_MODES,
        _control_table(
            (*_NOT_X430, *_CURRENT_SENSE), *_voltage(60, 160),
            replace(MOVING_THRESHOLD, default=20), replace(VELOCITY_LIMIT, default=460),
            replace(POSITION_P_GAIN, default=460),
        ),
        fast_sync_min_firmware=45,
    ),
    ServoModel(  # 126 g in plastic (MX-64T/R), 135 g with metal front (AT/AR)
        "MX-64", 311, 2.0, 6.0, 4.1, 63.0, 0.126, _ALL_MODES,
        _control_table(
            (*_NOT_MX, PRESENT_LOAD), *_current(1941),
            replace(DRIVE_MODE, maximum=5), replace(VELOCITY_LIMIT, default=285),
            replace(POSITION_P_GAIN, default=850),
        ),
        current_unit_mA=MX_CURRENT_UNIT_MA,
    ),
    ServoModel(  # 72 g in plastic (MX-28T/R), 77 g with metal front (AT/AR)
        "MX-28", 30, 2.0, 2.5, 1.4, 55.0, 0.072, _VOLTAGE_MODES,
        _control_table(
            (*_NOT_MX, *_CURRENT_SENSE),
            replace(DRIVE_MODE, maximum=5), replace(VELOCITY_LIMIT, default=230),
            replace(POSITION_P_GAIN, default=850),
        ),
    ),
    ServoModel(  # Protocol 1.0 for ever: no table, no mode of this stack
        "AX-12A", 12, 1.0, 1.5, 1.5, 59.0, 0.0546, frozenset(), MappingProxyType({}),
        watchdog_min_firmware=None, tick_rad=AX_TICK_RAD,
    ),
)  # fmt: skip

SERVOS: Mapping[str, ServoModel] = MappingProxyType({model.name: model for model in _MODELS})
SERVOS_BY_NUMBER: Mapping[int, ServoModel] = MappingProxyType({model.model_number: model for model in _MODELS})
