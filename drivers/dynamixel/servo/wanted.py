"""What the registers of a servo of an arm must hold: what setup writes, and what the driver sees to itself.

Computed from the arm's map alone.  `judge` compares it with what a servo holds.
"""

from __future__ import annotations

from drivers.dynamixel.arm_map import JointRole, ServoSlot
from drivers.dynamixel.servo.codes import BAUD_RATES, NO_SECONDARY_ID, DriveMode
from drivers.dynamixel.servo.table import (
    BAUD_RATE,
    CURRENT_LIMIT,
    DRIVE_MODE,
    FEEDFORWARD_1ST_GAIN,
    FEEDFORWARD_2ND_GAIN,
    GOAL_PWM,
    HOMING_OFFSET,
    ID,
    MAX_POSITION_LIMIT,
    MIN_POSITION_LIMIT,
    MOVING_THRESHOLD,
    OPERATING_MODE,
    POSITION_D_GAIN,
    POSITION_I_GAIN,
    POSITION_P_GAIN,
    PROFILE_ACCELERATION,
    PROFILE_VELOCITY,
    PWM_LIMIT,
    RETURN_DELAY_TIME,
    SECONDARY_ID,
    SHUTDOWN,
    STARTUP_CONFIGURATION,
    TEMPERATURE_LIMIT,
    Register,
)

_POSITION_CONTROL = (
    POSITION_D_GAIN, POSITION_I_GAIN, POSITION_P_GAIN, FEEDFORWARD_2ND_GAIN, FEEDFORWARD_1ST_GAIN,
    PROFILE_ACCELERATION, PROFILE_VELOCITY,
)  # fmt: skip
RAM_THAT_IS_KEPT = (GOAL_PWM, *_POSITION_CONTROL)


def run_values(slot: ServoSlot) -> dict[Register, int]:
    """EEPROM that the driver writes, where it differs, before torque comes on.

    Of what says how the arm is put together only the direction is in it, in one register with bits that are the
    driver's to clear; connect refuses a wrong direction, so it is written where it is right already.
    """
    reverse = DriveMode.REVERSE if slot.reverse else DriveMode(0)
    # torque on by goal update would make the zeroing of the goal switch the torque on
    return {RETURN_DELAY_TIME: 0, DRIVE_MODE: int(reverse), OPERATING_MODE: int(slot.joint.mode)}


def kept_ram(slot: ServoSlot) -> dict[Register, int | None]:
    """RAM beside its goals that decides what a servo makes of them, and outlives the program that wrote it.

    A change of mode sets all of it, but nobody changes a mode that is right.  None: the servo's PWM limit, for in every
    mode but its own Goal PWM bounds the voltage.  Position goals go by gains and profile; those of the factory are what
    `coop check` and the emulated servos hold a joint with.
    """
    values: dict[Register, int | None] = {GOAL_PWM: None} if slot.model.has_current_mode else {}
    if slot.joint.role is not JointRole.CONTROLLED:
        values |= {register: slot.model.default(register) for register in _POSITION_CONTROL}
    return values


def setup_values(slot: ServoSlot) -> dict[Register, int]:
    """EEPROM that makes a servo this one of an arm, but for ID and speed; factory limits included.

    The mode is the driver's business.  A shadow keeps its homing offset: it makes up for how its horn sits against its
    neighbour's.
    """
    low, high = slot.joint.position_limit_ticks
    factory = (PWM_LIMIT, CURRENT_LIMIT, TEMPERATURE_LIMIT, SHUTDOWN, STARTUP_CONFIGURATION)
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
