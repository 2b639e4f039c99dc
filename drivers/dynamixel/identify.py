"""Is this the arm the cell describes?  Reads and judges; never writes a goal, a mode or EEPROM, never switches torque.

One exception, which moves nothing: a servo set to answer pings only is set to answer reads, or it could not be judged.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from drivers.dynamixel.arm_map import ArmMap, ServoSlot
from drivers.dynamixel.errors import NoReplyError, PortError, RejectedError, hardware_names
from drivers.dynamixel.line.bus import Bus, Ping
from drivers.dynamixel.servo.table import (
    BAUD_RATES,
    CURRENT_LIMIT,
    DRIVE_MODE,
    HARDWARE_ERROR_STATUS,
    HOMING_OFFSET,
    MAX_VOLTAGE_LIMIT,
    MIN_VOLTAGE_LIMIT,
    NO_SECONDARY_ID,
    OPERATING_MODE,
    PRESENT_INPUT_VOLTAGE,
    PRESENT_TEMPERATURE,
    PWM_LIMIT,
    RETURN_DELAY_TIME,
    SECONDARY_ID,
    SERVOS,
    SHUTDOWN,
    STATUS_RETURN_LEVEL,
    TEMPERATURE_LIMIT,
    TORQUE_ENABLE,
    DriveMode,
    HardwareError,
    OperatingMode,
    Register,
)
from drivers.dynamixel.servo.torque import CurrentDrive
from drivers.interface import ConnectError

READ_FROM_ALL = (
    DRIVE_MODE, OPERATING_MODE, SECONDARY_ID, RETURN_DELAY_TIME, HOMING_OFFSET, TEMPERATURE_LIMIT, MAX_VOLTAGE_LIMIT,
    MIN_VOLTAGE_LIMIT, PWM_LIMIT, SHUTDOWN, TORQUE_ENABLE, HARDWARE_ERROR_STATUS, PRESENT_INPUT_VOLTAGE,
    PRESENT_TEMPERATURE,
)  # fmt: skip
_SECONDARY_OFF = 253  # and above


class IdentityError(ConnectError):
    """One servo, or the whole bus, is not as the arm map says.  servo_id is None when it is about the bus."""

    def __init__(self, servo_id: int | None, what: str, *, found: object, expected: object, remedy: str) -> None:
        super().__init__(what, found=found, expected=expected, remedy=remedy)
        self.servo_id = servo_id


@dataclass(frozen=True, slots=True)
class Change:
    """One EEPROM register that bring-up will write."""

    register: Register
    found: int
    wanted: int


@dataclass(frozen=True, slots=True)
class ServoFound:
    """One servo of the map as it is."""

    slot: ServoSlot
    firmware: int
    values: Mapping[Register, int]

    @property
    def fast(self) -> bool:
        """True when it answers fast sync reads."""
        needed = self.slot.model.fast_sync_min_firmware
        return needed is not None and self.firmware >= needed

    @property
    def torque_on(self) -> bool:
        """True when it held torque when asked."""
        return self.values[TORQUE_ENABLE] != 0

    @property
    def changes(self) -> list[Change]:
        """EEPROM registers that must be written before this servo can do its part.

        What says how the arm is put together (direction, shadow, homing offset) is never among them.
        """
        reverse = DriveMode.REVERSE if self.slot.reverse else DriveMode(0)
        # torque on by goal update would make the zeroing of the goal switch the torque on
        wanted = {RETURN_DELAY_TIME: 0, DRIVE_MODE: int(reverse), OPERATING_MODE: int(self.slot.joint.mode)}
        return [Change(r, self.values[r], value) for r, value in wanted.items() if self.values[r] != value]

    @property
    def limit_count(self) -> int:
        """EEPROM limit of the goal that this servo's effort is written to."""
        return self.values[CURRENT_LIMIT if CURRENT_LIMIT in self.values else PWM_LIMIT]


def identify(bus: Bus, arm: ArmMap, scan_s: float) -> tuple[list[ServoFound], list[IdentityError]]:
    """Find and judge every servo of the map.  Returns what was found and everything that is wrong with it.

    scan_s: how long to wait for servos that are not in the map.
    """
    pings, problems = _present(bus, arm)
    if not pings:
        return [], [_nobody(bus, arm)]
    problems += _strangers(bus, arm, scan_s)
    found = []
    for slot in arm.slots:
        ping = pings.get(slot.servo_id)
        if ping is None:
            continue
        wrong = _wrong_kind(slot, ping, arm)
        if wrong is not None:
            problems.append(wrong)
            continue
        try:
            servo = ServoFound(slot, ping.firmware, _read_all(bus, slot))
        except (NoReplyError, RejectedError) as error:
            problems.append(_unreadable(slot, error))
            continue
        found.append(servo)
        problems += _wrong_state(servo)
    return found, problems


def _unreadable(slot: ServoSlot, error: NoReplyError | RejectedError) -> IdentityError:
    return IdentityError(
        slot.servo_id,
        f"servo {slot.servo_id} ({slot.joint.name})",
        found=f"{error.found} after a good ping",
        expected=error.expected,
        remedy="check its cable: the bus is not reliable",
    )


def _present(bus: Bus, arm: ArmMap) -> tuple[dict[int, Ping], list[IdentityError]]:
    pings, problems = {}, []
    for slot in arm.slots:
        try:
            pings[slot.servo_id] = bus.ping(slot.servo_id, attempts=2)
        except NoReplyError as error:
            remedy = "check its cable and those before it in the chain, or set its ID with `coop motors setup`"
            if error.damaged:
                remedy = "two servos may have this ID: connect one alone and set its ID with `coop motors setup`"
            problems.append(
                IdentityError(
                    slot.servo_id,
                    f"servo {slot.servo_id} ({slot.joint.name})",
                    found=error.found,
                    expected=f"a {slot.joint.servo} that answers",
                    remedy=remedy,
                )
            )
    return pings, problems


def _nobody(bus: Bus, arm: ArmMap) -> IdentityError:
    """No servo answers: is it the speed, or the power?"""
    ids = [slot.servo_id for slot in arm.slots]
    answering = None
    for baud in BAUD_RATES.values():
        if baud == arm.baud:
            continue
        try:
            bus.port.set_baud(baud)
            bus.ping(ids[0], attempts=1)
        except (NoReplyError, PortError):
            continue
        answering = baud
        break
    bus.port.set_baud(arm.baud)
    if answering is not None:
        return IdentityError(
            None,
            f"arm {arm.arm}: speed of the bus {arm.port}",
            found=f"servo {ids[0]} answers at {answering} bit/s",
            expected=f"{arm.baud} bit/s",
            remedy="correct `baud` in the cell, or set the servos' Baud Rate with `coop motors setup`",
        )
    return IdentityError(
        None,
        f"arm {arm.arm}: bus {arm.port}",
        found=f"none of the servos {', '.join(map(str, ids))} answers at any speed",
        expected="all of them",
        remedy="switch on the 12 V supply, check the cable to the first servo, and that this is the right port",
    )


def _strangers(bus: Bus, arm: ArmMap, scan_s: float) -> list[IdentityError]:
    mapped = {slot.servo_id for slot in arm.slots}
    answers = [ping.servo_id for ping in bus.ping_all(scan_s)]
    problems = []
    for servo_id in sorted(set(answers)):
        if servo_id not in mapped:
            problems.append(
                IdentityError(
                    servo_id,
                    f"servo {servo_id} on {arm.port}",
                    found="a servo that the arm file does not know",
                    expected=f"only the IDs {', '.join(map(str, sorted(mapped)))}",
                    remedy="unplug it, or use the arm file of this arm",
                )
            )
        elif answers.count(servo_id) > 1:
            problems.append(
                IdentityError(
                    servo_id,
                    f"servo {servo_id} on {arm.port}",
                    found=f"{answers.count(servo_id)} servos with this ID",
                    expected="one",
                    remedy="connect one of them alone and give it its own ID with `coop motors setup`",
                )
            )
    return problems


def _wrong_kind(slot: ServoSlot, ping: Ping, arm: ArmMap) -> IdentityError | None:
    who = f"servo {slot.servo_id} ({slot.joint.name})"
    if ping.model_number != slot.model.model_number:
        names = {model.model_number: name for name, model in SERVOS.items()}
        return IdentityError(
            slot.servo_id,
            f"{who}: model",
            found=names.get(ping.model_number, f"model number {ping.model_number}"),
            expected=slot.joint.servo,
            remedy="this may be another arm: check the port, or the arm file",
        )
    needed = max(arm.firmware_min, slot.model.watchdog_min_firmware or 0)
    if ping.firmware < needed:
        return IdentityError(
            slot.servo_id,
            f"{who}: firmware",
            found=ping.firmware,
            expected=f"{needed} or newer (bus watchdog)",
            remedy="update it with DYNAMIXEL Wizard 2.0",
        )
    return None


def _read_all(bus: Bus, slot: ServoSlot) -> dict[Register, int]:
    try:
        bus.read(slot.servo_id, STATUS_RETURN_LEVEL)
    except NoReplyError:
        bus.write_blind(STATUS_RETURN_LEVEL, {slot.servo_id: 2})  # it answers pings only
    registers = [r for r in READ_FROM_ALL if r.name in slot.model.registers]
    if CURRENT_LIMIT.name in slot.model.registers:
        registers.append(CURRENT_LIMIT)
    return {register: bus.read(slot.servo_id, register) for register in registers}


def _wrong_state(servo: ServoFound) -> list[IdentityError]:
    slot, values = servo.slot, servo.values
    who = f"servo {slot.servo_id} ({slot.joint.name})"
    problems = []

    def need(holds: bool, what: str, found: object, expected: object, remedy: str) -> None:
        if not holds:
            problem = IdentityError(slot.servo_id, f"{who}: {what}", found=found, expected=expected, remedy=remedy)
            problems.append(problem)

    hardware = HardwareError(values[HARDWARE_ERROR_STATUS])
    need(
        not hardware, "hardware error", hardware_names(hardware), "none",
        "remove the cause, then switch its supply off and on",
    )  # fmt: skip
    low, high, now = (values[r] * 0.1 for r in (MIN_VOLTAGE_LIMIT, MAX_VOLTAGE_LIMIT, PRESENT_INPUT_VOLTAGE))
    need(low <= now <= high, "supply", f"{now:.1f} V", f"{low:.1f} to {high:.1f} V", "check the 12 V supply")
    reverse = bool(values[DRIVE_MODE] & DriveMode.REVERSE)
    need(
        reverse == slot.reverse, "Drive Mode, direction", f"reverse {reverse}", f"reverse {slot.reverse}",
        "set it with `coop motors setup` once you have checked how the servo is mounted",
    )  # fmt: skip
    follows = slot.joint.ids[0] if slot.shadow else NO_SECONDARY_ID
    secondary = min(values[SECONDARY_ID], _SECONDARY_OFF)
    need(
        secondary == min(follows, _SECONDARY_OFF), "Secondary ID", values[SECONDARY_ID], follows,
        "set it with `coop motors setup`",
    )  # fmt: skip
    need(
        slot.shadow or values[HOMING_OFFSET] == 0, "Homing Offset", values[HOMING_OFFSET], 0,
        "set it to 0 (`coop motors setup`): with an offset some firmware moves when its watchdog fires",
    )  # fmt: skip
    if slot.joint.mode is OperatingMode.CURRENT and not slot.shadow:
        needed = CurrentDrive(slot.joint).needed_count
        need(
            values[CURRENT_LIMIT] >= needed, "Current Limit", values[CURRENT_LIMIT], f"at least {needed}",
            "raise it with `coop motors setup`, or lower safety.tau_max_fraction_of_stall",
        )  # fmt: skip
    return problems
