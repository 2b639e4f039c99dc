"""Faults on command: what goes wrong on which arm and servo, from when, for how long.

Data and schedule; injector.py carries them out.  The same seed gives the same faults.
"""

from __future__ import annotations

import math
import random
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated, Final

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import PydanticCustomError

from drivers import named_file
from drivers.interface import Refusal
from sim_backend.wire.bus import Tampered

LONGEST_S: Final = 1e6
SHOWN: Final = 80  # characters of what a command says, in a refusal
Seconds = Annotated[float, Field(ge=0.0, le=LONGEST_S)]


def _lasting(value: float) -> float:
    if LONGEST_S < value < math.inf:
        raise PydanticCustomError(
            "lasting", "at most {most} s; without the key it has no end", {"most": f"{LONGEST_S:g}"}
        )
    return value


class FaultError(Refusal):
    """A fault command that cannot be understood; nothing was changed."""


class FaultKind(Enum):
    """What goes wrong."""

    # replies on their way to the host
    DROP = "drop"
    CORRUPT = "corrupt"  # one bit flipped
    DELAY = "delay"  # by delay_ms
    DUPLICATE = "duplicate"
    # a servo
    SILENT = "silent"  # neither hears nor answers; keeps doing what it was told last
    MUTE = "mute"  # hears and obeys, does not answer
    OVERHEAT = "overheat"  # temperature goes to temperature_C within ramp_s
    OVERLOAD = "overload"
    ELECTRICAL_SHOCK = "electrical_shock"
    REBOOT = "reboot"
    POWER_LOSS = "power_loss"
    VOLTAGE = "voltage"  # supply goes to voltage_V within ramp_s
    ENCODER_STUCK = "encoder_stuck"
    ENCODER_OFFSET = "encoder_offset"  # position wrong by offset_ticks
    # the line and the port
    BABBLE = "babble"  # random bytes without end, at the adapter; of a servo: on the line, where nobody hears the host
    STALL = "stall"  # the adapter takes no more bytes
    PORT_LOSS = "port_loss"


REPLY_FAULTS = frozenset({FaultKind.DROP, FaultKind.CORRUPT, FaultKind.DELAY, FaultKind.DUPLICATE})


class Fault(BaseModel):
    """One fault.  Times count from when the command is given; `servo` None means all servos of the arm."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: FaultKind
    arm: str
    servo: Annotated[int, Field(ge=0, le=252)] | None = None
    start_s: Seconds = 0.0
    duration_s: Annotated[float, Field(ge=0.0), AfterValidator(_lasting)] = math.inf
    probability: Annotated[float, Field(ge=0.0, le=1.0)] = 1.0  # of each reply, for reply faults
    delay_ms: Annotated[float, Field(ge=0.0, le=1e6)] = 5.0
    temperature_C: Annotated[float, Field(ge=-50.0, le=255.0)] = 90.0
    voltage_V: Annotated[float, Field(ge=0.0, le=30.0)] = 8.0
    ramp_s: Seconds = 0.0
    offset_ticks: Annotated[int, Field(ge=-(2**20), le=2**20)] = 57  # 5 degrees

    @classmethod
    def parse(cls, line: str) -> Fault:
        """Read one JSON object, e.g. {"kind": "drop", "arm": "left", "servo": 3, "start_s": 1, "duration_s": 0.5}.

        Raises FaultError.
        """
        try:
            return cls.model_validate_json(line)
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(str(part) for part in first["loc"])
            raise FaultError(
                f"fault command: {key[:SHOWN] or 'line'}",
                found=repr(first["input"])[:SHOWN],
                expected=first["msg"],
                remedy=f"one JSON object per line with kind and arm, and maybe {', '.join(list(cls.model_fields)[2:])}",
            ) from error


def parse_lines(text: str) -> list[Fault]:
    """Faults of a command file, one JSON object per line; empty lines and lines starting with # are skipped.

    Raises FaultError.
    """
    lines = (line.strip() for line in text.splitlines())
    return [Fault.parse(line) for line in lines if line and not line.startswith("#")]


def require_known(faults: Iterable[Fault], servos: Mapping[str, Collection[int]]) -> None:
    """Raise FaultError for an arm or a servo that is not there; servos: IDs by arm."""
    for fault in faults:
        if fault.arm not in servos:
            raise FaultError(
                "fault command: arm", found=repr(fault.arm)[:SHOWN], expected=" or ".join(servos),
                remedy="name an arm of this cell",
            )  # fmt: skip
        if fault.servo is not None and fault.servo not in servos[fault.arm]:
            raise FaultError(
                f"fault command: servo of arm {fault.arm}", found=fault.servo,
                expected=f"one of {sorted(servos[fault.arm])}", remedy="name an ID of this arm",
            )  # fmt: skip


def read_lines(path: Path, servos: Mapping[str, Collection[int]]) -> list[Fault]:
    """Faults of the command file at `path`, all of servos that are there; servos: IDs by arm.

    Raises FaultError, which names the file.
    """
    try:
        faults = parse_lines(named_file.read(path).decode())
        require_known(faults, servos)
    except (OSError, ValueError) as error:  # no text, or a name with a zero byte
        raise FaultError(
            f"faults file {path}", found=error.strerror if isinstance(error, OSError) else "bytes that are no text",
            expected="a readable file, one JSON object per line", remedy="name another with --faults",
        ) from error  # fmt: skip
    except named_file.UnfitFile as error:
        raise FaultError(
            f"faults {error.what}", found=error.found, expected=error.expected, remedy=error.remedy
        ) from error
    except FaultError as error:
        raise FaultError(
            f"faults file {path}, {error.what}", found=error.found, expected=error.expected, remedy=error.remedy
        ) from error
    return faults


@dataclass(slots=True)
class Scheduled:
    """A fault with its times on the emulator's clock."""

    fault: Fault
    start_ns: int
    end_ns: float  # inf: for ever
    running: bool = False


class FaultSchedule:
    """Which faults run when."""

    def __init__(self) -> None:
        self._entries: list[Scheduled] = []

    @property
    def is_empty(self) -> bool:
        """Whether none runs and none is to come."""
        return not self._entries

    def add(self, faults: Iterable[Fault], now_ns: int) -> None:
        """Plan faults from now on."""
        for fault in faults:
            start_ns = now_ns + round(fault.start_s * 1e9)
            self._entries.append(Scheduled(fault, start_ns, start_ns + fault.duration_s * 1e9))

    def clear(self) -> list[Scheduled]:
        """Forget all faults; return those that were running."""
        running = [entry for entry in self._entries if entry.running]
        self._entries.clear()
        return running

    def running(self) -> list[Scheduled]:
        """Faults that are on."""
        return [entry for entry in self._entries if entry.running]

    def poll(self, now_ns: int) -> tuple[list[Scheduled], list[Scheduled]]:
        """Faults that begin and faults that end now."""
        if not self._entries:
            return [], []
        begin = [e for e in self._entries if not e.running and e.start_ns <= now_ns < e.end_ns]
        end = [e for e in self._entries if e.end_ns <= now_ns]
        missed = [e for e in end if not e.running and e.fault.duration_s == 0.0]
        for entry in begin:
            entry.running = True
        self._entries = [e for e in self._entries if e.end_ns > now_ns]
        return begin + missed, [e for e in end if e.running]


class ReplyTamper:
    """Reply faults of one bus: decides what becomes of each reply."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)
        self.active: Sequence[Fault] = ()

    def __call__(self, servo_id: int, data: bytes) -> list[Tampered]:
        """Return the appearances of one reply at the host."""
        out = [Tampered(data, 0)]
        for fault in self.active:
            if fault.servo not in (None, servo_id) or self._random.random() >= fault.probability:
                continue
            if fault.kind is FaultKind.DROP:
                return []
            if fault.kind is FaultKind.CORRUPT:
                out = [Tampered(self._flip(piece), extra_ns) for piece, extra_ns in out]
            elif fault.kind is FaultKind.DELAY:
                out = [Tampered(piece, extra_ns + round(fault.delay_ms * 1e6)) for piece, extra_ns in out]
            elif fault.kind is FaultKind.DUPLICATE:
                out = out + out
        return out

    def noise(self, count: int) -> bytes:
        """Random bytes."""
        return self._random.randbytes(count)

    def _flip(self, data: bytes) -> bytes:
        bit = self._random.randrange(8 * len(data))
        spoiled = bytearray(data)
        spoiled[bit // 8] ^= 1 << bit % 8
        return bytes(spoiled)
