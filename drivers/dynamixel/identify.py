"""Is this the arm the cell describes?  Looks at who is on the line and reads them; `servo.judge` says what must hold.

Writes no goal, mode or EEPROM and switches no torque.  `identify` writes one register, which moves nothing: a servo set
to answer less than everything is set to answer, once no other servo says that this is not the arm.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

from drivers.dynamixel.arm_map import ArmMap, ServoSlot
from drivers.dynamixel.errors import Heard, NoReplyError, PortError, RejectedError
from drivers.dynamixel.line.bus import Bus, Ping
from drivers.dynamixel.servo import judge
from drivers.dynamixel.servo.codes import BAUD_RATES, StatusError
from drivers.dynamixel.servo.found import Consequence, Misfit, ServoFound
from drivers.dynamixel.servo.table import MOVING_THRESHOLD, SINCE_FIRMWARE, STATUS_RETURN_LEVEL
from drivers.interface import ConnectError, DriverError

_SETUP_ID = "set its ID with `coop motors setup`"


class IdentityError(ConnectError):
    """One servo, or the whole bus, is not as the arm map says.  servo_id is None when it is about the bus."""

    def __init__(self, servo_id: int | None, what: str, *, found: object, expected: object, remedy: str) -> None:
        super().__init__(what, found=found, expected=expected, remedy=remedy)
        self.servo_id = servo_id

    @classmethod
    def of(cls, misfit: Misfit) -> IdentityError:
        """A broken rule as an error."""
        said = misfit.said
        servo_id = misfit.slot.servo_id
        return cls(servo_id, misfit.what, found=said.found, expected=said.expected, remedy=said.remedy)


@dataclass(frozen=True, slots=True)
class Line:
    """Who is on the line: the servos of the arm that are there, of the right kind and readable; and what is wrong."""

    servos: tuple[ServoFound, ...]
    problems: tuple[IdentityError, ...]
    mute: tuple[int, ...] = ()  # IDs that answer pings and no read


def identify(bus: Bus, arm: ArmMap, scan_s: float) -> tuple[list[ServoFound], list[IdentityError]]:
    """Find and judge every servo of the map.  Returns what was found and all for which connect refuses the arm.

    scan_s: how long to wait for answers to a broadcast ping, with which servos that are not in the map are found.
    """
    line = survey(bus, arm, scan_s)
    refused, asleep = _refused(arm, line), _asleep(line)
    if asleep and {error.servo_id for error in refused} <= set(line.mute):
        bus.write_blind(STATUS_RETURN_LEVEL, dict.fromkeys(asleep, judge.ANSWERS_ALL))
        line = survey(bus, arm, scan_s, woken=True)
        refused = _refused(arm, line)
    return list(line.servos), refused


def _refused(arm: ArmMap, line: Line) -> list[IdentityError]:
    misfits = [misfit for servo in line.servos for misfit in judge.judge(servo)]
    refused = [IdentityError.of(m) for m in misfits if m.rule.consequence is Consequence.NO_CONNECTION]
    if (other := another_arm(arm, line.servos)) is not None:
        refused.insert(0, other)
    unread = [error for error in line.problems if error.servo_id in line.mute]  # tell the least: last
    return [*(error for error in line.problems if error not in unread), *refused, *unread]


def _asleep(line: Line) -> list[int]:
    """IDs of servos that answer less than everything."""
    curt = [s.slot.servo_id for s in line.servos if s.value(STATUS_RETURN_LEVEL) != judge.ANSWERS_ALL]
    return [*line.mute, *curt]


def another_arm(arm: ArmMap, servos: Sequence[ServoFound]) -> IdentityError | None:
    """What to say where all servos of the map agree on a mark that is not the arm's: it is the arm, not one servo."""
    misfits = [misfit for servo in servos if (misfit := judge.broken(judge.MARK, servo)) is not None]
    marks = {servo.value(MOVING_THRESHOLD) for servo in servos}
    if len(misfits) < len(arm.slots) or len(marks) > 1:
        return None
    found, expected, remedy = misfits[0].said
    if (owner := arm.mark.owner(marks.pop())) is not None:
        remedy = f"the cables of {arm.arm} and {owner} are swapped"
    return IdentityError(None, f"mark on {arm.port}", found=found, expected=expected, remedy=remedy)


def survey(bus: Bus, arm: ArmMap, scan_s: float, *, woken: bool = False) -> Line:
    """Find the arm's servos and all others, and read the former.  Writes nothing.  woken: all were set to answer."""
    heard = bus.ping_all(scan_s)
    pings: dict[int, Ping] = {}
    silent: dict[int, NoReplyError] = {}
    problems = []
    for slot in arm.slots:
        same = [ping for ping in heard if ping.servo_id == slot.servo_id]
        if len(same) > 1:
            problems.append(_shared(slot, f"{len(same)} answers to one ping"))
            continue
        try:
            pings[slot.servo_id] = same[0] if same else bus.ping(slot.servo_id, attempts=2)
        except NoReplyError as error:
            silent[slot.servo_id] = error
    if len(silent) == len(arm.slots):
        return Line((), (_nobody(bus, arm, heard, list(silent.values())),))
    problems += [_missing(slot, silent[slot.servo_id]) for slot in arm.slots if slot.servo_id in silent]
    problems += _strangers(arm, heard)
    servos, mute = [], []
    for slot in arm.slots:
        if slot.servo_id not in pings:
            continue
        _, model_number, firmware = pings[slot.servo_id]
        servo = ServoFound(slot, model_number, firmware, {})
        if (other := _of_another_kind(servo)) is not None:
            problems.append(other)
            continue
        try:
            servos.append(replace(servo, values=_values(bus, slot)))
        except (NoReplyError, RejectedError) as error:
            problems.append(_unread(slot, error, woken=woken))
            mute += [slot.servo_id] if isinstance(error, NoReplyError) else []
    return Line(tuple(servos), tuple(problems), tuple(mute))


def _missing(slot: ServoSlot, error: NoReplyError) -> IdentityError:
    if error.damaged:
        return _shared(slot, str(error.found))
    remedy = f"check its cable and those before it in the chain, or {_SETUP_ID}"
    if error.heard is not Heard.NOTHING:
        remedy = error.remedy
    return IdentityError(
        slot.servo_id, slot.title, found=error.found, expected=f"a {slot.joint.servo} that answers", remedy=remedy
    )


def _shared(slot: ServoSlot, found: str) -> IdentityError:
    return IdentityError(
        slot.servo_id, slot.title, found=found, expected="one servo with this ID, and whole answers",
        remedy=f"two servos may have this ID: connect one alone and {_SETUP_ID}; if not, check its cable and plugs",
    )  # fmt: skip


def _strangers(arm: ArmMap, heard: Sequence[Ping]) -> list[IdentityError]:
    """Servos that answer and are not in the arm file."""
    mapped = {slot.servo_id for slot in arm.slots}
    known = ", ".join(map(str, sorted(mapped)))
    return [
        IdentityError(
            ping.servo_id, f"servo {ping.servo_id} on {arm.port}",
            found=f"a {judge.model_name(ping.model_number)} that the arm file does not know",
            expected=f"only IDs {known}", remedy=f"unplug it, {_SETUP_ID}, or use the arm file of this arm",
        )
        for ping in sorted(set(heard)) if ping.servo_id not in mapped
    ]  # fmt: skip


def _nobody(bus: Bus, arm: ArmMap, heard: Sequence[Ping], errors: Sequence[NoReplyError]) -> IdentityError:
    """No servo of the arm answers: is it another arm, the line, the speed, or the power?"""
    expected = f"IDs {', '.join(str(slot.servo_id) for slot in arm.slots)}"
    what = f"servos on {arm.port}"
    if heard:
        others = ", ".join(str(ping.servo_id) for ping in sorted(set(heard)))
        remedy = "this is another arm: check the port, or the arm file"
        return IdentityError(None, what, found=f"IDs {others}", expected=expected, remedy=remedy)
    told = max(errors, key=lambda error: error.heard.rank)
    came = told.heard
    if came in (Heard.OTHER, Heard.DAMAGED):  # then neither power nor speed is what is wrong
        remedy = told.remedy if came is Heard.OTHER else (
            "servos answer, and the line spoils it: check the cable to the first servo, its ground and plugs, and try "
            "another adapter"
        )  # fmt: skip
        return IdentityError(
            None, what, found=f"{came.value}, at {arm.baud} bit/s", expected=f"whole answers of {expected}",
            remedy=remedy,
        )  # fmt: skip
    try:
        answer = _at_another_speed(bus, arm)
    except BaseException:
        with contextlib.suppress(DriverError):  # why nobody looks any further is what is told
            bus.port.set_baud(arm.baud)
        raise
    bus.port.set_baud(arm.baud)
    if answer is not None:
        return IdentityError(
            None, f"baud rate on {arm.port}", found=f"servo {answer[0]} answers at {answer[1]} bit/s",
            expected=f"{arm.baud} bit/s",
            remedy="correct `baud` in the cell, or the servos' Baud Rate with `coop motors setup`",
        )  # fmt: skip
    found = "none that answers, at any speed" + ("" if came is Heard.NOTHING else f"; {came.value}")
    return IdentityError(
        None, what, found=found, expected=expected,
        remedy="switch on the 12 V supply, check the cable to the first servo, and that this is the right port",
    )  # fmt: skip


def _at_another_speed(bus: Bus, arm: ArmMap) -> tuple[int, int] | None:
    """A servo of the arm that answers at another speed: (ID, bit/s)."""
    for baud in BAUD_RATES.values():
        if baud == arm.baud:
            continue
        try:
            bus.port.set_baud(baud)
        except PortError:
            continue  # what the adapter cannot make cannot be what the servos were set to with it
        for slot in arm.slots:
            with contextlib.suppress(NoReplyError):
                return bus.ping(slot.servo_id, attempts=1).servo_id, baud
    return None


def _of_another_kind(servo: ServoFound) -> IdentityError | None:
    """Another model or firmware, which has other registers."""
    misfits = (m for m in judge.judge(servo) if m.rule.consequence is Consequence.NO_CONNECTION)
    return next((IdentityError.of(misfit) for misfit in misfits), None)


def _unread(slot: ServoSlot, error: NoReplyError | RejectedError, *, woken: bool) -> IdentityError:
    remedy = "check its cable: the bus is not reliable" if woken else (
        "if only this servo: its Status Return Level may be 0, switch its supply off and on; if several: check the "
        "cable"
    )  # fmt: skip
    return IdentityError(
        slot.servo_id, slot.title, found=f"{error.found}, though it answers pings",
        expected="values of its registers", remedy=remedy,
    )  # fmt: skip


def _values(bus: Bus, slot: ServoSlot) -> dict[str, int]:
    values = {}
    for register in judge.registers(slot.model):
        try:
            values[register.name] = bus.read(slot.servo_id, register)
        except RejectedError as error:
            if error.code != StatusError.ACCESS or register.name not in SINCE_FIRMWARE:
                raise
    return values
