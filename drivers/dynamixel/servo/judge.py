"""What a servo of an arm must be, judged here for the driver's connect, for the servo tools and for the doctor.

Pure: a servo as it was read goes in, the rules that it breaks come out, each with what follows.  A rule whose registers
a servo does not have is not judged; who reads a servo sees to it that only registers of younger firmware are absent.
"""

from __future__ import annotations

from collections.abc import Callable

from drivers.dynamixel.arm_map import JointMap, JointRole
from drivers.dynamixel.errors import hardware_names
from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import WATCHDOG_TRIPPED, DriveMode, HardwareError, OperatingMode
from drivers.dynamixel.servo.codes import StartupConfiguration as Startup
from drivers.dynamixel.servo.found import Check, Consequence, Misfit, Rule, Said, ServoFound
from drivers.dynamixel.servo.kept import KEPT_RAM
from drivers.dynamixel.servo.models import RATED_VOLTAGE_V, SERVOS_BY_NUMBER, ServoModel
from drivers.dynamixel.servo.table import Register
from drivers.dynamixel.servo.thermal import MARGIN_C
from drivers.dynamixel.servo.torque import CurrentDrive, needed_pwm_count
from drivers.dynamixel.servo.units import AngleScale, volts
from drivers.dynamixel.servo.wanted import setup_values
from drivers.interface import END_STOP_RAD

SUPPLY_TOLERANCE = 0.08  # of the 12 V that torque constants are rated at
ANSWERS_ALL = 2  # Status Return Level
_SECONDARY_OFF = 253  # and above
_SETUP = "`coop motors setup` on this servo alone"
_MARK = "`coop motors mark` on this arm"
_WIZARD = "update it with DYNAMIXEL Wizard 2.0"


def judge(servo: ServoFound) -> list[Misfit]:
    """Rules that a servo breaks, in their order; of another model nothing else is asked."""
    if (other := broken(MODEL, servo)) is not None:
        return [other]
    return [misfit for rule in RULES if (misfit := broken(rule, servo)) is not None]


def broken(rule: Rule, servo: ServoFound) -> Misfit | None:
    """The rule, if it can be judged and does not hold."""
    if not all(register.name in servo.values for register in rule.registers):
        return None
    said = rule.check(servo)
    return None if said is None else Misfit(rule, servo.slot, said)


def registers(model: ServoModel) -> list[Register]:
    """What must be read of a servo of this model so that every rule can be judged, in order of address."""
    names = {register.name for rule in RULES for register in rule.registers}
    return [register for name, register in model.registers.items() if name in names]


def model_name(number: int) -> str:
    """Name of a model number."""
    model = SERVOS_BY_NUMBER.get(number)
    return model.name if model is not None else f"servo of model number {number}"


# --- what it is -------------------------------------------------------------------------------------------------------


def _model(servo: ServoFound) -> Said | None:
    if servo.model_number == servo.slot.model.model_number:
        return None
    remedy = "this may be another arm or another servo: check the port, the arm file, the joint"
    return Said(model_name(servo.model_number), servo.slot.joint.servo, remedy)


def _mark(servo: ServoFound) -> Said | None:
    mark, found = servo.slot.mark, servo.value(table.MOVING_THRESHOLD)
    if mark.fits(found):
        return None
    if (owner := mark.owner(found)) is not None:
        remedy = f"the cables of {mark.arm} and {owner} are swapped; if this servo alone comes from {owner}: {_MARK}"
        return Said(f"{found}, arm {owner}'s", mark.wanted, remedy)
    factory = ", as it leaves the factory" if found == servo.slot.model.default(table.MOVING_THRESHOLD) else ""
    return Said(f"{found}{factory}", mark.wanted, f"check that this is arm {mark.arm}, then {_MARK}")


def _firmware(servo: ServoFound) -> Said | None:
    least = servo.slot.model.watchdog_min_firmware or 0
    return None if servo.firmware >= least else Said(str(servo.firmware), f"{least} or newer (bus watchdog)", _WIZARD)


def _fast_read(servo: ServoFound) -> Said | None:
    least = servo.slot.model.fast_sync_min_firmware
    if least is None or servo.fast:
        return None
    return Said(f"firmware {servo.firmware}", f"{least} or newer", f"every cycle takes longer without; {_WIZARD}")


# --- how it is --------------------------------------------------------------------------------------------------------


def _hardware(servo: ServoFound) -> Said | None:
    bits = HardwareError(servo.value(table.HARDWARE_ERROR_STATUS))
    remedy = "remove the cause, then switch its supply off and on"
    return Said(hardware_names(bits), "none", remedy) if bits else None


def _supply(servo: ServoFound) -> Said | None:
    low, now, high = (volts(servo.value(register)) for register in _SUPPLIES)
    if low <= now <= high:
        return None
    return Said(f"{now:.1f} V", f"{low:.1f} to {high:.1f} V, its own limits", "check the 12 V supply and its cable")


def _rated_supply(servo: ServoFound) -> Said | None:
    near, far = (RATED_VOLTAGE_V * (1.0 + sign * SUPPLY_TOLERANCE) for sign in (-1.0, 1.0))
    now = volts(servo.value(table.PRESENT_INPUT_VOLTAGE))
    if near <= now <= far or _supply(servo) is not None:
        return None
    remedy = "torques are rated at 12 V: check the supply, and the cable where one servo has less than the rest"
    return Said(f"{now:.1f} V", f"{near:.1f} to {far:.1f} V", remedy)


def _heat(servo: ServoFound) -> Said | None:
    now, limit = (servo.value(register) for register in _HEATS)
    remedy = "let it cool down: at its limit it switches its torque off"
    return Said(f"{now} °C", f"below its limit of {limit} °C", remedy) if now >= limit else None


def _warmth(servo: ServoFound) -> Said | None:
    now, limit = (servo.value(register) for register in _HEATS)
    near = limit - MARGIN_C
    remedy = f"let it cool down: it switches itself off at {limit} °C"
    return Said(f"{now} °C", f"below {near:g} °C", remedy) if near <= now < limit else None


def _heat_limit(servo: ServoFound) -> Said | None:
    """Nobody else ends what is too hot: at it the servo switches itself off, and all warnings are measured from it."""
    found, factory = servo.value(table.TEMPERATURE_LIMIT), servo.slot.model.default(table.TEMPERATURE_LIMIT)
    return None if factory is None or found <= factory else Said(f"{found} °C", f"at most {factory} °C", _SETUP)


def _watchdog(servo: ServoFound) -> Said | None:
    tripped = servo.value(table.BUS_WATCHDOG) == WATCHDOG_TRIPPED
    found = "fired: the last program did not end as it should"
    return Said(found, "not fired", "the agent clears it before torque comes on") if tripped else None


def _return_level(servo: ServoFound) -> Said | None:
    level = servo.value(table.STATUS_RETURN_LEVEL)
    remedy = "the agent sets it when it connects"
    return None if level == ANSWERS_ALL else Said(str(level), f"{ANSWERS_ALL}: answers everything", remedy)


def _torque(servo: ServoFound) -> Said | None:
    remedy = "another program may hold this arm: support it, stop that program, switch the supply off and on"
    return Said("on already", "off", remedy) if servo.value(table.TORQUE_ENABLE) else None


def _pose(servo: ServoFound, or_else: str = "") -> Said | None:
    joint = servo.slot.joint
    if servo.slot.shadow or joint.role is JointRole.GRIPPER:
        return None
    angle, (low, high) = AngleScale(joint).angle_rad(servo.value(table.PRESENT_POSITION)), pose_range_rad(joint)
    remedy = f"move the arm there by hand before the agent is started{or_else}"
    return None if low <= angle <= high else Said(f"{angle:.3f} rad", f"{low:.3f} to {high:.3f} rad", remedy)


def _start_pose(servo: ServoFound) -> Said | None:
    return None if servo.slot.joint.at_rest else _pose(servo, "; one that lies at its rest begins with --whole")


def _rest_pose(servo: ServoFound) -> Said | None:
    return _pose(servo) if servo.slot.joint.at_rest else None


def pose_range_rad(joint: JointMap) -> tuple[float, float]:
    """Where a joint must be before torque comes on."""
    low, high = AngleScale(joint).limits_rad
    if joint.role is JointRole.CONTROLLED:  # one that is held takes no goal beyond its limits
        low, high = low - END_STOP_RAD, high + END_STOP_RAD
    if joint.start_rad is not None:
        low = max(low, joint.start_rad - joint.start_tolerance_rad)
        high = min(high, joint.start_rad + joint.start_tolerance_rad)
    return low, high


# --- how it was set up ------------------------------------------------------------------------------------------------


def _direction(servo: ServoFound) -> Said | None:
    reverse = bool(servo.value(table.DRIVE_MODE) & DriveMode.REVERSE)
    words = ("normal (bit 0 clear)", "reverse (bit 0 set)")
    remedy = f"check how the servo is mounted, then {_SETUP}"
    return None if reverse == servo.slot.reverse else Said(words[reverse], words[not reverse], remedy)


def _drive_bits(servo: ServoFound) -> Said | None:
    bits = servo.value(table.DRIVE_MODE) & ~DriveMode.REVERSE
    remedy = f"the agent clears them before torque comes on, or {_SETUP}"
    return Said(f"bits {bits:#x}", "no bit but reverse", remedy) if bits else None


def _secondary(servo: ServoFound) -> Said | None:
    found, leader = servo.value(table.SECONDARY_ID), setup_values(servo.slot)[table.SECONDARY_ID]
    same = min(found, _SECONDARY_OFF) == min(leader, _SECONDARY_OFF)
    return None if same else Said(str(found), str(leader), _SETUP)


def _startup(servo: ServoFound) -> Said | None:
    """A dip of the supply must leave a servo limp, with the registers by which a restart is recognised."""
    value = servo.value(table.STARTUP_CONFIGURATION)
    what = {Startup.TORQUE_ON: "torque on", Startup.RAM_RESTORE: "registers from its backup"}
    text = " and ".join(words for bit, words in what.items() if value & bit) or "something unknown"
    remedy = f"{_SETUP}: after a dip of the supply it would act by itself, in current mode at its full limit"
    return Said(f"{value}: {text} when power comes", "0", remedy) if value else None


def _leaves_enough(servo: ServoFound, register: Register, needed: Callable[[JointMap], int]) -> Said | None:
    """A limit must leave a joint that takes torque its largest, and one that is held the share with which it is."""
    joint, limit = servo.slot.joint, servo.value(register)
    least, remedy = joint.model.share_count(register, max(joint.hold_effort, joint.grip_effort)), _SETUP
    if joint.role is JointRole.CONTROLLED:
        least, remedy = needed(joint), f"{_SETUP}, or lower safety.tau_max_fraction_of_stall"
    return None if limit >= least else Said(str(limit), f"at least {least}", remedy)


def _current_limit(servo: ServoFound) -> Said | None:
    """It bounds the current in the modes that command one."""
    if servo.slot.joint.mode not in (OperatingMode.CURRENT, OperatingMode.CURRENT_BASED_POSITION):
        return None
    return _leaves_enough(servo, table.CURRENT_LIMIT, lambda joint: CurrentDrive(joint).needed_count)


def _pwm_needed(servo: ServoFound) -> Said | None:
    """It bounds the voltage in every mode: with too little of it a servo that has torque on is limp."""
    return _leaves_enough(servo, table.PWM_LIMIT, needed_pwm_count)


def _pwm_limit(servo: ServoFound) -> Said | None:
    return None if _pwm_needed(servo) is not None else _as_set_up(table.PWM_LIMIT)(servo)


def _mode(servo: ServoFound) -> Said | None:
    found, wanted = servo.value(table.OPERATING_MODE), servo.slot.joint.mode
    return None if found == wanted else Said(str(found), str(int(wanted)), "the agent sets it before torque comes on")


def _as_set_up(register: Register, remedy: str = _SETUP) -> Check:
    """The register holds what setup writes; where setup leaves it, anything."""

    def check(servo: ServoFound) -> Said | None:
        found = servo.value(register)
        wanted = setup_values(servo.slot).get(register, found)
        return None if found == wanted else Said(str(found), str(wanted), remedy)

    return check


def _plain(register: Register, consequence: Consequence, remedy: str = _SETUP) -> Rule:
    return Rule(register.name, (register,), consequence, _as_set_up(register, remedy))


_SUPPLIES = (table.MIN_VOLTAGE_LIMIT, table.PRESENT_INPUT_VOLTAGE, table.MAX_VOLTAGE_LIMIT)
_HEATS = (table.PRESENT_TEMPERATURE, table.TEMPERATURE_LIMIT)
_BY_AGENT = f"the agent sets it before torque comes on, or {_SETUP}"
_NO_OFFSET = f"{_SETUP}: with an offset some firmware moves when its watchdog fires"

MODEL = Rule("model", (), Consequence.NO_CONNECTION, _model)
MARK = Rule("mark", (table.MOVING_THRESHOLD,), Consequence.NO_CONNECTION, _mark)
FIRMWARE = Rule("firmware", (), Consequence.NO_CONNECTION, _firmware)
FAST_READ = Rule("fast sync read", (), Consequence.TOLERATED, _fast_read)
HARDWARE = Rule("hardware error", (table.HARDWARE_ERROR_STATUS,), Consequence.NO_CONNECTION, _hardware)
SUPPLY = Rule("supply", _SUPPLIES, Consequence.NO_CONNECTION, _supply)
RATED_SUPPLY = Rule("supply", _SUPPLIES, Consequence.TOLERATED, _rated_supply)
HEAT = Rule("temperature", _HEATS, Consequence.NO_CONNECTION, _heat)
WARMTH = Rule("temperature", _HEATS, Consequence.TOLERATED, _warmth)
WATCHDOG = Rule("bus watchdog", (table.BUS_WATCHDOG,), Consequence.MENDED, _watchdog)
RETURN_LEVEL = Rule("Status Return Level", (table.STATUS_RETURN_LEVEL,), Consequence.MENDED, _return_level)
TORQUE = Rule("torque", (table.TORQUE_ENABLE,), Consequence.NO_TORQUE, _torque)
POSE = Rule("start pose", (table.PRESENT_POSITION,), Consequence.MOVE_FIRST, _start_pose)
REST = Rule("rest pose", (table.PRESENT_POSITION,), Consequence.MOVE_FIRST, _rest_pose)
DIRECTION = Rule("Drive Mode, direction", (table.DRIVE_MODE,), Consequence.NO_CONNECTION, _direction)
DRIVE_BITS = Rule("Drive Mode", (table.DRIVE_MODE,), Consequence.MENDED, _drive_bits)
SECONDARY = Rule("Secondary ID", (table.SECONDARY_ID,), Consequence.NO_CONNECTION, _secondary)
HOMING = _plain(table.HOMING_OFFSET, Consequence.NO_CONNECTION, _NO_OFFSET)
STARTUP = Rule("Startup Configuration", (table.STARTUP_CONFIGURATION,), Consequence.NO_CONNECTION, _startup)
CURRENT_LIMIT = Rule("Current Limit", (table.CURRENT_LIMIT,), Consequence.NO_CONNECTION, _current_limit)
MODE = Rule("Operating Mode", (table.OPERATING_MODE,), Consequence.ROUTINE, _mode)
RETURN_DELAY = _plain(table.RETURN_DELAY_TIME, Consequence.MENDED, _BY_AGENT)
PWM_NEEDED = Rule("PWM Limit", (table.PWM_LIMIT,), Consequence.NO_CONNECTION, _pwm_needed)
PWM_LIMIT = Rule("PWM Limit", (table.PWM_LIMIT,), Consequence.TOLERATED, _pwm_limit)
LOW_LIMIT = _plain(table.MIN_POSITION_LIMIT, Consequence.TOLERATED)
HIGH_LIMIT = _plain(table.MAX_POSITION_LIMIT, Consequence.TOLERATED)
SHUTDOWN = _plain(table.SHUTDOWN, Consequence.TOLERATED)
HEAT_LIMIT = Rule("Temperature Limit", (table.TEMPERATURE_LIMIT,), Consequence.TOLERATED, _heat_limit)

RULES = (
    MODEL, MARK, FIRMWARE, FAST_READ, SUPPLY, RATED_SUPPLY, HEAT, WARMTH, HARDWARE, WATCHDOG, RETURN_LEVEL, TORQUE,
    POSE, REST, DIRECTION, DRIVE_BITS, SECONDARY, HOMING, STARTUP, CURRENT_LIMIT, PWM_NEEDED, MODE, RETURN_DELAY,
    PWM_LIMIT, LOW_LIMIT, HIGH_LIMIT, SHUTDOWN, HEAT_LIMIT, *KEPT_RAM,
)  # fmt: skip
