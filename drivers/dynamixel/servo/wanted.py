"""What the EEPROM of a servo of an arm must hold: what setup writes, and what the driver sees to itself.

Computed from the arm's map alone.  `judge` compares it with what a servo holds.
"""

from __future__ import annotations

from drivers.dynamixel.arm_map import ServoSlot
from drivers.dynamixel.servo.codes import BAUD_RATES, NO_SECONDARY_ID, DriveMode
from drivers.dynamixel.servo.table import (
    BAUD_RATE,
    CURRENT_LIMIT,
    DRIVE_MODE,
    HOMING_OFFSET,
    ID,
    MAX_POSITION_LIMIT,
    MIN_POSITION_LIMIT,
    MOVING_THRESHOLD,
    OPERATING_MODE,
    PWM_LIMIT,
    RETURN_DELAY_TIME,
    SECONDARY_ID,
    SHUTDOWN,
    STARTUP_CONFIGURATION,
    Register,
)


def run_values(slot: ServoSlot) -> dict[Register, int]:
    """EEPROM that the driver writes, where it differs, before torque comes on.

    Of what says how the arm is put together only the direction is in it, in one register with bits that are the
    driver's to clear; connect refuses a wrong direction, so it is written where it is right already.
    """
    reverse = DriveMode.REVERSE if slot.reverse else DriveMode(0)
    # torque on by goal update would make the zeroing of the goal switch the torque on
    return {RETURN_DELAY_TIME: 0, DRIVE_MODE: int(reverse), OPERATING_MODE: int(slot.joint.mode)}


def setup_values(slot: ServoSlot) -> dict[Register, int]:
    """EEPROM that makes a servo this one of an arm, but for ID and speed; factory limits included.

    The mode is the driver's business.  A shadow keeps its homing offset: it makes up for how its horn sits against its
    neighbour's.
    """
    low, high = slot.joint.position_limit_ticks
    factory = (PWM_LIMIT, CURRENT_LIMIT, SHUTDOWN, STARTUP_CONFIGURATION)
    values: dict[Register, int | None] = {
        **{register: value for register, value in run_values(slot).items() if register is not OPERATING_MODE},
        SECONDARY_ID: slot.joint.ids[0] if slot.shadow else NO_SECONDARY_ID,
        HOMING_OFFSET: None if slot.shadow else 0,
        MIN_POSITION_LIMIT: low,
        MAX_POSITION_LIMIT: high,
        MOVING_THRESHOLD: slot.mark.own,  # says when the bit Moving is set, which nobody here reads
        **{register: slot.model.default(register) for register in factory},
    }
    return {r: value for r, value in values.items() if value is not None and r.name in slot.model.registers}


def line_values(slot: ServoSlot, baud: int) -> dict[Register, int]:
    """EEPROM by which a servo is found on its line; a bus at `baud` bit/s."""
    return {ID: slot.servo_id, BAUD_RATE: next(code for code, known in BAUD_RATES.items() if known == baud)}
