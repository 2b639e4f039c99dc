"""Registers of one servo's EEPROM: read, compare, write what differs, read back; refused while torque is on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from drivers.dynamixel.errors import NoReplyError, RejectedError
from drivers.dynamixel.line.bus import Bus
from drivers.dynamixel.servo.codes import BAUD_RATES, StatusError
from drivers.dynamixel.servo.found import RegisterChange
from drivers.dynamixel.servo.models import ServoModel
from drivers.dynamixel.servo.table import (
    BAUD_RATE,
    ID,
    MAX_POSITION_LIMIT,
    MAX_VOLTAGE_LIMIT,
    MIN_POSITION_LIMIT,
    MIN_VOLTAGE_LIMIT,
    TORQUE_ENABLE,
    Access,
    Area,
    Register,
)
from drivers.interface import DriverError

_LOWER_AND_UPPER = ((MIN_VOLTAGE_LIMIT, MAX_VOLTAGE_LIMIT), (MIN_POSITION_LIMIT, MAX_POSITION_LIMIT))


class EepromError(DriverError):
    """A servo whose EEPROM cannot be written, or that did not keep what was written."""


def writable(model: ServoModel) -> tuple[Register, ...]:
    """EEPROM registers of a model that can be written, in order of address."""
    return tuple(r for r in model.registers.values() if r.area is Area.EEPROM and r.access is Access.READ_WRITE)


def read(bus: Bus, servo_id: int, registers: Sequence[Register]) -> dict[str, int]:
    """Values by register name; registers that this servo's firmware does not have are left out.

    Raises NoReplyError, RejectedError.
    """
    values = {}
    for register in registers:
        try:
            values[register.name] = bus.read(servo_id, register)
        except RejectedError as error:
            if error.code != StatusError.ACCESS:
                raise
    return values


def differences(
    servo_id: int, model: ServoModel, found: Mapping[str, int], wanted: Mapping[str, int]
) -> list[RegisterChange]:
    """Registers that are there and not as wanted, in the order in which they can be written."""
    changes = [
        RegisterChange(servo_id, model.registers[name], found[name], value)
        for name, value in wanted.items()
        if name in found and found[name] != value
    ]
    return _in_order(changes)


def _in_order(changes: list[RegisterChange]) -> list[RegisterChange]:
    """Order of addresses, but never a lower limit above its upper one on the way; ID and baud rate last."""
    last = {ID.name: 1, BAUD_RATE.name: 2}
    ordered = sorted(changes, key=lambda c: (last.get(c.register.name, 0), c.register.address))
    names = [change.register.name for change in ordered]
    for lower, upper in _LOWER_AND_UPPER:
        if lower.name in names and upper.name in names:
            low, high = names.index(lower.name), names.index(upper.name)
            lower_first = ordered[low].wanted < ordered[low].found
            if lower_first != (low < high):
                ordered[low], ordered[high] = ordered[high], ordered[low]
                names[low], names[high] = names[high], names[low]
    return ordered


def require_torque_off(bus: Bus, servo_id: int) -> None:
    """Raise EepromError while the servo holds torque: it would refuse the write, and something may hang on it."""
    if bus.read(servo_id, TORQUE_ENABLE):
        raise EepromError(
            f"servo {servo_id}: torque",
            found="on",
            expected="off, or its EEPROM cannot be written",
            remedy="stop the program that holds this arm, support the arm, then switch its supply off and on",
        )


def write(bus: Bus, changes: Sequence[RegisterChange]) -> None:
    """Write one servo's differences in their order and read each one back.

    A new ID or baud rate is followed, so the rest of the line must be silent at the new speed too.
    Raises EepromError, NoReplyError, RejectedError; what was written by then stays written.
    """
    if not changes:
        return
    servo_id = changes[0].servo_id
    require_torque_off(bus, servo_id)
    for change in changes:
        if change.register.name in (ID.name, BAUD_RATE.name):
            servo_id = _move(bus, servo_id, change)
        else:
            bus.write(servo_id, change.register, change.wanted)
        value = bus.read(servo_id, change.register)
        if value != change.wanted:
            raise EepromError(
                f"servo {servo_id}: {change.register.name}",
                found=f"{value} after writing",
                expected=change.wanted,
                remedy="try again; if it persists the servo's EEPROM is worn or its firmware does not know the value",
            )


def _move(bus: Bus, servo_id: int, change: RegisterChange) -> int:
    """Change ID or baud rate.  The answer may come in the old or the new way, so the proof is who answers after it."""
    try:
        bus.write(servo_id, change.register, change.wanted)
    except NoReplyError:
        bus.settle()
    if change.register.name == ID.name:
        return change.wanted
    bus.port.set_baud(BAUD_RATES[change.wanted])
    bus.settle()
    return servo_id
