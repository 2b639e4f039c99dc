"""The seam between control and arms: what every driver promises.  Imports nothing of ours."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
END_STOP_RAD = (
    0.03  # beyond a joint's limit: zeros are off by less, and an arm at an end stop is still one to start with
)


def one_line(text: str) -> str:
    """The text with a space for every line break and tab, and a mark for whatever else cannot be printed."""
    return "".join(c if c.isprintable() else " " if c.isspace() else "\ufffd" for c in text)


class Refusal(Exception):
    """Something is not as it must be; says what was found, what was expected and what to do, in one line.

    Every error of this project that is meant for a person derives from it.  Decisions are made on the
    type and the attributes, never on the text.
    """

    exit_code = 2

    def __init__(self, what: str, *, found: object, expected: object, remedy: str) -> None:
        super().__init__(one_line(f"{what}: found {found}, expected {expected}; {remedy}"))
        self.what = what
        self.found = found
        self.expected = expected
        self.remedy = remedy

    @property
    def lines(self) -> list[str]:
        """What a person is to read: one line, or one for each of several things that are wrong at once."""
        return [str(self)]


class DriverError(Refusal):
    """Base of all errors a driver raises."""

    exit_code = 3


class ConnectError(DriverError):
    """The arm cannot be reached, or is not the arm the cell file describes; torque was never on."""


class StaleStateError(DriverError):
    """This cycle brought no fresh state; the caller must not reuse the last one as new."""


class WaitEnded(StaleStateError):
    """The driver waited for others, as in simulation, and somebody asked this arm for something: nothing is wrong."""


class ServoFault(DriverError):
    """A servo reported an error, lost torque or rebooted.

    `state` is the fresh state that the other servos still gave, for a loop that holds the object with them; None where
    none of them can hold anything.
    """

    state: JointState | None = None


@dataclass(frozen=True, slots=True)
class ArmInfo:
    """What `connect` found; all sequences in the joint order of the cell file (controlled joints only)."""

    arm: str
    joints: tuple[str, ...]
    tau_max_Nm: Vector  # (n,) largest torque the driver will ever send per joint
    description: str  # one line for logs: "simulated plant at …", "U2D2 FT3WJ… 9 servos, firmware 45"


@dataclass(frozen=True, slots=True)
class JointState:
    """One fresh sample of the controlled joints.  Arrays belong to the receiver and are not reused by the driver."""

    stamp_ns: int  # driver clock at sampling
    q: Vector  # (n,) rad
    dq: Vector  # (n,) rad/s, as the servos report it
    tau: Vector  # (n,) N·m estimated from present current; NaN where the servo cannot tell


@dataclass(frozen=True, slots=True)
class ServoHealth:
    """Slow quantities of each servo of the arm (m,), in the order of the bus; m = 0 for a driver without servos.

    NaN where a value is not known, or where the servo senses no such thing.
    """

    stamp_ns: int
    servo_ids: tuple[int, ...]
    joints: tuple[str, ...]  # that each servo moves, controlled or not
    temperature_C: Vector
    voltage_V: Vector
    error_bits: NDArray[np.uint8]
    current_A: Vector  # present current, signed as the servo counts
    load: Vector  # present load as a share of the largest, of servos without a current sensor
    temperature_limit_C: Vector  # at which the servo switches itself off
    voltage_min_V: Vector  # between which its supply is to be
    voltage_max_V: Vector
    stall_current_A: Vector  # at the rated voltage
    slow_ns: NDArray[np.int64]  # when temperature and voltage were last read; twice the same: nothing new is known

    @classmethod
    def none(cls, stamp_ns: int) -> ServoHealth:
        """Of a driver that has no servos to ask."""
        nothing = np.zeros(0)
        return cls(
            stamp_ns, (), (), nothing, nothing, np.zeros(0, np.uint8), nothing, nothing, nothing, nothing, nothing,
            nothing, np.zeros(0, np.int64),
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class GripState:
    """What a gripper's servo said in the last cycle."""

    stamp_ns: int
    width_m: float  # between the fingers
    speed_m_per_s: float  # of the width
    effort: float  # share of the servo's largest, positive while it closes
    force_N: float  # of each finger, as the effort lets expect; the friction of the gear is not in it
    width_cmd_m: float = math.nan  # that it was told to go to; NaN while it was told nothing
    force_max_N: float = math.nan  # of each finger, with the effort that bounds it


@dataclass(slots=True)
class BusCounters:
    """Cumulative since the first `connect`; read every cycle, so plain integers."""

    timeouts: int = 0
    corrupt: int = 0  # wrong CRC, wrong length, wrong ID
    alerts: int = 0
    retries: int = 0
    per_servo: dict[int, int] = field(default_factory=dict)


@runtime_checkable
class Gripper(Protocol):
    """The gripper of one arm, beside its `Driver`; between `enable` and `disable` of that."""

    def grip(self, width_m: float) -> None:
        """Go to this width with the next `write`, as hard as the arm file allows, and keep at it.

        What is wider is held with that effort.  Raises DriverError where the arm has no such gripper.
        """
        ...

    def grip_state(self) -> GripState | None:
        """Return what the last cycle said of it; None when it said nothing.  Never touches the bus."""
        ...


class Clock(Protocol):
    """The time that an arm's loop goes by.  Real: CLOCK_MONOTONIC.  Simulated: the plant's time."""

    @property
    def utc_offset_ns(self) -> int:
        """UTC minus this clock: one number for all who share the clock, so that stamps of one instant are equal."""
        ...

    def now_ns(self) -> int:
        """Nanoseconds; never goes back."""
        ...

    def sleep_until(self, deadline_ns: int) -> None:
        """Return at or after `deadline_ns`; at once when it has passed."""
        ...


class Driver(Protocol):
    """One arm.  N·m, rad, rad/s, joint order of the cell file.

    Order of calls: `connect`, `enable`, then per cycle `read` and `write`, then `disable`, `close`.
    No implementation ever replaces another silently.
    """

    @property
    def counters(self) -> BusCounters:
        """Counts since the first `connect`, always up to date."""
        ...

    def connect(self) -> ArmInfo:
        """Open the bus, check that this is the arm the cell describes.  Torque stays as it is.

        Raises ConnectError.
        """
        ...

    def enable(self) -> None:
        """Write zero goal torque, arm the servo watchdog, then switch torque on; in this order.  Raises DriverError."""
        ...

    def read(self) -> JointState:
        """Return a fresh, stamped state, or raise StaleStateError; never an old value as new."""
        ...

    def write(self, tau_Nm: Vector) -> Vector:
        """Command joint torques (n,); return what was really commanded after quantisation and limits."""
        ...

    def health(self) -> ServoHealth:
        """Return the latest slow quantities; never waits for the bus."""
        ...

    def disable(self) -> None:
        """Torque off.  Safe in any state, twice, and on a dead bus."""
        ...

    def close(self) -> None:
        """Give the port back.  Safe in any state and twice."""
        ...


@runtime_checkable
class Recovering(Protocol):
    """What a driver offers beside `Driver` whose arm can stop listening and come back, without a new `enable`."""

    @property
    def lapsed(self) -> bool:
        """True while the port is gone, or the arm has stopped by itself and nothing else is wrong with its torque."""
        ...

    def recover(self) -> bool:
        """Open the port again where it is gone, make sure of the arm, and let it obey again; for a loop that holds.

        Nothing is written before every servo has answered as the one it was, with its torque on.  True when the arm
        obeys anew: its torque is then zero, and must be commanded at once.  False when it never stopped, as a whole or
        in part.  Raises ServoFault when the arm is lost: it has no torque, and gets none by itself.  Raises another
        DriverError, quickly where nobody answers, when it may be tried again.
        """
        ...
