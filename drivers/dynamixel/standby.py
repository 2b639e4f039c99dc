"""A driver that goes on where another process has commanded an arm: torque stays on, no register is written first.

What `connect` would ask of the bus is told by that process beforehand (`Handover`), so that an arm without a master has
one again after a single exchange.  The marks that bring-up leaves in each servo's RAM tell this arm from any other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.driver import DynamixelDriver, Phase
from drivers.dynamixel.errors import DxlServoFault, FaultCause, PortLostError, WriteTimeoutError
from drivers.dynamixel.line.group import Row
from drivers.dynamixel.monitor import Page
from drivers.dynamixel.running import Running
from drivers.dynamixel.servo.codes import WATCHDOG_TRIPPED
from drivers.dynamixel.servo.found import ServoFound
from drivers.dynamixel.servo.units import watchdog_count
from drivers.interface import ConnectError, DriverError, JointState, Vector

ATTEMPTS = 3
ATTEMPT_NS = 12_000_000  # a reply that is not there by then was lost
QUIET_NS = 1_500_000  # the answer to the last question of the one before may still be on the line
QUIET_MAX_NS = 6_000_000


class AdoptError(ConnectError):
    """The arm is not as the process before has left it; nothing was commanded."""


@dataclass(frozen=True, slots=True)
class Handover:
    """What the process that has connected an arm found, for one that may have to go on with it."""

    servos: tuple[Mapping[str, Any], ...]  # servo_id, model_number, firmware, values by register name

    @classmethod
    def of(cls, driver: DynamixelDriver) -> Self:
        """Of a connected driver."""
        return cls(
            tuple(
                {
                    "servo_id": servo.slot.servo_id, "model_number": servo.model_number, "firmware": servo.firmware,
                    "values": dict(servo.values),
                }
                for servo in driver.found
            )
        )  # fmt: skip

    def servos_of(self, arm: ArmMap) -> list[ServoFound]:
        """The servos in the order of the map.  Raises AdoptError when they are not those of the map."""
        told = {int(servo["servo_id"]): servo for servo in self.servos}
        if sorted(told) != sorted(slot.servo_id for slot in arm.slots):
            expected = f"IDs {sorted(slot.servo_id for slot in arm.slots)}"
            raise AdoptError(
                f"servos of arm {arm.arm}", found=f"IDs {sorted(told)}", expected=expected,
                remedy="give both processes one cell file",
            )  # fmt: skip
        return [
            ServoFound(slot, int(one["model_number"]), int(one["firmware"]), dict(one["values"]))
            for slot in arm.slots
            for one in (told[slot.servo_id],)
        ]


class StandbyDriver(DynamixelDriver):
    """A driver for who neither connects nor enables: `prepare` while another process commands, then `adopt`.

    resumed: `adopt` found watchdogs that had fired, and armed them again; the arm has no torque then.
    limp: it found them, or nobody, and was not to arm them.
    """

    resumed = False
    limp = False

    def prepare(self, handover: Handover) -> None:
        """Make ready for `adopt`, without a byte on the bus; the port must be open.  Raises AdoptError."""
        self._found = handover.servos_of(self.arm)
        fast = all(servo.fast for servo in self._found)
        self._running = Running(self._bus, self.arm, self._found, self._clock, self._on_event, self._link, fast=fast)
        self._phase = Phase.CONNECTED

    def drop(self) -> None:
        """Nothing is this driver's alone: the port goes on to the next one."""

    def adopt(self, last: JointState | None, *, brings_back: bool = True) -> Vector:
        """Take the arm over with torque on; the joint torques (n,) its servos hold, NaN where one did not say.

        last: what the process before believed last; None: nothing.  An encoder that has jumped since, farther than its
        joint can have turned, is not believed here either.  Servos whose watchdog has fired meanwhile are armed again,
        without effort, if it `brings_back`: the caller must command at once.  Servos that do not answer, a port that is
        gone, and one servo without torque, with which they are not armed again, are the loop's affair, as in any cycle.
        Raises AdoptError when those that answer are not as `enable` left them.
        """
        running = self._need(Phase.CONNECTED)
        try:
            rows = self._ask()
        except (PortLostError, WriteTimeoutError):
            rows = {}
        self._refuse_strangers(rows)
        goals = {i: row[-1] for i, row in rows.items()}
        torques = running.resume(goals, [0.0] * len(self.arm.controlled) if last is None else last.dq.tolist())
        self._phase = Phase.ENABLED
        self._has_commanded = True
        # one that is off was being armed again: nothing would stop that servo
        tripped = [i for i, row in rows.items() if row[3] == WATCHDOG_TRIPPED or (row[0] and row[3] == 0)]
        held = np.array(torques)
        if not brings_back and (tripped or not rows):
            self.limp = True
        elif tripped and all(row[0] for row in rows.values()):
            held = self._brought_back(tripped[0], len(torques))
        if last is not None:
            self._need(Phase.ENABLED).begin(last)
        return held

    def _brought_back(self, servo_id: int, n: int) -> Vector:
        """Arm the watchdogs again, one of which is this servo's; where a packet gets lost the loop tries again."""
        try:
            self.rearm()
        except DriverError:
            slot = next(slot for slot in self.arm.slots if slot.servo_id == servo_id)
            armed = str(watchdog_count(self.arm.watchdog_s))
            found = f"Bus Watchdog {WATCHDOG_TRIPPED}"
            self.faults = [DxlServoFault.of(FaultCause.WATCHDOG_TRIPPED, slot, found=found, expected=armed)]
            return np.full(n, np.nan)
        self.resumed = True
        return np.zeros(n)

    def _ask(self) -> dict[int, Row]:
        """The status page of every servo that answers, by ID, asked again while one is missing."""
        ids = [slot.servo_id for slot in self.arm.slots]
        rows: dict[int, Row] = {}
        for _ in range(ATTEMPTS):
            self._quiet()
            rows |= self._bus.read_all(*Page.STATUS.value, ids, ATTEMPT_NS)
            ids = [i for i in ids if i not in rows]
            if not ids:
                break
        return rows

    def _quiet(self) -> None:
        limit_ns = self._clock.now_ns() + QUIET_MAX_NS
        while self._clock.now_ns() < limit_ns:
            if not self._port.read_until(self._clock.now_ns() + QUIET_NS):
                return

    def _refuse_strangers(self, rows: Mapping[int, Row]) -> None:
        """Raise AdoptError unless a servo that was given torque still has it, with the marks of this arm's bring-up."""
        controlled = {i for joint in self.arm.controlled for i in joint.ids}
        said = {i: row for i, row in rows.items() if i in controlled}
        if said and not any(_ours(row) for row in said.values()):
            found = ", ".join(f"servo {i}: torque {row[0]}, LED {row[1]}" for i, row in sorted(said.items()))
            raise AdoptError(
                f"arm {self.arm.arm}", found=found, expected="servos with torque on, as this arm was left",
                remedy="support the object: nothing holds it any more; start the arm again",
            )  # fmt: skip


def _ours(row: Sequence[int]) -> bool:
    """Whether torque is on and the mark of bring-up (the LED) is there; see `monitor.status_bytes`."""
    torque, led, *_ = row
    return torque == 1 and led == 1
