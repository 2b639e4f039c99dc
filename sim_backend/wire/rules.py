"""Which writes a servo refuses, and with which error code.

Pure functions of the register, the value and the servo's memory.
Source: ROBOTIS e-manual, Protocol 2.0 (error numbers) and the notes at each register.
"""

from __future__ import annotations

from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import WATCHDOG_TRIPPED, DriveMode, OperatingMode, StatusError
from drivers.dynamixel.servo.models import ServoModel
from drivers.dynamixel.servo.table import Access, Register
from sim_backend.wire.memory import RAM_START, Memory

GOALS = frozenset(
    register.name for register in (table.GOAL_PWM, table.GOAL_CURRENT, table.GOAL_VELOCITY, table.GOAL_POSITION)
)
_BIT_FIELDS = frozenset(register.name for register in (table.DRIVE_MODE, table.SHUTDOWN, table.STARTUP_CONFIGURATION))
# goal register -> the EEPROM register that bounds its magnitude
_BOUNDED_BY = {
    table.GOAL_PWM.name: table.PWM_LIMIT,
    table.GOAL_CURRENT.name: table.CURRENT_LIMIT,
    table.GOAL_VELOCITY.name: table.VELOCITY_LIMIT,
}
_TIME_PROFILE_FIRMWARE = 42
_TORQUE_BY_GOAL_FIRMWARE = 45


def refusal(
    model: ServoModel, firmware: int, memory: Memory, register: Register, value: int, *, secondary: bool
) -> StatusError:
    """Error of writing `value` to `register` now; NONE when it is allowed.

    `secondary` is true when the packet carried the servo's Secondary ID, through which EEPROM cannot be written.
    """
    if register.access is Access.READ or register.minimum is None or register.maximum is None:
        return StatusError.ACCESS
    if register.address < RAM_START and (secondary or memory.get(table.TORQUE_ENABLE)):
        return StatusError.ACCESS
    if register.name in GOALS or register.name == table.BUS_WATCHDOG.name:
        tripped = memory.has(table.BUS_WATCHDOG) and memory.get(table.BUS_WATCHDOG) == WATCHDOG_TRIPPED
        if tripped and (register.name in GOALS or value != 0):
            return StatusError.DATA_RANGE
    if not register.minimum <= value <= register.maximum or not _representable(model, firmware, register, value):
        return StatusError.DATA_RANGE
    return _limit(memory, register, value)


def _representable(model: ServoModel, firmware: int, register: Register, value: int) -> bool:
    """Whether a value inside the range is one the register knows: a mode of this model, no unknown bit."""
    if register.name == table.OPERATING_MODE.name:
        return value in {int(mode) for mode in model.modes}
    if register.name not in _BIT_FIELDS:
        return True
    allowed = register.maximum or 0
    if register.name == table.DRIVE_MODE.name:
        if firmware < _TIME_PROFILE_FIRMWARE:
            allowed &= ~DriveMode.TIME_BASED_PROFILE
        if firmware < _TORQUE_BY_GOAL_FIRMWARE:
            allowed &= ~DriveMode.TORQUE_ON_BY_GOAL_UPDATE
    return value & ~allowed == 0


def _limit(memory: Memory, register: Register, value: int) -> StatusError:
    """Goals against the limits set in EEPROM."""
    bound = _BOUNDED_BY.get(register.name)
    if bound is not None:
        return StatusError.DATA_LIMIT if abs(value) > memory.get(bound) else StatusError.NONE
    in_position_mode = memory.get(table.OPERATING_MODE) == OperatingMode.POSITION
    if register.name == table.GOAL_POSITION.name and in_position_mode:
        low, high = memory.get(table.MIN_POSITION_LIMIT), memory.get(table.MAX_POSITION_LIMIT)
        return StatusError.NONE if low <= value <= high else StatusError.DATA_LIMIT
    return StatusError.NONE
