"""Are the servos on an open line those of the arm, and are they fit?  Pings and reads; never writes to a servo."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from agent.motors import eeprom
from agent.motors.find import ALL_BAUDS, listen_s
from agent.verify.finding import Finding, Verdict, from_refusal, refused
from drivers.dynamixel.arm_map import ArmMap, ServoSlot
from drivers.dynamixel.errors import NoReplyError, PortError, RejectedError
from drivers.dynamixel.line.bus import Bus, Ping
from drivers.dynamixel.servo.table import (
    BUS_WATCHDOG,
    HARDWARE_ERROR_STATUS,
    PRESENT_INPUT_VOLTAGE,
    PRESENT_POSITION,
    PRESENT_TEMPERATURE,
    SERVOS_BY_NUMBER,
    TORQUE_ENABLE,
)

STATE = (
    TORQUE_ENABLE, HARDWARE_ERROR_STATUS, BUS_WATCHDOG, PRESENT_INPUT_VOLTAGE, PRESENT_TEMPERATURE, PRESENT_POSITION,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class ServoState:
    """One servo of the arm as it is."""

    slot: ServoSlot
    firmware: int
    values: Mapping[str, int]  # by register name; those that its firmware has

    @property
    def name(self) -> str:
        """What a person calls it."""
        return servo_name(self.slot)


@dataclass(frozen=True, slots=True)
class Presence:
    """Who is on the line."""

    findings: tuple[Finding, ...]
    states: tuple[ServoState, ...]  # of the servos of the arm that are there, of the right model, and readable

    @property
    def complete(self) -> bool:
        """Whether nothing was wrong with who is there."""
        return all(f.verdict is Verdict.OK for f in self.findings)


def servo_name(slot: ServoSlot) -> str:
    """E.g. "servo 3 (shoulder shadow)"."""
    return f"servo {slot.servo_id} ({slot.joint.name}{' shadow' if slot.shadow else ''})"


def presence(bus: Bus, arm: ArmMap) -> Presence:
    """Find the arm's servos and all others, and read the EEPROM and state of the former."""
    heard = bus.ping_all(listen_s(arm.baud))
    findings: list[Finding] = []
    pings: dict[int, Ping] = {}
    silent: list[Finding] = []
    for slot in arm.slots:
        same = [ping for ping in heard if ping.servo_id == slot.servo_id]
        try:
            ping = same[0] if same else bus.ping(slot.servo_id, attempts=2)
        except NoReplyError as error:
            if error.damaged:
                findings.append(_shared(arm, slot))
            else:
                silent.append(_missing(arm, slot, error))
            continue
        if len(same) > 1:
            findings.append(_shared(arm, slot))
        else:
            pings[slot.servo_id] = ping
    if len(silent) == len(arm.slots):
        return Presence((_nobody(bus, arm, heard),), ())
    findings += [*silent, *_strangers(arm, heard)]
    if not findings:
        ids = ", ".join(str(slot.servo_id) for slot in arm.slots)
        findings.append(Finding("servos", arm.arm, f"{len(pings)}, IDs {ids}", "those of the arm file"))
    states = []
    for slot in arm.slots:
        if slot.servo_id in pings:
            read = _read(bus, arm, slot, pings[slot.servo_id])
            if isinstance(read, Finding):
                findings.append(read)
            else:
                states.append(read)
    return Presence(tuple(findings), tuple(states))


def _missing(arm: ArmMap, slot: ServoSlot, error: NoReplyError) -> Finding:
    return refused(
        servo_name(slot), arm.arm, str(error.found), f"a {slot.joint.servo} that answers",
        "check its cable and those before it in the chain, or set its ID with `coop motors setup`",
    )  # fmt: skip


def _shared(arm: ArmMap, slot: ServoSlot) -> Finding:
    return refused(
        servo_name(slot), arm.arm, "more than one servo with this ID", "one",
        "connect them one at a time and give each its own ID with `coop motors setup`",
    )  # fmt: skip


def _strangers(arm: ArmMap, heard: Sequence[Ping]) -> list[Finding]:
    """Servos that answer and are not in the arm file."""
    mapped = {slot.servo_id for slot in arm.slots}
    known = ", ".join(map(str, sorted(mapped)))
    remedy = "unplug it, give it its ID with `coop motors setup`, or use the arm file of this arm"
    return [
        refused(
            f"servo {ping.servo_id}", arm.arm, f"a {model_name(ping.model_number)} that the arm file does not know",
            f"only IDs {known}", remedy,
        )
        for ping in sorted(set(heard)) if ping.servo_id not in mapped
    ]  # fmt: skip


def _nobody(bus: Bus, arm: ArmMap, heard: Sequence[Ping]) -> Finding:
    """No servo of the arm answers: is it another arm, the speed, or the power?"""
    ids = ", ".join(str(slot.servo_id) for slot in arm.slots)
    if heard:
        others = ", ".join(str(ping.servo_id) for ping in sorted(set(heard)))
        remedy = "this is another arm: check the port, or the arm file"
        return refused("servos", arm.arm, f"IDs {others}", f"IDs {ids}", remedy)
    answer = _at_another_speed(bus, arm)
    bus.port.set_baud(arm.baud)
    if answer is not None:
        servo_id, baud = answer
        return refused(
            "baud rate", arm.arm, f"servo {servo_id} answers at {baud} bit/s", f"{arm.baud} bit/s",
            "correct `baud` in the cell, or the servos' Baud Rate with `coop motors setup`",
        )  # fmt: skip
    return refused(
        "servos", arm.arm, "none that answers, at any speed", f"IDs {ids}",
        "switch on the 12 V supply, check the cable to the first servo, and that this is the right port",
    )  # fmt: skip


def _at_another_speed(bus: Bus, arm: ArmMap) -> tuple[int, int] | None:
    """A servo of the arm that answers at another speed: (ID, bit/s)."""
    for baud in ALL_BAUDS:
        if baud == arm.baud:
            continue
        try:
            bus.port.set_baud(baud)
        except PortError:
            continue  # what the adapter cannot make cannot be what the servos were set to with it
        for slot in arm.slots:
            try:
                return bus.ping(slot.servo_id, attempts=1).servo_id, baud
            except NoReplyError:
                continue
    return None


def model_name(number: int) -> str:
    """Name of a model number."""
    model = SERVOS_BY_NUMBER.get(number)
    return model.name if model is not None else f"servo of model number {number}"


def _read(bus: Bus, arm: ArmMap, slot: ServoSlot, ping: Ping) -> ServoState | Finding:
    """EEPROM and state of one servo, or what is wrong with it."""
    if ping.model_number != slot.model.model_number:
        return refused(
            f"{servo_name(slot)}: model", arm.arm, model_name(ping.model_number), slot.joint.servo,
            "this may be another arm: check the port, or the arm file",
        )  # fmt: skip
    registers = [*eeprom.writable(slot.model), *(r for r in STATE if r.name in slot.model.registers)]
    try:
        return ServoState(slot, ping.firmware, eeprom.read(bus, slot.servo_id, registers))
    except NoReplyError as error:
        return refused(
            servo_name(slot), arm.arm, f"{error.found}, though it answers pings", "values of its registers",
            "if only this servo: its Status Return Level may be 0, switch its supply off and on; "
            "if several: check the cable",
        )  # fmt: skip
    except RejectedError as error:
        return from_refusal(error, arm.arm)
