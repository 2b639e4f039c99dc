"""What the driver must know of one arm, as frozen data; `agent.config` builds it from the cell file.

Torques, angles and speeds are those of the joint; the direction of a joint is that of its servos' own reported
direction (Drive Mode reverse bit), so no sign is needed anywhere else.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from itertools import pairwise

from drivers.dynamixel.servo.codes import MAX_ID, OperatingMode
from drivers.dynamixel.servo.counts import TICKS_PER_TURN
from drivers.dynamixel.servo.models import SERVOS, ServoModel
from drivers.dynamixel.servo.units import watchdog_count, watchdog_s
from drivers.fingers import Fingers
from drivers.interface import ConnectError

WATCHDOG_S = 0.2  # without `read` or `write` for so long, the servos of an arm stop by themselves


class MapError(ConnectError):
    """The arm map contradicts itself or asks of a servo what it cannot do."""


class JointRole(enum.Enum):
    """What the driver does with a joint."""

    CONTROLLED = "controlled"  # takes torque, part of JointState
    HELD = "held"  # keeps the place it had when torque came on, with limited effort
    GRIPPER = "gripper"  # held as well


@dataclass(frozen=True, slots=True)
class JointMap:
    """One joint and the servos that move it; the second ID follows the first by Secondary ID and is never commanded."""

    name: str
    servo: str  # key of `models.SERVOS`
    ids: tuple[int, ...]
    reverse: tuple[bool, ...]  # expected Drive Mode reverse bit of each
    zero_tick: int = 2048  # Present Position at joint angle 0
    position_limit_ticks: tuple[int, int] = (0, 4095)
    role: JointRole = JointRole.CONTROLLED
    tau_max_Nm: float = 0.0  # controlled joints: the largest torque ever sent
    torque_constant_Nm_per_A: float | None = None  # of one servo; None: the servo model's
    no_load_current_A: float = (
        0.0  # of one servo, added in the direction of motion; 0 when the controller does friction
    )
    start_rad: float | None = None  # expected at `enable`; None: anywhere within the limits
    start_tolerance_rad: float = 0.15
    at_rest: bool = False  # start_rad is where the joint lies while the arm rests
    hold_effort: float = 0.4  # held joints: share of stall torque; where no current is sensed, of the full voltage
    fingers: Fingers | None = None  # of a gripper that can be closed on an object
    grip_effort: float = 0.0  # of such a gripper: share with which it moves and grips

    @property
    def model(self) -> ServoModel:
        """Ratings and registers of this joint's servos."""
        return SERVOS[self.servo]

    @property
    def mode(self) -> OperatingMode:
        """Operating mode the servos of this joint run in."""
        if self.role is JointRole.CONTROLLED:
            return OperatingMode.CURRENT if self.model.has_current_mode else OperatingMode.PWM
        current_based = OperatingMode.CURRENT_BASED_POSITION
        return current_based if current_based in self.model.modes else OperatingMode.POSITION


@dataclass(frozen=True, slots=True)
class Mark:
    """What tells an arm from others of its make: a number that each of its servos keeps (`table.MOVING_THRESHOLD`).

    others: marks of the cell's other arms, with their names.
    """

    arm: str = ""
    own: int | None = None  # None: any but those of others
    others: tuple[tuple[int, str], ...] = ()

    @property
    def known(self) -> bool:
        """Whether there is anything to compare with."""
        return self.own is not None or bool(self.others)

    @property
    def wanted(self) -> str:
        """What a servo of the arm is to have, for a person."""
        return "that of no other arm" if self.own is None else f"{self.own}, arm {self.arm}'s"

    def fits(self, found: int) -> bool:
        """Whether a servo with that number can be one of the arm's."""
        return self.owner(found) is None if self.own is None else found == self.own

    def owner(self, found: int) -> str | None:
        """The other arm that has that number; None: no other arm of the cell."""
        return next((arm for mark, arm in self.others if mark == found), None)


UNMARKED = Mark()


@dataclass(frozen=True, slots=True)
class ServoSlot:
    """One physical servo of the arm."""

    servo_id: int
    joint: JointMap
    shadow: bool
    reverse: bool
    mark: Mark = UNMARKED

    @property
    def model(self) -> ServoModel:
        """Ratings and registers."""
        return self.joint.model

    @property
    def title(self) -> str:
        """What a person calls it, e.g. "servo 3 (shoulder shadow)"."""
        return f"servo {self.servo_id} ({self.joint.name}{' shadow' if self.shadow else ''})"


@dataclass(frozen=True, slots=True)
class ArmMap:
    """One arm on one port.  Raises MapError when it contradicts itself."""

    arm: str
    port: str
    baud: int
    rate_hz: float
    joints: tuple[JointMap, ...]  # base to tip, the gripper last; controlled ones in the order of the cell file
    watchdog_s: float = WATCHDOG_S
    line_patience_cycles: int = 0  # without any answer that are no silence yet: of emulated servos, whose host stalls
    mark: Mark = UNMARKED

    def __post_init__(self) -> None:
        ids = [servo_id for joint in self.joints for servo_id in joint.ids]
        self._need(
            len(set(ids)) == len(ids) and all(0 <= i <= MAX_ID for i in ids),
            "servo IDs", ids, f"different IDs from 0 to {MAX_ID}", "give every servo its own ID in the arm file",
        )  # fmt: skip
        names = [joint.name for joint in self.joints]
        self._need(
            len(set(names)) == len(names) and bool(self.controlled),
            "joints", names, "different names, at least one controlled", "correct the arm file or `controlled`",
        )  # fmt: skip
        count = watchdog_count(self.watchdog_s)
        self._need(
            1 <= count <= 127 and math.isclose(watchdog_s(count), self.watchdog_s),
            "watchdog_s", self.watchdog_s, "a multiple of 0.02 from 0.02 to 2.54", "0.2 suits a loop of 50 Hz or more",
        )  # fmt: skip
        self._need(
            self.rate_hz * self.watchdog_s > 2.0,
            "rate_hz", self.rate_hz, f"above {2.0 / self.watchdog_s:g} with this watchdog", "raise rate or watchdog_s",
        )  # fmt: skip
        for joint in self.joints:
            self._check_joint(joint)

    def _check_joint(self, joint: JointMap) -> None:
        what = f"joint {joint.name}"
        self._need(
            joint.servo in SERVOS and SERVOS[joint.servo].protocol == 2.0,
            f"{what}: servo", joint.servo,
            "one of " + ", ".join(name for name, model in SERVOS.items() if model.protocol == 2.0),
            "this driver speaks Protocol 2.0 only; an MX-28 or MX-64 can be re-flashed to 2.0",
        )  # fmt: skip
        self._need(
            len(joint.ids) == len(joint.reverse) and joint.ids != (),
            f"{what}: ids and reverse", (joint.ids, joint.reverse), "one entry per servo", "correct the arm file",
        )  # fmt: skip
        low, high = joint.position_limit_ticks
        self._need(
            low < high and high - low < TICKS_PER_TURN,
            f"{what}: position_limit_ticks", (low, high), "low < high, less than a turn apart",
            "an absolute encoder cannot tell turns apart",
        )  # fmt: skip
        self._need(
            0.0 < joint.hold_effort <= 1.0,
            f"{what}: hold_effort", joint.hold_effort, "above 0, at most 1", "0.4 holds a resting arm",
        )  # fmt: skip
        if joint.fingers is not None:
            self._need(
                joint.role is JointRole.GRIPPER and 0.0 < joint.grip_effort <= 1.0,
                f"{what}: grip_effort", joint.grip_effort, "above 0, at most 1, of a gripper",
                "0.25 holds light objects for long",
            )  # fmt: skip
        if joint.role is JointRole.CONTROLLED:
            self._check_torque(what, joint)

    def _check_torque(self, what: str, joint: JointMap) -> None:
        model = joint.model
        self._need(
            model.has_current_mode or OperatingMode.PWM in model.modes,
            f"{what}: servo", joint.servo, "one with current or PWM mode", "hold this joint instead",
        )  # fmt: skip
        stall = model.stall_torque_Nm * len(joint.ids)
        self._need(
            math.isfinite(joint.tau_max_Nm) and 0.0 < joint.tau_max_Nm <= stall,
            f"{what}: tau_max_Nm", joint.tau_max_Nm, f"above 0, at most the stall torque {stall:.3g}",
            "lower safety.tau_max_fraction_of_stall",
        )  # fmt: skip

    def _need(self, holds: bool, what: str, found: object, expected: str, remedy: str) -> None:
        if not holds:
            raise MapError(f"arm {self.arm}: {what}", found=found, expected=expected, remedy=remedy)

    @property
    def period_ns(self) -> int:
        """Control period."""
        return round(1e9 / self.rate_hz)

    @property
    def controlled(self) -> tuple[JointMap, ...]:
        """Joints of JointState, in its order."""
        return tuple(joint for joint in self.joints if joint.role is JointRole.CONTROLLED)

    @property
    def gripper(self) -> JointMap | None:
        """The gripper, if it can be closed on an object."""
        return next((joint for joint in self.joints if joint.fingers is not None), None)

    @property
    def slots(self) -> tuple[ServoSlot, ...]:
        """All physical servos, shadows right behind the servo they follow."""
        return tuple(
            ServoSlot(servo_id, joint, place > 0, reverse, self.mark)
            for joint in self.joints
            for place, (servo_id, reverse) in enumerate(zip(joint.ids, joint.reverse, strict=True))
        )

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """Servo IDs (followed, shadow) that move one joint together."""
        return tuple(pair for joint in self.joints for pair in pairwise(joint.ids))
