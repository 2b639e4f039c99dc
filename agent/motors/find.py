"""Which servos are on a line, at which speed, and how they are, by pings and reads."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from agent.motors.line import open_line
from drivers.dynamixel.errors import NoReplyError, PortError, RejectedError, hardware_names
from drivers.dynamixel.line import protocol1
from drivers.dynamixel.line.bus import Bus, Ping
from drivers.dynamixel.servo.codes import BAUD_RATES, MAX_ID, HardwareError
from drivers.dynamixel.servo.models import SERVOS_BY_NUMBER, ServoModel
from drivers.dynamixel.servo.table import (
    HARDWARE_ERROR_STATUS,
    PRESENT_INPUT_VOLTAGE,
    PRESENT_POSITION,
    PRESENT_TEMPERATURE,
    TORQUE_ENABLE,
)
from drivers.dynamixel.servo.units import volts
from drivers.interface import Refusal

ALL_BAUDS = tuple(sorted(BAUD_RATES.values(), key=lambda baud: (baud != 1_000_000, baud != 57_600, baud)))
_ASKED = PRESENT_INPUT_VOLTAGE, PRESENT_TEMPERATURE, HARDWARE_ERROR_STATUS, TORQUE_ENABLE, PRESENT_POSITION
_PING_BYTES, _SLOT_S, _HOST_S = 14, 3e-3, 0.02

Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Answers:
    """Who answered a broadcast ping at one speed."""

    baud: int
    pings: tuple[Ping, ...]
    damaged: int  # replies in pieces: as when two servos share an ID


@dataclass(frozen=True, slots=True)
class ServoSeen:
    """One servo as it is; None where it did not say."""

    port: str
    baud: int
    servo_id: int
    model_number: int | None
    firmware: int | None
    voltage_V: float | None = None
    temperature_C: int | None = None
    hardware_error: HardwareError | None = None
    torque_on: bool | None = None
    position_tick: int | None = None
    note: str = ""

    @property
    def model(self) -> ServoModel | None:
        """Its entry in the servo table; None for a model that is not there."""
        return None if self.model_number is None else SERVOS_BY_NUMBER.get(self.model_number)

    @property
    def model_name(self) -> str:
        """Name of the model, or its number."""
        return self.model.name if self.model is not None else f"model {self.model_number}"

    @property
    def hardware_text(self) -> str:
        """Hardware errors in words."""
        if self.hardware_error is None:
            return "-"
        return hardware_names(self.hardware_error) if self.hardware_error else "none"


class BaudError(Refusal):
    """A speed that no servo knows."""


def refuse_unknown_bauds(bauds: Sequence[int]) -> None:
    """Raise BaudError for a speed that is in no servo's Baud Rate register."""
    for baud in bauds:
        if baud not in BAUD_RATES.values():
            known = ", ".join(str(b) for b in BAUD_RATES.values())
            raise BaudError("baud rate", found=baud, expected=known, remedy="name one that servos know")


def listen_s(baud: int) -> float:
    """How long replies to a broadcast ping may take: 3 ms and 14 bytes for each of the IDs, and the host's share."""
    return (MAX_ID + 1) * (_PING_BYTES * 10.0 / baud + _SLOT_S) + _HOST_S


def search(bus: Bus, bauds: Sequence[int], tell: Tell) -> Iterator[Answers]:
    """Broadcast ping at each speed.  A speed that the adapter cannot make is told and left out."""
    for baud in bauds:
        tell(f"looking at {baud} bit/s")
        try:
            bus.port.set_baud(baud)
        except PortError as error:
            tell(str(error))
            continue
        damaged_before = bus.counters.corrupt
        pings = sorted(bus.ping_all(listen_s(baud)))
        yield Answers(baud, tuple(pings), bus.counters.corrupt - damaged_before)


def shared_ids(bus: Bus, answers: Answers) -> list[int]:
    """IDs that more than one servo has: those that came twice, and those whose replies destroy each other.

    The latter are found by asking one ID after the other, which takes up to 20 s.
    """
    heard = [ping.servo_id for ping in answers.pings]
    shared = {servo_id for servo_id in heard if heard.count(servo_id) > 1}
    if not answers.damaged:
        return sorted(shared)
    bus.port.set_baud(answers.baud)
    destroyed, before = set[int](), 0
    for servo_id in (*range(1, MAX_ID + 1), 0):
        if servo_id in heard:
            continue
        if _destroyed(bus, servo_id):  # or the reply to the ID before it, which came late
            for asked in (before, servo_id):
                bus.settle()
                if _destroyed(bus, asked):
                    destroyed.add(asked)
        before = servo_id
        if len(destroyed) >= answers.damaged:
            break
    return sorted(shared | destroyed)


def _destroyed(bus: Bus, servo_id: int) -> bool:
    """Whether a reply in pieces comes while this ID is asked."""
    try:
        bus.ping(servo_id, attempts=1)
    except NoReplyError as error:
        return error.damaged
    return False


def look(bus: Bus, port: str, ping: Ping) -> ServoSeen:
    """Read how a servo is; the line must be at its speed."""
    seen = ServoSeen(port, bus.port.baud, ping.servo_id, ping.model_number, ping.firmware)
    if seen.model is None or not seen.model.registers:
        return seen
    try:
        supply, celsius, errors, torque, tick = (bus.read(ping.servo_id, register) for register in _ASKED)
    except (NoReplyError, RejectedError) as error:
        return ServoSeen(port, seen.baud, seen.servo_id, seen.model_number, seen.firmware, note=f"reads: {error.found}")
    return ServoSeen(
        port, seen.baud, seen.servo_id, seen.model_number, seen.firmware, volts(supply), celsius,
        HardwareError(errors), bool(torque), tick,
    )  # fmt: skip


def survey(bus: Bus, port: str, bauds: Sequence[int], tell: Tell) -> list[ServoSeen]:
    """Every servo on the line at any of the speeds, by speed and ID; a shared ID has one entry that says so."""
    seen: list[ServoSeen] = []
    for answers in search(bus, bauds, tell):
        shared = shared_ids(bus, answers)
        bus.port.set_baud(answers.baud)
        seen += [look(bus, port, ping) for ping in answers.pings if ping.servo_id not in shared]
        seen += [
            ServoSeen(port, answers.baud, servo_id, None, None, note="more than one servo has this ID")
            for servo_id in shared
        ]
    return sorted(seen, key=lambda servo: (servo.baud, servo.servo_id))


def survey_old(path: str, bauds: Sequence[int], tell: Tell) -> list[ServoSeen]:
    """Servos on a port that speak Protocol 1.0, with what can be done about it.  Raises PortError."""
    with open_line(path):  # free, and silent
        pass
    return [
        ServoSeen(path, servo.baud, servo.servo_id, servo.model_number, None, note=servo.remedy)
        for servo in protocol1.find(path, bauds, tell)
    ]
