"""What a connected arm needs from cycle to cycle, built once from what `connect` found."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.bringup import effort_register, efforts_at_rest, goal_limits
from drivers.dynamixel.budget import FAULT_WITHIN_S, LinkTiming, cycle_budget, health_servos_per_gap, round_of
from drivers.dynamixel.checks import NoiseCheck
from drivers.dynamixel.cycle import CycleReader, CycleRows
from drivers.dynamixel.errors import DxlServoFault, FaultCause
from drivers.dynamixel.events import DriverEvent, EventKind, EventSink, OncePerServo
from drivers.dynamixel.grip import GripControl
from drivers.dynamixel.identify import IdentityError
from drivers.dynamixel.interpret import Interpreter, Reading
from drivers.dynamixel.line.bus import BABBLE_BYTES, Bus
from drivers.dynamixel.line.group import GroupWrite, Row
from drivers.dynamixel.line.port import Now
from drivers.dynamixel.monitor import GapMonitor, ServoRecord
from drivers.dynamixel.servo.codes import ALERT_BIT, HardwareError
from drivers.dynamixel.servo.found import ServoFound
from drivers.dynamixel.servo.judge import MARK, MODEL, broken
from drivers.dynamixel.servo.table import (
    GOAL_CURRENT,
    GOAL_PWM,
    MAX_VOLTAGE_LIMIT,
    MIN_VOLTAGE_LIMIT,
    MOVING_THRESHOLD,
    PRESENT_INPUT_VOLTAGE,
    PRESENT_TEMPERATURE,
    SHUTDOWN,
    TEMPERATURE_LIMIT,
)
from drivers.dynamixel.servo.thermal import ThermalWatch
from drivers.dynamixel.servo.torque import torque_drive
from drivers.dynamixel.servo.units import current_or_load, volts, watchdog_count
from drivers.interface import GripState, JointState, ServoHealth


def _record(servo: ServoFound, watchdog: int, rest: int) -> ServoRecord:
    return ServoRecord(
        slot=servo.slot,
        goal=effort_register(servo.slot),
        watchdog=watchdog,
        shutdown=HardwareError(servo.value(SHUTDOWN)),
        voltage_limits_V=(volts(servo.value(MIN_VOLTAGE_LIMIT)), volts(servo.value(MAX_VOLTAGE_LIMIT))),
        thermal=ThermalWatch(float(servo.value(TEMPERATURE_LIMIT))),
        voltage_V=volts(servo.value(PRESENT_INPUT_VOLTAGE)),
        temperature_C=float(servo.value(PRESENT_TEMPERATURE)),
        sent=rest,
        sent_before=rest,
    )


class Running:
    """Reader, monitor, checks and writers of one arm, and the goals last sent."""

    def __init__(
        self,
        bus: Bus,
        arm: ArmMap,
        found: Sequence[ServoFound],
        clock: Now,
        on_event: EventSink,
        link: LinkTiming,
        *,
        fast: bool,
    ) -> None:
        self.fast = fast
        self._on_event = on_event
        self._made_of = (bus, arm, found, clock, on_event, link)
        self._bus = bus
        self._arm = arm
        self._clock = clock
        self._found = tuple(found)
        tell = OncePerServo(on_event)
        rest, limits = efforts_at_rest(found), goal_limits(found)
        watchdog = watchdog_count(arm.watchdog_s)
        self._records = [_record(servo, watchdog, rest[servo.slot.servo_id]) for servo in found]
        self._place_of = {record.slot.servo_id: place for place, record in enumerate(self._records)}
        self._drives = [torque_drive(joint, limits[joint.ids[0]]) for joint in arm.controlled]
        self._joint_records = [[self._records[self._place_of[i]] for i in joint.ids] for joint in arm.controlled]
        self.reader = CycleReader(bus, arm, clock, bus.counters, fast=fast, link=link)
        self._interpreter = Interpreter(arm, self._drives, tell)
        budget = cycle_budget(arm, fast=fast, link=link)
        per_gap = health_servos_per_gap(arm, budget, fast=fast, link=link)
        self.monitor = GapMonitor(self._records, per_gap, arm.baud, link, tell, fast=fast)
        self._noise = NoiseCheck(arm.slots[0], self.reader.answer_bytes + self.monitor.answer_bytes)
        self._write_ns = round(1e9 * budget.write_s)
        self._writers = self._make_writers()
        self.grip = GripControl.of(arm, limits)
        self._goals = [record.sent for record in self._records]
        self._health_heard = b""
        self._rows: list[Row | None] = [None] * len(self._records)  # of the last cycle
        self._wire_free_ns = 0
        self._known: set[tuple[FaultCause, int]] = set()
        turn = round_of(arm, fast=fast, link=link)
        if not turn.quick:
            takes, wanted = (f"{seconds * 1e3:.0f} ms" for seconds in (turn.seconds, FAULT_WITHIN_S))
            text = f"all servos once in {takes}, should be {wanted}; {turn.remedy}"
            on_event(DriverEvent(EventKind.SLOW_CHECKS, text))

    def again(self) -> Running:
        """The same arm, with nothing remembered but what is slow: goals at rest, no doubts, no counts."""
        made = Running(*self._made_of, fast=self.fast)
        for record, old in zip(made._records, self._records, strict=True):
            record.voltage_V, record.temperature_C, record.slow_ns = old.voltage_V, old.temperature_C, old.slow_ns
            record.thermal = old.thermal
        if made.grip is not None and self.grip is not None:
            made.grip.go_on(self.grip)
        return made

    def forget_trips(self) -> None:
        """Watchdogs that have fired, and no longer have: when they do again, that is new."""
        self._known = {(cause, i) for cause, i in self._known if cause is not FaultCause.WATCHDOG_TRIPPED}

    def _make_writers(self) -> list[tuple[GroupWrite, list[int]]]:
        """One packet per goal register, with the places of its joints; shadows follow by themselves."""
        writers = []
        for register in (GOAL_CURRENT, GOAL_PWM):
            joints = [j for j, drive in enumerate(self._drives) if drive.register is register]
            if joints:
                ids = [self._arm.controlled[j].ids[0] for j in joints]
                writers.append((GroupWrite(register.address, "h", ids), joints))
        return writers

    def begin(self, last: JointState) -> None:
        """Believe the first angles only where they can follow these, which another process has believed."""
        self._interpreter.begin(last)

    def resume(self, goals: Mapping[int, int], dq: Sequence[float]) -> list[float]:
        """Go on from the goal counts that the servos hold (by ID); the joint torques they ask for, NaN where unknown.

        dq: of the joints, rad/s, as last known.  Until the monitor has the supply, it is the one that bring-up found.
        """
        self.monitor.look_at_supply()
        for place, record in enumerate(self._records):
            count = goals.get(record.slot.servo_id, record.sent)
            record.sent = record.sent_before = self._goals[place] = count
        first = [records[0] for records in self._joint_records]
        return [
            drive.goal_Nm(record.sent, speed, record.voltage_V) if record.slot.servo_id in goals else math.nan
            for drive, record, speed in zip(self._drives, first, dq, strict=True)
        ]

    # --- read -----------------------------------------------------------------------------------------------------

    def hear_health(self) -> None:
        """Take what came since the last cycle: the health read's answer, or something to throw away.

        A loop that is ahead of its period waits here until the wire is free: to speak earlier would lose both.
        """
        port, clock, heard = self._bus.port, self._clock, b""
        while len(heard) < BABBLE_BYTES and (more := port.read_now()):
            heard += more
        self.monitor.answer(heard, clock.now_ns(), final=False)
        while self.monitor.awaited and clock.now_ns() < self._wire_free_ns and len(heard) < BABBLE_BYTES:
            heard += port.read_until(self._wire_free_ns)
            self.monitor.answer(heard, clock.now_ns(), final=False)
        self._health_heard = heard
        if len(heard) >= BABBLE_BYTES:
            self._bus.counters.stray_bytes += len(heard) + port.discard_input()

    def interpret(self, cycle: CycleRows, now_ns: int) -> Reading:
        """State of the joints, with the alerts and the last chance of a late health answer looked after."""
        self.monitor.answer(self._health_heard + cycle.heard, now_ns, final=True)
        self._rows = cycle.rows
        for record, row in zip(self._records, cycle.rows, strict=True):
            if row is not None and row[0] & ALERT_BIT:
                self._bus.counters.alerts += 1
                self.monitor.alert(record.slot.servo_id)
        reading = self._interpreter.read(cycle, self._goals)
        heard = len(self._health_heard) + len(cycle.heard)
        reading.faults += self._noise.check(0 if cycle.late else heard)  # old answers are no noise
        return reading

    def require_believed(self) -> None:
        """Raise the fault of a joint whose last angle or speed was not believed: nobody would see where it goes."""
        if (doubted := self._interpreter.doubted()) is not None:
            raise doubted

    def faults(self, reading: Reading, known: list[DxlServoFault]) -> list[DxlServoFault]:
        """Known faults and this cycle's new ones; one that explains another of its servo takes that one's place.

        Each is told when it is new: `read` raises the first alone, and a loop that holds already asks no more of it.
        """
        seen = self.monitor.faults
        if not seen and not reading.faults:
            return known
        merged = list(known)
        for fault in (*seen, *reading.faults):
            if (fault.cause, fault.servo_id) in self._known:
                continue
            if any(other.cause is FaultCause.WATCHDOG_TRIPPED and other.explains(fault) for other in merged):
                continue  # told if it is still so once the servo is armed again
            self._known.add((fault.cause, fault.servo_id))
            merged, explained = fault.among(merged)
            if explained:
                text = f"{fault.cause.value}; it looked like: {', '.join(other.cause.value for other in explained)}"
                self._on_event(DriverEvent(EventKind.EXPLAINED, text, fault.servo_id, fault.joint))
            elif fault.cause is not FaultCause.WATCHDOG_TRIPPED:  # of which is told that it is armed again
                text = f"{fault.cause.value}: found {fault.found}, expected {fault.expected}"
                self._on_event(DriverEvent(EventKind.FAULT, text, fault.servo_id, fault.joint))
        seen.clear()
        return merged

    # --- write ----------------------------------------------------------------------------------------------------

    def write(self, tau_Nm: Sequence[float], cycle_begin_ns: int) -> list[float]:
        """Send goals for joint torques, and a health request if the gap has room; returns the torques sent.

        No torque goes to an arm that is armed in part: a servo that is not armed would go on with its goal for ever.
        """
        if self.monitor.half_armed:
            tau_Nm = [0.0] * len(tau_Nm)
        sent = [0.0] * len(tau_Nm)
        packets = b""
        for writer, joints in self._writers:
            counts = []
            for j in joints:
                records = self._joint_records[j]
                dq = self._interpreter.dq[j]
                count, sent[j] = self._drives[j].command(tau_Nm[j], dq, records[0].voltage_V)
                counts.append(count)
                for record in records:
                    record.sent_before, record.sent = record.sent, count
                    self._goals[self._place_of[record.slot.servo_id]] = count
            packets += writer.packet(counts)
        if self.monitor.awaited:  # a second write in one cycle
            self.hear_health()
        now_ns = self._clock.now_ns()
        gap_ns = cycle_begin_ns + self._arm.period_ns - now_ns - self._write_ns
        question, question_ns = b"", 0
        if self.grip is not None and (goal := self.grip.packets()):
            packets += goal  # it takes the place of a question
            self._note(self.grip.servo_id, self.grip.effort)
        else:
            question, question_ns = self.monitor.question(gap_ns, whole=None not in self._rows)
        self._wire_free_ns = now_ns + self._write_ns + question_ns
        self._bus.port.write(packets + question, now_ns + self._arm.period_ns)
        return sent

    def _note(self, servo_id: int, count: int) -> None:
        """A servo that is held has been sent another effort."""
        place = self._place_of[servo_id]
        record = self._records[place]
        record.sent_before, record.sent = record.sent, count
        self._goals[place] = count

    # --- the rest -------------------------------------------------------------------------------------------------

    def grip_state(self, now_ns: int) -> GripState | None:
        """What the gripper said in the last cycle."""
        if self.grip is None:
            return None
        row = self._rows[self._place_of[self.grip.servo_id]]
        return None if row is None else self.grip.state(row, now_ns)

    def health(self, now_ns: int) -> ServoHealth:
        """Slow quantities as they were last read, current or load of the last cycle."""
        records = self._records
        present = (math.nan if row is None else row[1] for row in self._rows)
        said = [current_or_load(record.slot.model, count) for record, count in zip(records, present, strict=True)]
        return ServoHealth(
            now_ns,
            servo_ids=tuple(record.slot.servo_id for record in records),
            joints=tuple(record.slot.joint.name for record in records),
            temperature_C=np.array([record.temperature_C for record in records]),
            voltage_V=np.array([record.voltage_V for record in records]),
            error_bits=np.array([int(record.hardware) for record in records], dtype=np.uint8),
            current_A=np.array([current for current, _ in said]),
            load=np.array([load for _, load in said]),
            temperature_limit_C=np.array([record.thermal.limit_C for record in records]),
            voltage_min_V=np.array([record.voltage_limits_V[0] for record in records]),
            voltage_max_V=np.array([record.voltage_limits_V[1] for record in records]),
            stall_current_A=np.array([record.slot.model.stall_current_A for record in records]),
            slow_ns=np.array([record.slow_ns for record in records], dtype=np.int64),
        )

    def recognise(self) -> None:
        """Ping every servo of the map, and ask the first for its mark where the cell has marks.

        Raises IdentityError unless all are the models that were there before, of the same arm.
        """
        for servo in self._found:
            model = self._bus.ping(servo.slot.servo_id, attempts=2).model_number
            misfit = broken(MODEL, replace(servo, model_number=model))
            if misfit is not None:
                raise IdentityError.of(misfit)
        first = self._found[0]
        if first.slot.mark.known:
            values = {MOVING_THRESHOLD.name: self._bus.read(first.slot.servo_id, MOVING_THRESHOLD)}
            misfit = broken(MARK, replace(first, values=values))
            if misfit is not None:
                raise IdentityError.of(misfit)
