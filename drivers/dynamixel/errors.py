"""What can go wrong on a servo bus, as types with the facts in attributes."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from typing import TYPE_CHECKING

from drivers.dynamixel.servo.codes import HardwareError, StatusError
from drivers.interface import ConnectError, DriverError, JointState, ServoFault, StaleStateError

if TYPE_CHECKING:
    from drivers.dynamixel.arm_map import ServoSlot

NO_ERROR = HardwareError(0)


def hardware_names(bits: HardwareError) -> str:
    """Error bits in words."""
    return ", ".join(bit.name or hex(bit) for bit in bits) or f"{int(bits):#04x}"


class PortError(ConnectError):
    """The serial port cannot be used as asked."""


class PortLostError(StaleStateError):
    """The port was there and is gone: unplugged, or the other end of the pty closed."""


class WriteTimeoutError(DriverError):
    """The port took no more bytes before the deadline."""


class Heard(enum.Enum):
    """What came instead of the answer to a request, the most telling last."""

    NOTHING = "nothing"
    NOISE = "bytes that are no packet"
    ECHO = "only an echo of the request"
    OTHER = "only answers to other requests"
    DAMAGED = "damaged packets"

    @property
    def rank(self) -> int:
        """How telling it is."""
        return list(Heard).index(self)


_AFTER_HEARING = {
    Heard.NOTHING: "check the servo's cable, its 12 V supply, the baud rate and that its ID is unique",
    Heard.NOISE: "check the baud rate, the cable and its shield, and that nobody else talks on this bus",
    Heard.ECHO: "the adapter returns what is sent, and no servo answers: check the cable and the 12 V supply",
    Heard.OTHER: "the adapter holds old answers back, or another program talks on this bus: stop it, unplug and plug",
    Heard.DAMAGED: "two servos may share this ID; if it is not that, check plugs, cable and adapter",
}


class NoReplyError(DriverError):
    """A servo did not answer, or not intact, in all attempts; `heard`: the most telling of what came instead."""

    def __init__(self, servo_id: int, what: str, *, attempts: int, heard: Heard) -> None:
        super().__init__(
            f"servo {servo_id}: {what}",
            found=f"{heard.value} in {attempts} attempts",
            expected="an intact reply",
            remedy=_AFTER_HEARING[heard],
        )
        self.servo_id = servo_id
        self.heard = heard

    @property
    def damaged(self) -> bool:
        """True when something came that was an answer once, as when two servos share an ID."""
        return self.heard is Heard.DAMAGED


class RejectedError(DriverError):
    """A servo answered that it will not do what it was told."""

    def __init__(self, servo_id: int, what: str, code: int) -> None:
        name = StatusError(code).name if code in StatusError.__members__.values() else f"code {code}"
        super().__init__(
            f"servo {servo_id}: {what}",
            found=f"refused with {name}",
            expected="accepted",
            remedy="ACCESS: torque is on or the register is read-only; DATA_RANGE: outside the servo's own limits, "
            "or its bus watchdog has fired",
        )
        self.servo_id = servo_id
        self.code = code


class RearmError(DriverError):
    """Watchdogs that had fired could not be armed again, as where a packet got lost; it may be tried again."""

    @classmethod
    def of(cls, fault: ServoFault) -> RearmError:
        """What a servo did not take."""
        remedy = "it is tried again until the arm is given up; check cable and supply, and run `coop doctor`"
        return cls(fault.what, found=fault.found, expected=fault.expected, remedy=remedy)


class NotEnabledError(DriverError):
    """A call that needs another state of the driver."""


class NoGripperError(DriverError):
    """The arm has no gripper that this driver can close on an object."""


class TorqueError(DriverError):
    """A torque that is no number."""

    @classmethod
    def of(cls, arm: str, wanted: Sequence[float], joints: int) -> TorqueError:
        """Torques that an arm was to be commanded."""
        return cls(
            f"arm {arm}: torque",
            found=wanted,
            expected=f"{joints} finite numbers",
            remedy="this is a defect of the caller: the safety layer must not let it through",
        )


class StaleJointsError(StaleStateError):
    """Some joints brought no fresh state this cycle.

    joints: names of the controlled joints without a fresh value, in order; servo_ids: all servos that gave none;
    partial: the fresh part, NaN for the joints in `joints` (None when nothing at all is fresh).
    """

    def __init__(
        self, *, joints: Sequence[str], servo_ids: Sequence[int], partial: JointState | None, reason: str
    ) -> None:
        servos = ", ".join(map(str, servo_ids))
        super().__init__(
            "joint state",
            found=f"{reason} from servo {servos} (joint {', '.join(joints) or 'none controlled'})",
            expected="a fresh value of every joint in this cycle",
            remedy="single ones are noise; if they persist check cable and supply, and run `coop doctor`",
        )
        self.joints = tuple(joints)
        self.servo_ids = tuple(servo_ids)
        self.partial = partial


class FaultCause(enum.Enum):
    """What a servo fault is."""

    HARDWARE_ERROR = "hardware error"
    TORQUE_LOST = "torque is off"
    REBOOTED = "rebooted: its RAM registers are back at their defaults"
    WATCHDOG_TRIPPED = "its bus watchdog has fired and it ignores goals"
    GOAL_IGNORED = "its goal register does not hold what was sent"
    NO_EFFECT = "its current does not follow the goal"
    POSITION_JUMP = "its position moved faster than the joint can"
    SILENT = "does not answer"
    GARBLED = "no intact answer comes from it"
    OUTDATED = "no answer of this cycle comes from it"
    NOISE = "the line carries far more than was asked for"
    REFUSED_TORQUE = "torque could not be switched on"
    NOT_KEPT = "a register does not hold what was written"


_AFTER_FAULT = {
    FaultCause.HARDWARE_ERROR: "remove the cause; then only switching its supply off and on gives its torque back",
    FaultCause.REBOOTED: "its supply was away for a moment: check the 12 V supply and its cable",
    FaultCause.NOT_KEPT: "try again; if it persists its EEPROM is worn, or its firmware does not know the value",
    FaultCause.SILENT: "check its cable and those before it in the chain, and the 12 V supply",
    FaultCause.GARBLED: "answers are spoiled on the way: check the plugs and cables of the chain, and the adapter",
    FaultCause.NOISE: "check the adapter, the cable and its shield, and that nobody else talks on this bus",
    FaultCause.OUTDATED: "the adapter holds answers back or repeats them: unplug and plug it, or take another",
}
# what a cause makes plain that looked like something else before
_EXPLAINS = {
    FaultCause.REBOOTED: frozenset({
        FaultCause.SILENT, FaultCause.GARBLED, FaultCause.OUTDATED, FaultCause.NO_EFFECT, FaultCause.GOAL_IGNORED,
        FaultCause.POSITION_JUMP,
    }),
    FaultCause.HARDWARE_ERROR: frozenset({FaultCause.TORQUE_LOST, FaultCause.NO_EFFECT}),
    FaultCause.TORQUE_LOST: frozenset({FaultCause.NO_EFFECT}),
    FaultCause.OUTDATED: frozenset({FaultCause.SILENT}),  # an answer that is many cycles late is not there at first
    FaultCause.WATCHDOG_TRIPPED: frozenset({FaultCause.NO_EFFECT}),
}  # fmt: skip


class DxlServoFault(ServoFault):
    """A servo of this arm does not do its part; `state` is this cycle's fresh state if there is one."""

    def __init__(
        self,
        cause: FaultCause,
        *,
        servo_id: int,
        joint: str,
        found: str,
        expected: str,
        state: JointState | None = None,
        hardware: HardwareError = NO_ERROR,
        of_all: bool = False,
    ) -> None:
        """of_all: no servo of the arm has torque any more."""
        first = "support the object, for the arm holds nothing" if of_all else "hold or lower the arm"
        if cause is FaultCause.REFUSED_TORQUE:  # at the start alone, which then switches the others off again
            first = "the arm has no torque"
        super().__init__(
            f"servo {servo_id} ({joint}): {cause.value}",
            found=found,
            expected=expected,
            remedy=f"{first}; " + _AFTER_FAULT.get(cause, "then read the servo with `coop doctor`"),
        )
        self.cause = cause
        self.servo_id = servo_id
        self.joint = joint
        self.state = state
        self.hardware = hardware

    @classmethod
    def of(
        cls, cause: FaultCause, slot: ServoSlot, *, found: str, expected: str, hardware: HardwareError = NO_ERROR
    ) -> DxlServoFault:
        """Fault of a servo of the map."""
        return cls(
            cause, servo_id=slot.servo_id, joint=slot.joint.name, found=found, expected=expected, hardware=hardware
        )

    def among(self, known: Sequence[DxlServoFault]) -> tuple[list[DxlServoFault], list[DxlServoFault]]:
        """Known faults with this one, in the place of what it explains or at the end; and what it explains."""
        explained = [fault for fault in known if self.explains(fault)]
        if not explained:
            return [*known, self], []
        place = known.index(explained[0])
        return [*known[:place], self, *(f for f in known[place:] if f not in explained)], explained

    def explains(self, other: DxlServoFault) -> bool:
        """True when `other` is what this fault looked like before its cause was seen."""
        return self.servo_id == other.servo_id and other.cause in _EXPLAINS.get(self.cause, frozenset())

    def that_is_of_all(self) -> DxlServoFault:
        """Return the same of an arm whose other servos have no torque either, without a state to hold anything with."""
        return self._again(f"{self.found}, and no other servo of the arm has torque", None, of_all=True)

    def with_state(self, state: JointState) -> DxlServoFault:
        """Return the same fault with another cycle's state."""
        return self._again(str(self.found), state)

    def _again(self, found: str, state: JointState | None, *, of_all: bool = False) -> DxlServoFault:
        return DxlServoFault(
            self.cause,
            servo_id=self.servo_id,
            joint=self.joint,
            found=found,
            expected=str(self.expected),
            state=state,
            hardware=self.hardware,
            of_all=of_all,
        )
