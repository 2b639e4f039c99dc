"""One servo of an arm as it was read, and the form of a rule about it.  Data; `judge` has the rules."""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from drivers.dynamixel.arm_map import ServoSlot
from drivers.dynamixel.servo.table import CURRENT_LIMIT, PWM_LIMIT, Register
from drivers.dynamixel.servo.wanted import kept_ram, run_values


@dataclass(frozen=True, slots=True)
class RegisterChange:
    """One register that is not as wanted, and will be written."""

    servo_id: int
    register: Register
    found: int
    wanted: int

    @property
    def line(self) -> str:
        """The difference for a person."""
        return f"servo {self.servo_id}: {self.register.name}: found {self.found}, wanted {self.wanted}"


@dataclass(frozen=True, slots=True)
class ServoFound:
    """One servo of an arm as it was read; `values` by register name."""

    slot: ServoSlot
    model_number: int
    firmware: int
    values: Mapping[str, int]

    def value(self, register: Register) -> int:
        """Value of a register.  KeyError when this servo does not have it."""
        return self.values[register.name]

    @property
    def fast(self) -> bool:
        """True when it answers fast sync reads."""
        return self.slot.model.answers_fast(self.firmware)

    @property
    def goal_limit(self) -> int:
        """EEPROM limit of the goal that carries this servo's effort."""
        return self.value(CURRENT_LIMIT if self.slot.model.has_current_mode else PWM_LIMIT)

    @property
    def changes(self) -> list[RegisterChange]:
        """EEPROM registers that the driver must write before this servo can do its part."""
        now = [(register, self.value(register), wanted) for register, wanted in run_values(self.slot).items()]
        return [RegisterChange(self.slot.servo_id, r, found, wanted) for r, found, wanted in now if found != wanted]

    @property
    def ram(self) -> dict[Register, int]:
        """RAM registers that must hold this before it gets torque."""
        limit = self.value(PWM_LIMIT)
        return {register: limit if wanted is None else wanted for register, wanted in kept_ram(self.slot).items()}


class Consequence(enum.Enum):
    """What follows from a rule that does not hold."""

    NO_CONNECTION = "connect refuses the arm"
    NO_TORQUE = "enable refuses the arm; until then it may be read"
    MOVE_FIRST = "enable refuses the arm until somebody has moved it by hand"
    MENDED = "the driver writes the right value; somebody left another"
    ROUTINE = "the driver writes the right value, as it does at each first start"
    TOLERATED = "the arm runs, less well or less safely"


class Said(NamedTuple):
    """What a rule says of a servo that breaks it."""

    found: str
    expected: str
    remedy: str


Check = Callable[[ServoFound], Said | None]


@dataclass(frozen=True, slots=True)
class Rule:
    """One thing that must hold of a servo; `check` is asked only where all of `registers` are known."""

    name: str
    registers: tuple[Register, ...]
    consequence: Consequence
    check: Check


@dataclass(frozen=True, slots=True)
class Misfit:
    """A rule that one servo breaks."""

    rule: Rule
    slot: ServoSlot
    said: Said

    @property
    def what(self) -> str:
        """Which servo and which rule, for a person."""
        return f"{self.slot.title}: {self.rule.name}"
