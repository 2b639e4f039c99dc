"""Slow checks in the gaps of the cycle: torque flags, goals, errors, temperature, voltage, one group read per gap.

The request goes out together with the torque and is not waited for; the answer is picked up when the next cycle begins.
A gap that is too short is skipped, but not for ever: after some the question goes out all the same, which lengthens
that cycle and is told.  What is found is recorded and judged here; the driver raises it.
"""

from __future__ import annotations

import enum
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from drivers.dynamixel.arm_map import ServoSlot
from drivers.dynamixel.budget import SLOW_EVERY, LinkTiming, group_read_s
from drivers.dynamixel.errors import NO_ERROR, DxlServoFault, FaultCause, hardware_names
from drivers.dynamixel.events import DriverEvent, EventKind, OncePerServo
from drivers.dynamixel.line.group import GroupRead, Row
from drivers.dynamixel.servo.codes import WATCHDOG_TRIPPED, HardwareError
from drivers.dynamixel.servo.table import (
    BUS_WATCHDOG,
    HARDWARE_ERROR_STATUS,
    INDIRECT_DATA,
    LED,
    PRESENT_INPUT_VOLTAGE,
    TORQUE_ENABLE,
    Register,
)
from drivers.dynamixel.servo.thermal import ThermalWatch
from drivers.dynamixel.servo.units import volts

VOLTAGE_MARGIN_V = 0.5
# Gaps in a row: a host whose steps take long would else never ask, and see no servo fail.  Each question then may cost
# the next cycle: one in 25 is well below the tenth that may be lost.
SKIPPED_MAX = 24
WIRE_MARGIN = 1.1  # on the computed time of a question and its answer


class Page(enum.Enum):
    """What one health read asks for: address and fields (after the error byte)."""

    STATUS = (INDIRECT_DATA[0].address, "BBBbh")  # the bytes that bring-up mapped there: see `status_bytes`
    SLOW = (PRESENT_INPUT_VOLTAGE.address, "HB")  # 144 Present Input Voltage, 146 Present Temperature


def status_bytes(goal: Register) -> tuple[int, ...]:
    """Addresses that bring-up maps to Indirect Data 1 and following, so that one short read tells all that can fail.

    A servo that restarts forgets the mapping; it then reads as zeros, which is what a restart should look like.
    """
    registers = (TORQUE_ENABLE, LED, HARDWARE_ERROR_STATUS, BUS_WATCHDOG, goal)
    return tuple(register.address + place for register in registers for place in range(register.length))


@dataclass(slots=True)
class ServoRecord:
    """Last known slow values of one servo, and what they should be."""

    slot: ServoSlot
    goal: Register  # the register that carries this servo's effort
    watchdog: int  # expected Bus Watchdog value
    shutdown: HardwareError  # error bits that switch its torque off
    voltage_limits_V: tuple[float, float]
    thermal: ThermalWatch
    voltage_V: float
    temperature_C: float
    hardware: HardwareError = NO_ERROR
    sent: int = 0  # last goal sent
    sent_before: int = 0
    goal_doubts: int = 0
    slow_ns: int = 0  # when voltage and temperature were last read; 0: at bring-up


@dataclass(frozen=True, slots=True)
class _Question:
    page: Page
    read: GroupRead
    records: tuple[ServoRecord, ...]
    wire_ns: int


class GapMonitor:
    """Round robin over pages and groups of servos, one question per gap; a doubt is asked about again at once.

    A servo whose error stands raises a doubt in every cycle: every other gap is the round's all the same.
    """

    def __init__(
        self,
        records: Sequence[ServoRecord],
        per_gap: int,
        baud: int,
        link: LinkTiming,
        tell: OncePerServo,
        *,
        fast: bool,
    ) -> None:
        self.faults: list[DxlServoFault] = []
        self.misses = 0
        self.half_armed = False  # watchdogs were to be armed again, and not all are
        self._records = tuple(records)
        self._tell = tell
        self._pending: _Question | None = None
        self._urgent: deque[_Question] = deque()
        self._turn = 0
        self._owed = False  # to the round: the last gap went to a doubt
        self._rest = False
        self._skipped = 0  # gaps in a row that were too short

        def ask(page: Page, some: Sequence[ServoRecord]) -> list[_Question]:
            size = max(1, per_gap)
            questions = []
            for first in range(0, len(some), size):
                group = tuple(some[first : first + size])
                read = GroupRead(*page.value, [r.slot.servo_id for r in group], fast=fast)
                wire_s = sum(group_read_s(len(group), read.data_length, baud, fast=fast, link=link))
                questions.append(_Question(page, read, group, round(WIRE_MARGIN * 1e9 * wire_s)))
            return questions

        self._often = ask(Page.STATUS, self._records)
        self._seldom = ask(Page.SLOW, self._records)

    @property
    def answer_bytes(self) -> int:
        """Most that the answer to a question has."""
        return max(question.read.reply_bytes for question in (*self._often, *self._seldom))

    @property
    def awaited(self) -> bool:
        """True while a question has no answer."""
        return self._pending is not None

    def question(self, gap_ns: int, *, whole: bool = True) -> tuple[bytes, int]:
        """Request for this gap and how long it occupies the wire; nothing when one waits, or the gap is too short.

        whole: all servos have answered in this cycle.  After SKIPPED_MAX such gaps that were too short the next one is
        long enough; where servos are silent that is what takes the time, and it is found out as that.
        """
        if self._pending is not None:
            return b"", 0
        if self._rest:  # a missed answer may still come, and would be taken for the next one's
            self._rest = False
            return b"", 0
        doubted = bool(self._urgent) and not self._owed
        if doubted:
            question = self._urgent[0]
        elif self._turn % SLOW_EVERY == SLOW_EVERY - 1:
            question = self._seldom[self._turn // SLOW_EVERY % len(self._seldom)]
        else:
            question = self._often[(self._turn - self._turn // SLOW_EVERY) % len(self._often)]
        if question.wire_ns > gap_ns:
            self._skipped += whole
            if self._skipped <= SKIPPED_MAX:
                return b"", 0
            text = f"a question takes {question.wire_ns * 1e-6:.1f} ms, and the cycle leaves {gap_ns * 1e-6:.1f} ms"
            self._tell.tell(DriverEvent(EventKind.SLOW_CHECKS, f"{text}: every {SKIPPED_MAX + 1}th waits"), active=True)
        self._skipped = 0
        self._owed = doubted
        if doubted:
            self._urgent.popleft()
        else:
            self._turn += 1
        self._pending = question
        return question.read.request, question.wire_ns

    def answer(self, heard: bytes, now_ns: int, *, final: bool) -> None:
        """Look for the awaited answer in what was heard; final: it will not come any more."""
        question = self._pending
        if question is None:
            return
        reply = question.read.parse(heard, final=final)
        if not reply.complete and not final:
            return
        self._pending = None
        self._rest = not reply.complete
        self.misses += self._rest
        for record, row in zip(question.records, reply.rows, strict=True):
            if row is not None and not row[0] & 0x7F:
                self._judge(question, record, row, now_ns)

    def alert(self, servo_id: int) -> None:
        """A servo's alert bit was seen: read its status in the next gap."""
        for question in self._often:
            if servo_id in question.read.ids and question not in self._urgent:
                self._urgent.append(question)

    def look_at_supply(self) -> None:
        """Ask for voltage and temperature of all servos before the next round: what is known of them is old."""
        self._urgent.extend(self._seldom)

    def _judge(self, question: _Question, record: ServoRecord, row: Row, now_ns: int) -> None:
        if question.page is Page.SLOW:
            self._judge_slow(record, row, now_ns)
        else:
            self._judge_status(record, row)

    def _judge_status(self, record: ServoRecord, row: Row) -> None:
        _, torque, led, hardware, watchdog, goal = row
        record.hardware = HardwareError(hardware) if hardware else NO_ERROR
        if hardware and record.hardware & record.shutdown:
            self._find(FaultCause.HARDWARE_ERROR, record, hardware_names(record.hardware), "no error")
        elif torque == 0 and led == 0:  # bring-up lights the LED, a restart darkens it
            self._find(FaultCause.REBOOTED, record, "Torque Enable 0, LED 0", "1, 1")
        elif torque == 0:
            self._find(FaultCause.TORQUE_LOST, record, "Torque Enable 0", "1")
        elif watchdog == WATCHDOG_TRIPPED or (watchdog == 0 and self.half_armed):  # cleared, and not armed yet
            self._find(FaultCause.WATCHDOG_TRIPPED, record, f"Bus Watchdog {watchdog}", str(record.watchdog))
        elif watchdog != record.watchdog:
            self._find(FaultCause.REBOOTED, record, f"Bus Watchdog {watchdog}", str(record.watchdog))
        elif self.half_armed or goal in (record.sent, record.sent_before):  # else it may be that of rest, or of before
            record.goal_doubts = 0
        else:
            record.goal_doubts += 1  # a lost write explains one, not two
            self.alert(record.slot.servo_id)
            if record.goal_doubts > 1:
                self._find(FaultCause.GOAL_IGNORED, record, f"{record.goal.name} {goal}", str(record.sent))
        if hardware or self._tell.is_active(EventKind.HARDWARE_WARNING, record.slot.servo_id):
            bits = HardwareError(hardware & ~int(record.shutdown))  # those that do are a fault
            self._say(EventKind.HARDWARE_WARNING, record, hardware_names(bits), active=bits != 0)

    def _judge_slow(self, record: ServoRecord, row: Row, now_ns: int) -> None:
        record.slow_ns = now_ns
        record.voltage_V = volts(row[1])
        record.temperature_C = float(row[2])
        record.thermal.add(now_ns * 1e-9, record.temperature_C)
        thermal, (low, high) = record.thermal, record.voltage_limits_V
        limit = f"{record.temperature_C:.0f} °C of {thermal.limit_C:.0f} °C"
        self._say(EventKind.HOT, record, limit, active=thermal.hot)
        heating = thermal.heating and not thermal.hot
        self._say(EventKind.HEATING, record, limit, active=heating)
        close = not low + VOLTAGE_MARGIN_V <= record.voltage_V <= high - VOLTAGE_MARGIN_V
        self._say(EventKind.VOLTAGE, record, f"{record.voltage_V:.1f} V of {low:.1f} to {high:.1f} V", active=close)

    def _say(self, kind: EventKind, record: ServoRecord, text: str, *, active: bool) -> None:
        slot = record.slot
        self._tell.tell(DriverEvent(kind, text, slot.servo_id, slot.joint.name), active=active)

    def _find(self, cause: FaultCause, record: ServoRecord, found: str, expected: str) -> None:
        hardware = record.hardware if cause is FaultCause.HARDWARE_ERROR else NO_ERROR
        fault = DxlServoFault.of(cause, record.slot, found=found, expected=expected, hardware=hardware)
        if not any(f.servo_id == fault.servo_id and f.cause is cause for f in self.faults):
            self.faults.append(fault)
