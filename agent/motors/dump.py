"""All EEPROM registers of a line's servos as a TOML file, and back: what differs is written, while torque is off.

The register of the mark stays as it is unless asked for: another arm's file would make two arms of one mark.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from agent.config import reading
from agent.config.reading import ConfigError
from agent.motors import eeprom
from agent.motors.find import ServoSeen
from drivers.dynamixel.errors import NoReplyError
from drivers.dynamixel.line.bus import Bus, Ping
from drivers.dynamixel.servo.codes import BAUD_RATES, MAX_ID
from drivers.dynamixel.servo.found import RegisterChange
from drivers.dynamixel.servo.models import SERVOS, SERVOS_BY_NUMBER, ServoModel
from drivers.dynamixel.servo.table import BAUD_RATE, ID, MOVING_THRESHOLD
from drivers.interface import DriverError, Refusal


class DumpFileError(Refusal):
    """A file that is no dump, or says what no servo can hold."""


class RestoreError(DriverError):
    """The line does not have the servos of the file; nothing was written."""


class DumpedServo(BaseModel):
    """One servo as it was."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    id: Annotated[int, Field(ge=0, le=MAX_ID)]
    model: str
    model_number: int
    firmware: int
    baud: int
    registers: dict[str, int]  # by e-manual name; ID and Baud Rate among them

    @model_validator(mode="after")
    def _possible(self) -> DumpedServo:
        servo = SERVOS.get(self.model)
        if servo is None or servo.model_number != self.model_number:
            raise ValueError(f"a known model with its own number (servo {self.id}: {self.model}, {self.model_number})")
        if self.baud not in BAUD_RATES.values():
            raise ValueError(f"a baud rate that servos know (servo {self.id}: {self.baud})")
        known = {register.name: register for register in eeprom.writable(servo)}
        for name, value in self.registers.items():
            register = known.get(name)
            if register is None:
                raise ValueError(f"EEPROM registers of a {self.model} only (servo {self.id}: {name})")
            bits = 8 * register.length
            low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if register.signed else (0, (1 << bits) - 1)
            if not low <= value <= high:
                raise ValueError(f"{name} from {low} to {high} (servo {self.id} has {value} in the file)")
        own = {ID.name: self.id, BAUD_RATE.name: next(code for code, b in BAUD_RATES.items() if b == self.baud)}
        if any(self.registers.get(name, value) != value for name, value in own.items()):
            raise ValueError(f"ID and Baud Rate registers that agree with id and baud (servo {self.id})")
        return self

    @property
    def servo_model(self) -> ServoModel:
        """Its entry in the servo table."""
        return SERVOS[self.model]


class Dump(BaseModel):
    """A dump file."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    format: Literal[1] = 1
    made_utc: str
    port: str
    servos: Annotated[list[DumpedServo], Field(min_length=1)]

    @model_validator(mode="after")
    def _distinct(self) -> Dump:
        ids = [servo.id for servo in self.servos]
        if len(set(ids)) != len(ids):
            raise ValueError(f"each servo ID once (they are {ids})")
        return self

    def toml(self) -> bytes:
        """The file's content."""
        return tomli_w.dumps(self.model_dump()).encode()


def parse(content: bytes, source: str) -> Dump:
    """Read a dump file's content.  Raises DumpFileError naming what is wrong in it."""
    try:
        return Dump.model_validate(reading.parse(content, Path(source)))
    except ConfigError as error:
        raise DumpFileError(source, found=error.found, expected="TOML", remedy="dump it again") from error
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "the whole file"
        own = first["type"] == "value_error"  # from a validator above, whose text names what was found
        raise DumpFileError(
            f"{key} in {source}", found="what no servo can hold" if own else repr(first["input"])[:60],
            expected=first["msg"].removeprefix("Value error, ").removeprefix("Input should be "),
            remedy="correct it, or dump again",
        ) from error  # fmt: skip


def load(path: Path) -> Dump:
    """Read a dump file.  Raises DumpFileError."""
    try:
        content = reading.read_file(path)
    except ConfigError as error:
        raise DumpFileError(
            f"file {path}", found=error.found, expected="a dump", remedy="make one with `coop motors dump`"
        ) from error
    return parse(content, path.name)


def take(bus: Bus, port: str, seen: Sequence[ServoSeen], made_utc: str) -> Dump:
    """Read the EEPROM of servos that a survey found.  Raises RestoreError, NoReplyError, RejectedError."""
    servos = []
    for servo in seen:
        model = servo.model
        if model is None or not model.registers or servo.firmware is None:
            raise RestoreError(
                f"servo {servo.servo_id} at {servo.baud} bit/s", found=servo.note or f"a {servo.model_name}",
                expected="a servo whose registers are known", remedy="give it its own ID, or unplug it",
            )  # fmt: skip
        bus.port.set_baud(servo.baud)
        values = eeprom.read(bus, servo.servo_id, eeprom.writable(model))
        servos.append(
            DumpedServo(
                id=servo.servo_id,
                model=model.name,
                model_number=model.model_number,
                firmware=servo.firmware,
                baud=servo.baud,
                registers=values,
            )
        )
    if not servos:
        raise RestoreError(
            f"servos on {port}", found="none", expected="at least one",
            remedy="switch on the 12 V supply, and see `coop motors scan`",
        )  # fmt: skip
    return Dump(made_utc=made_utc, port=port, servos=servos)


@dataclass(frozen=True, slots=True)
class ServoPlan:
    """What restoring will do to one servo of the file; baud: where it answers now, None when it does not."""

    servo: DumpedServo
    baud: int | None
    changes: tuple[RegisterChange, ...] = ()
    absent: tuple[str, ...] = ()  # registers of the file that its firmware does not have
    left: tuple[RegisterChange, ...] = ()  # what differs and is not written: the mark


def plan_restore(bus: Bus, dump: Dump, bauds: Sequence[int], *, mark: bool = False) -> list[ServoPlan]:
    """Compare the line with the file.  Writes nothing; a servo that does not answer has `baud` None.

    mark: whether the mark is to be written, too.
    Raises RestoreError (another model), EepromError (torque is on), NoReplyError, RejectedError.
    """
    return [_plan(bus, servo, bauds, mark=mark) for servo in dump.servos]


def apply_restore(bus: Bus, plans: Sequence[ServoPlan]) -> None:
    """Write the differences and read each back.  Raises EepromError, NoReplyError, RejectedError."""
    for plan in plans:
        if plan.baud is not None:
            eeprom.require_torque_off(at_baud(bus, plan.baud), plan.servo.id)
    for plan in plans:
        if plan.baud is not None:
            eeprom.write(at_baud(bus, plan.baud), plan.changes)


def at_baud(bus: Bus, baud: int) -> Bus:
    """The bus at that speed."""
    if bus.port.baud != baud:
        bus.port.set_baud(baud)
        bus.settle()
    return bus


def _plan(bus: Bus, servo: DumpedServo, bauds: Sequence[int], *, mark: bool) -> ServoPlan:
    ping, baud = _find(bus, servo, bauds)
    if ping is None:
        return ServoPlan(servo, None)
    if ping.model_number != servo.model_number:
        known = SERVOS_BY_NUMBER.get(ping.model_number)
        raise RestoreError(
            f"servo {servo.id}: model", found=known.name if known else f"model number {ping.model_number}",
            expected=f"{servo.model} as in the file", remedy="this is another servo or another arm",
        )  # fmt: skip
    eeprom.require_torque_off(bus, servo.id)
    found = eeprom.read(bus, servo.id, eeprom.writable(servo.servo_model))
    changes = eeprom.differences(servo.id, servo.servo_model, found, servo.registers)
    for change in changes:
        _refuse_impossible(change)
    absent = tuple(name for name in servo.registers if name not in found)
    left = tuple(change for change in changes if change.register.name == MOVING_THRESHOLD.name and not mark)
    return ServoPlan(servo, baud, tuple(change for change in changes if change not in left), absent, left)


def _refuse_impossible(change: RegisterChange) -> None:
    """A servo may hold a value that the manual does not know, but only one that it knows can be written."""
    low, high = change.register.minimum or 0, change.register.maximum or 0
    if not low <= change.wanted <= high:
        raise RestoreError(
            f"servo {change.servo_id}: {change.register.name} in the file",
            found=change.wanted,
            expected=f"{low} to {high}",
            remedy="correct the file",
        )


def _find(bus: Bus, servo: DumpedServo, bauds: Sequence[int]) -> tuple[Ping | None, int]:
    """Where the servo answers: first at the speed of the file.  Raises NoReplyError when two answer at once."""
    for baud in (servo.baud, *(b for b in bauds if b != servo.baud)):
        try:
            return at_baud(bus, baud).ping(servo.id, attempts=2), baud
        except NoReplyError as error:
            if error.damaged:
                raise
    return None, servo.baud
