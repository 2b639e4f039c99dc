"""What one cycle brings says about the servos (silent, jumping, without effect, at odds) and about a noisy line.

Thresholds are set so that no healthy arm reaches them: a false alarm lets N arms hold a load in mid-air.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

from drivers.dynamixel.arm_map import ArmMap, ServoSlot
from drivers.dynamixel.errors import DxlServoFault, FaultCause
from drivers.dynamixel.events import DriverEvent, EventKind, OncePerServo
from drivers.dynamixel.line.group import Row
from drivers.dynamixel.servo.codes import OperatingMode
from drivers.dynamixel.servo.units import AngleScale, current_unit_A, ticks_rad, velocity_count

SILENT_LIMIT_CYCLES = 8
LATE_LIMIT_CYCLES = 3  # the first that are silent cannot bring a late answer: there was none to come
NOISE_LIMIT_CYCLES = 5
NOISE_BYTES = 128  # beyond all that was asked for; an answer that came late is there once
NO_EFFECT_AFTER_S = 0.04
GOAL_WORTH_A = 0.15  # smaller goals may drown in what the servo does not resolve
ANSWER_WORTH_A = 0.01  # three counts: less is no current at all
PART = 0.5  # of its goal, or of the current that it stalls with: a slow servo on 9 V and at its hottest gives more
PART_S = 0.5
PART_WORTH_A = 0.3
PART_SPEED = 0.1  # of the no-load speed: so much less is what back-EMF takes
JUMP_SPEED = 1.25  # of the no-load speed at 12 V: what 14.8 V gives
JUMP_RAD = ticks_rad(4)
BELIEVED_SPEED = 1.6  # of the no-load speed at 12 V, of a speed that is read: somebody who pushes hard makes 1.4
PAIR_FIGHT_A = 0.2
PAIR_FIGHT_S = 0.1
PAIR_APART_RAD = ticks_rad(40)  # 3.5 degrees; backlash is 0.25


class SilenceCheck:
    """Counts cycles without an answer, per servo, and what came on the line instead."""

    def __init__(self, slots: Sequence[ServoSlot], line_patience: int = 0) -> None:
        """line_patience: cycles in a row without any answer that do not count."""
        self._slots = tuple(slots)
        self._line_patience, self._line = line_patience, 0
        self._missed = [0] * len(self._slots)
        self._damaged = self._late = 0  # cycles in a row in which such answers came

    def check(self, rows: Sequence[Row | None], *, damaged: bool, late: bool) -> list[DxlServoFault]:
        """Faults of servos that have given nothing for too long; damaged, late: answers of that kind came."""
        missed = self._missed
        self._damaged = self._damaged + 1 if damaged else 0
        self._late = self._late + 1 if late else 0
        if None not in rows:
            if any(missed):
                self._missed = [0] * len(missed)
            self._line = 0
            return []
        self._line = self._line + 1 if rows.count(None) == len(rows) else 0
        if 0 < self._line <= self._line_patience:
            return []
        found = []
        for place, row in enumerate(rows):
            missed[place] = missed[place] + 1 if row is None else 0
            if missed[place] >= SILENT_LIMIT_CYCLES:
                found.append(self._fault(self._slots[place], missed[place]))
        return found

    def _fault(self, slot: ServoSlot, missed: int) -> DxlServoFault:
        cause, instead = FaultCause.SILENT, ""
        if self._damaged >= SILENT_LIMIT_CYCLES:
            cause, instead = FaultCause.GARBLED, ", damaged packets in each"
        elif self._late >= LATE_LIMIT_CYCLES:
            cause, instead = FaultCause.OUTDATED, f", old answers in the last {self._late}"
        text = f"{missed} cycles without an answer{instead}"
        return DxlServoFault.of(cause, slot, found=text, expected="an answer every cycle")


class NoiseCheck:
    """Counts cycles in which the line carried far more than was asked for, though answers may still be read.

    Whoever babbles also speaks while goals are sent: they may get lost.
    """

    def __init__(self, first: ServoSlot, asked_bytes: int) -> None:
        """first: of the chain, for the line is no servo; asked_bytes: most that a healthy cycle brings."""
        self._first = first
        self._most = asked_bytes + NOISE_BYTES
        self._in_a_row = 0

    def check(self, heard_bytes: int) -> list[DxlServoFault]:
        """The line's fault, once enough cycles in a row have brought too much."""
        self._in_a_row = self._in_a_row + 1 if heard_bytes > self._most else 0
        if self._in_a_row < NOISE_LIMIT_CYCLES:
            return []
        text = f"{heard_bytes} bytes, too many in each of {self._in_a_row} cycles"
        return [DxlServoFault.of(FaultCause.NOISE, self._first, found=text, expected=f"at most {self._most} a cycle")]


class JumpCheck:
    """Position steps that the joint cannot make, for one joint."""

    def __init__(self, slot: ServoSlot) -> None:
        self.slot = slot
        self._speed = JUMP_SPEED * slot.model.no_load_rad_per_s
        self._last: tuple[int, float] | None = None
        self._jumped_rad = 0.0
        self.in_a_row = 0

    def begin(self, stamp_ns: int, angle_rad: float) -> None:
        """Go on from an angle that another process has believed."""
        self._last = (stamp_ns, angle_rad)

    def is_jump(self, stamp_ns: int, angle_rad: float) -> bool:
        """True when the angle cannot follow the last believed one; the angle is then not believed either.

        After a jump the next angle is believed only if it is back: nearer to the last believed one than to the jump.
        """
        if self._last is not None:
            last_ns, last_rad = self._last
            step = abs(angle_rad - last_rad)
            reach = self._speed * (stamp_ns - last_ns) * 1e-9 + JUMP_RAD
            if step > reach or (self.in_a_row and step >= abs(angle_rad - self._jumped_rad)):
                self.in_a_row += 1
                self._jumped_rad = angle_rad
                return True
        self.in_a_row = 0
        self._last = (stamp_ns, angle_rad)
        return False

    def fault(self) -> DxlServoFault:
        """What to say when it happens again."""
        text = f"a step to {self._jumped_rad:.3f} rad, {self.in_a_row} times in a row"
        expected = f"at most {self._speed:.1f} rad/s"
        return DxlServoFault.of(FaultCause.POSITION_JUMP, self.slot, found=text, expected=expected)


class SpeedCheck:
    """Speeds that the joint cannot have, of one joint: an answer that is intact may still say anything."""

    def __init__(self, slot: ServoSlot) -> None:
        self.slot = slot
        self._most = BELIEVED_SPEED * slot.model.no_load_rad_per_s
        self._found = 0.0
        self.in_a_row = 0

    def is_beyond(self, speed_rad_per_s: float) -> bool:
        """True for a speed that is not believed."""
        beyond = not abs(speed_rad_per_s) <= self._most
        self.in_a_row = self.in_a_row + 1 if beyond else 0
        if beyond:
            self._found = speed_rad_per_s
        return beyond

    def fault(self) -> DxlServoFault:
        """What to say when it happens again."""
        text = f"a speed of {self._found:.3g} rad/s, {self.in_a_row} times in a row"
        expected = f"at most {self._most:.1f} rad/s"
        return DxlServoFault.of(FaultCause.POSITION_JUMP, self.slot, found=text, expected=expected)


class EffectCheck:
    """Commanded against present current, for one servo in current mode."""

    def __init__(self, slot: ServoSlot, rate_hz: float) -> None:
        unit_A = current_unit_A(slot.model)
        self._slot = slot
        self._unit_A = unit_A
        self._worth = ceil(GOAL_WORTH_A / unit_A)
        self._none = int(ANSWER_WORTH_A / unit_A)
        self._slow = velocity_count(0.4 * slot.model.no_load_rad_per_s)
        self._limit = max(2, ceil(NO_EFFECT_AFTER_S * rate_hz))
        self._count = 0

    def check(self, goal: int, row: Row) -> DxlServoFault | None:
        """Compare the goal this servo had when it answered; near its no-load speed it cannot reach a goal."""
        if abs(goal) >= self._worth and abs(row[1]) <= self._none and abs(row[2]) <= self._slow:
            self._count += 1
            if self._count >= self._limit:
                found = f"{row[1] * self._unit_A:.3f} A for {self._count} cycles"
                expected = f"{goal * self._unit_A:.3f} A"
                return DxlServoFault.of(FaultCause.NO_EFFECT, self._slot, found=found, expected=expected)
        else:
            self._count = 0
        return None


class PartCheck:
    """Far less current than commanded, of one servo in current mode, where neither back-EMF nor supply explains it.

    It tells an event, never a fault: how exactly a real servo keeps a current is not known, and there is some torque.
    """

    def __init__(self, slot: ServoSlot, rate_hz: float) -> None:
        self._slot = slot
        self._unit_A = current_unit_A(slot.model)
        self._worth = ceil(PART_WORTH_A / self._unit_A)
        self._stall = slot.model.stall_current_A / self._unit_A
        self._slow = velocity_count(PART_SPEED * slot.model.no_load_rad_per_s)
        self._limit = max(2, ceil(PART_S * rate_hz))
        self._count = 0

    def check(self, goal: int, row: Row, tell: OncePerServo) -> None:
        """Compare the goal this servo had when it answered; small goals and fast joints say nothing either way."""
        if abs(goal) < self._worth or abs(row[2]) > self._slow:
            return
        short = row[1] * goal < PART * min(abs(goal), self._stall) * abs(goal)
        self._count = self._count + 1 if short else 0
        slot, found = self._slot, self._count >= self._limit
        if found or tell.is_active(EventKind.PART_OF_CURRENT, slot.servo_id):
            text = f"{row[1] * self._unit_A:.3f} A of {goal * self._unit_A:.3f} A, in {self._count} slow cycles"
            tell.tell(DriverEvent(EventKind.PART_OF_CURRENT, text, slot.servo_id, slot.joint.name), active=found)


class PairCheck:
    """A servo and its shadow: same direction of effort, same way travelled."""

    def __init__(self, followed: ServoSlot, shadow: ServoSlot, rate_hz: float) -> None:
        self._shadow = shadow
        self._scale = AngleScale(followed.joint)
        self._fight = ceil(PAIR_FIGHT_A / current_unit_A(shadow.model)) if shadow.model.has_current_mode else None
        self._limit = max(2, ceil(PAIR_FIGHT_S * rate_hz))
        self._fought = 0
        self._first_gap_rad: float | None = None

    def check(self, followed: Row, shadow: Row, tell: OncePerServo) -> None:
        """Compare two fresh rows; tells events, never a fault: the joint still has torque."""
        slot = self._shadow
        gap = self._scale.angle_rad(shadow[3]) - self._scale.angle_rad(followed[3])
        if self._first_gap_rad is None:
            self._first_gap_rad = gap
        moved = abs(gap - self._first_gap_rad)
        apart = PAIR_APART_RAD < moved < 6.0  # a whole turn is the encoder's seam
        if apart or tell.is_active(EventKind.PAIR_APART, slot.servo_id):
            text = f"{moved:.3f} rad since the first reading"
            tell.tell(DriverEvent(EventKind.PAIR_APART, text, slot.servo_id, slot.joint.name), active=apart)
        if self._fight is None:
            return
        opposed = followed[1] * shadow[1] < 0 and min(abs(followed[1]), abs(shadow[1])) >= self._fight
        self._fought = self._fought + 1 if opposed else 0
        fighting = self._fought >= self._limit
        if fighting or tell.is_active(EventKind.PAIR_FIGHTING, slot.servo_id):
            text = f"{followed[1]} against {shadow[1]} counts of current"
            tell.tell(DriverEvent(EventKind.PAIR_FIGHTING, text, slot.servo_id, slot.joint.name), active=fighting)


def effect_checks(arm: ArmMap) -> dict[int, tuple[EffectCheck, PartCheck]]:
    """Checks of the servos whose current is commanded (of controlled joints alone), by place in `ArmMap.slots`."""
    return {
        place: (EffectCheck(slot, arm.rate_hz), PartCheck(slot, arm.rate_hz))
        for place, slot in enumerate(arm.slots)
        if slot.joint.mode is OperatingMode.CURRENT
    }
