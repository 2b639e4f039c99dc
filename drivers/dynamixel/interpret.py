"""One cycle's rows to the state of the joints, NaN where there is none, and what is wrong with the servos."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.dynamixel.arm_map import ArmMap, JointMap, ServoSlot
from drivers.dynamixel.checks import JumpCheck, PairCheck, SilenceCheck, SpeedCheck, effect_checks
from drivers.dynamixel.cycle import CycleRows
from drivers.dynamixel.errors import DxlServoFault
from drivers.dynamixel.events import OncePerServo
from drivers.dynamixel.line.group import Row
from drivers.dynamixel.servo.torque import TorqueDrive
from drivers.dynamixel.servo.units import AngleScale, velocity_rad_per_s
from drivers.interface import JointState

SPEED_LASTS_CYCLES = 3  # a lost answer or two change no speed by much; then a motor's own back-EMF may slow it down


@dataclass(slots=True)
class _Joint:
    joint: JointMap
    places: tuple[int, ...]  # of its servos in `ArmMap.slots`, the followed one first
    scale: AngleScale
    drive: TorqueDrive
    jump: JumpCheck
    speed: SpeedCheck


@dataclass(slots=True)
class Reading:
    """What a cycle brought: NaN in `state` for each joint in `stale`."""

    state: JointState
    stale: list[str]
    jumped: bool
    faults: list[DxlServoFault]


class Interpreter:
    """Keeps what must be remembered between cycles: the last speed, and the counts of the checks."""

    def __init__(self, arm: ArmMap, drives: Sequence[TorqueDrive], tell: OncePerServo) -> None:
        slots = arm.slots
        place_of = {slot.servo_id: place for place, slot in enumerate(slots)}
        self.dq = [0.0] * len(drives)  # speed of each joint for its back-EMF: see `SPEED_LASTS_CYCLES`
        self._unseen_cycles = [0] * len(drives)
        self._joints = []
        for joint, drive in zip(arm.controlled, drives, strict=True):
            places = tuple(place_of[servo_id] for servo_id in joint.ids)
            jump, speed = JumpCheck(slots[places[0]]), SpeedCheck(slots[places[0]])
            self._joints.append(_Joint(joint, places, AngleScale(joint), drive, jump, speed))
        self._silence = SilenceCheck(slots, arm.line_patience_cycles)
        self._effects = effect_checks(arm)
        self._pairs = [
            (place_of[a], place_of[b], PairCheck(slots[place_of[a]], slots[place_of[b]], arm.rate_hz))
            for a, b in arm.pairs
        ]
        self._tell = tell

    def read(self, cycle: CycleRows, goals: Sequence[int]) -> Reading:
        """State and faults of one cycle; goals: count each servo was last sent, by place."""
        rows = cycle.rows
        count = len(self._joints)
        q, dq, tau = [math.nan] * count, [math.nan] * count, [math.nan] * count
        stale: list[str] = []
        faults = self._silence.check(rows, damaged=cycle.damaged, late=cycle.late)
        jumped = False
        for index, entry in enumerate(self._joints):
            row = rows[entry.places[0]]
            if row is None:
                stale.append(entry.joint.name)
                self._unseen(index)
                continue
            angle = entry.scale.angle_rad(row[3])
            speed = velocity_rad_per_s(row[2])
            jumps, races = entry.jump.is_jump(cycle.stamp_ns, angle), entry.speed.is_beyond(speed)
            if jumps or races:
                jumped = True
                stale.append(entry.joint.name)
                self._unseen(index)
                faults += [check.fault() for check in (entry.jump, entry.speed) if check.in_a_row > 1]
                continue
            q[index] = angle
            self._unseen_cycles[index] = 0
            dq[index] = self.dq[index] = speed
            present = self._currents(entry, rows)
            if present is not None:
                tau[index] = entry.drive.measured_Nm(present, dq[index])
        for place, (effect, part) in self._effects.items():
            row = rows[place]
            if row is None:
                continue
            if (fault := effect.check(goals[place], row)) is not None:
                faults.append(fault)
            part.check(goals[place], row, self._tell)
        for first, second, pair in self._pairs:
            followed, shadow = rows[first], rows[second]
            if followed is not None and shadow is not None:
                pair.check(followed, shadow, self._tell)
        state = JointState(cycle.stamp_ns, np.array(q), np.array(dq), np.array(tau))
        return Reading(state, stale, jumped, faults)

    def begin(self, last: JointState) -> None:
        """Go on from the last state that another process has believed: an angle is judged by the one before it."""
        for entry, angle in zip(self._joints, last.q.tolist(), strict=True):
            entry.jump.begin(last.stamp_ns, angle)

    def doubted(self) -> DxlServoFault | None:
        """The first joint whose last angle or speed was not believed."""
        checks = (check for entry in self._joints for check in (entry.jump, entry.speed))
        return next((check.fault() for check in checks if check.in_a_row), None)

    def _unseen(self, index: int) -> None:
        """No speed of a joint in this cycle: a motor whose voltage is made up for an old one would push with it."""
        self._unseen_cycles[index] += 1
        if self._unseen_cycles[index] > SPEED_LASTS_CYCLES:
            self.dq[index] = 0.0

    @staticmethod
    def _currents(entry: _Joint, rows: Sequence[Row | None]) -> list[int] | None:
        """Currents of all servos of a joint; None when one is missing, for half a torque is no torque."""
        present = []
        for place in entry.places:
            row = rows[place]
            if row is None:
                return None
            present.append(row[1])
        return present


def servo_names(slots: Sequence[ServoSlot], rows: Sequence[Row | None]) -> list[int]:
    """IDs of the servos that gave no row."""
    return [slot.servo_id for slot, row in zip(slots, rows, strict=True) if row is None]
