"""What a servo's EEPROM must hold to be one of an arm's servos, and how grave each difference is.  Asks no bus."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from agent.config.schema.cell import ArmFile
from agent.config.servo_map import resting_joints
from agent.verify.finding import Verdict
from drivers.dynamixel.arm_map import JointRole, ServoSlot
from drivers.dynamixel.servo.table import (
    BAUD_RATE,
    BAUD_RATES,
    CURRENT_LIMIT,
    DRIVE_MODE,
    HOMING_OFFSET,
    ID,
    MAX_POSITION_LIMIT,
    MIN_POSITION_LIMIT,
    NO_SECONDARY_ID,
    PWM_LIMIT,
    RETURN_DELAY_TIME,
    SECONDARY_ID,
    SHUTDOWN,
    STARTUP_CONFIGURATION,
    DriveMode,
    OperatingMode,
    Register,
)
from drivers.dynamixel.servo.torque import CurrentDrive
from drivers.interface import Refusal

SECONDARY_OFF = 253  # and above
TORQUE_AT_STARTUP = 0x01  # bit of Startup Configuration
SETUP = "`coop motors setup` on this servo alone"
_BY_AGENT = (RETURN_DELAY_TIME,)


class JointError(Refusal):
    """The arm file has no such servo."""


@dataclass(frozen=True, slots=True)
class Misfit:
    """One EEPROM register that is not as the arm needs it."""

    register: Register
    found: str
    wanted: str
    verdict: Verdict
    remedy: str


def servo_of(file: ArmFile, joint: str, *, shadow: bool) -> ServoSlot:
    """The servo of a joint, or its shadow.  Raises JointError naming what there is."""
    joints = {j.name: j for j in resting_joints(file)}
    if joint not in joints:
        raise JointError(
            f"joint of {file.model}", found=repr(joint), expected=" or ".join(joints), remedy="name one of its joints"
        )
    found = joints[joint]
    if shadow and len(found.ids) == 1:
        pairs = [j.name for j in joints.values() if len(j.ids) > 1]
        raise JointError(
            f"joint {joint} of {file.model}",
            found="a single servo",
            expected="one with a shadow: " + (" or ".join(pairs) or "none on this arm"),
            remedy="leave --shadow out",
        )
    place = int(shadow)
    return ServoSlot(found.ids[place], found, shadow, found.reverse[place])


def eeprom_of(slot: ServoSlot, baud: int) -> dict[str, int]:
    """Register values by name that set this servo up, factory limits included; the rest is left as it is.

    A shadow keeps its homing offset: it makes up for how its horn sits against its neighbour's.
    """
    model = slot.model
    low, high = slot.joint.position_limit_ticks
    values: dict[Register, int | None] = {
        ID: slot.servo_id,
        BAUD_RATE: next(code for code, known in BAUD_RATES.items() if known == baud),
        RETURN_DELAY_TIME: 0,
        DRIVE_MODE: int(DriveMode.REVERSE) if slot.reverse else 0,
        SECONDARY_ID: slot.joint.ids[0] if slot.shadow else NO_SECONDARY_ID,
        HOMING_OFFSET: None if slot.shadow else 0,
        MIN_POSITION_LIMIT: low,
        MAX_POSITION_LIMIT: high,
        PWM_LIMIT: model.default(PWM_LIMIT),
        CURRENT_LIMIT: model.default(CURRENT_LIMIT),
        SHUTDOWN: model.default(SHUTDOWN),
        STARTUP_CONFIGURATION: model.default(STARTUP_CONFIGURATION),
    }
    return {r.name: value for r, value in values.items() if value is not None and r.name in model.registers}


def misfits(slot: ServoSlot, found: Mapping[str, int]) -> list[Misfit]:
    """What is not as the arm needs it, in a servo that answers at its own ID and speed; `found`: by register name.

    A problem is what the driver refuses; a warning what it puts right by itself, or what only costs performance.
    """
    return [*_assembly(slot, found), *_startup(found), *_effort(slot, found), *_plain(slot, found)]


def _assembly(slot: ServoSlot, found: Mapping[str, int]) -> list[Misfit]:
    """What says how the arm is put together: never written without a person's decision."""
    out = []
    mode, secondary = found.get(DRIVE_MODE.name, 0), found.get(SECONDARY_ID.name, NO_SECONDARY_ID)
    leader = slot.joint.ids[0] if slot.shadow else NO_SECONDARY_ID
    if bool(mode & DriveMode.REVERSE) != slot.reverse:
        wanted = f"bit 0 {'set: reverse' if slot.reverse else 'clear: normal direction'}"
        remedy = f"check how the servo is mounted, then {SETUP}"
        out.append(Misfit(DRIVE_MODE, str(mode), wanted, Verdict.REFUSED, remedy))
    if min(secondary, SECONDARY_OFF) != min(leader, SECONDARY_OFF):
        out.append(Misfit(SECONDARY_ID, str(secondary), str(leader), Verdict.REFUSED, SETUP))
    offset = found.get(HOMING_OFFSET.name, 0)
    if offset and not slot.shadow:
        remedy = f"{SETUP}: with an offset some firmware moves when its watchdog fires"
        out.append(Misfit(HOMING_OFFSET, str(offset), "0", Verdict.REFUSED, remedy))
    return out


def _startup(found: Mapping[str, int]) -> list[Misfit]:
    value = found.get(STARTUP_CONFIGURATION.name, 0)
    if not value:
        return []
    verdict = Verdict.REFUSED if value & TORQUE_AT_STARTUP else Verdict.WARNING
    remedy = f"{SETUP}: it makes the servo do something by itself when its supply comes on"
    return [Misfit(STARTUP_CONFIGURATION, str(value), "0", verdict, remedy)]


def _effort(slot: ServoSlot, found: Mapping[str, int]) -> list[Misfit]:
    """Limits that are lower than the largest torque of a controlled joint takes."""
    if slot.joint.role is not JointRole.CONTROLLED or slot.shadow:
        return []
    if slot.joint.mode is OperatingMode.CURRENT:
        needed, value = CurrentDrive(slot.joint).needed_count, found.get(CURRENT_LIMIT.name, 0)
        remedy = f"{SETUP}, or lower safety.tau_max_fraction_of_stall"
        if value < needed:
            return [Misfit(CURRENT_LIMIT, str(value), f"at least {needed}", Verdict.REFUSED, remedy)]
        return []
    full, value = slot.model.default(PWM_LIMIT) or 0, found.get(PWM_LIMIT.name, 0)
    return [] if value >= full else [Misfit(PWM_LIMIT, str(value), str(full), Verdict.WARNING, SETUP)]


def _plain(slot: ServoSlot, found: Mapping[str, int]) -> list[Misfit]:
    """What the agent sets by itself, and what the arm file says for position modes."""
    wanted = eeprom_of(slot, next(iter(BAUD_RATES.values())))
    out = []
    for register in (RETURN_DELAY_TIME, MIN_POSITION_LIMIT, MAX_POSITION_LIMIT, SHUTDOWN):
        value = found.get(register.name, wanted[register.name])
        if value != wanted[register.name]:
            remedy = f"the agent sets it before torque comes on, or {SETUP}" if register in _BY_AGENT else SETUP
            out.append(Misfit(register, str(value), str(wanted[register.name]), Verdict.WARNING, remedy))
    bits = found.get(DRIVE_MODE.name, 0) & ~DriveMode.REVERSE
    if bits:
        remedy = f"the agent clears them before torque comes on, or {SETUP}"
        out.append(Misfit(DRIVE_MODE, f"bits {bits:#x}", "no bit but reverse", Verdict.WARNING, remedy))
    return out
