"""The read of one control cycle: every servo's current, velocity and position, fresh or missing.  Never an old value.

Each request is marked so that the answer to an earlier one cannot pass for it, however late it is.  In a merged reply
the mark is the order of the IDs, rotated and reversed from cycle to cycle; where each servo sends its own packet (and
on a bus of few servos) it is the number of bytes read.  There are more marks than cycles that a servo may stay silent
before it is a fault, so no mark is used again while an answer to it may still come.  The realtime tick register would
do the same for 6 more bytes per servo, 0.5 ms of every cycle of nine servos at 1 Mbit/s.

A servo that stays silent ends a merged reply.  So the servos without an answer are asked once more, one status packet
each, if the period leaves time for it, and for a while after that the cycle uses status packets throughout.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.budget import CYCLE_BYTES, LinkTiming, cycle_budget, group_read_s
from drivers.dynamixel.bus import BABBLE_BYTES, Bus, DxlCounters
from drivers.dynamixel.checks import SILENT_LIMIT_CYCLES
from drivers.dynamixel.group import GroupRead, GroupReply, Row
from drivers.dynamixel.port import Now
from drivers.dynamixel.table import ALERT_BIT, PRESENT_POSITION

END_SHARE = 0.85  # of the period: the read is over by then, whatever happens
CAREFUL_CYCLES = 50  # after an incomplete merged reply
PATIENCE_NS = 500_000
HOST_NS = 50_000  # between noticing that an answer is missing and asking again
MARKS = SILENT_LIMIT_CYCLES + 1
_BLOCK_END = PRESENT_POSITION.address + PRESENT_POSITION.length


@dataclass(slots=True)
class CycleRows:
    """One cycle's answers in the order of `ArmMap.slots`: (error byte, current or load, velocity, position)."""

    stamp_ns: int
    rows: list[Row | None]
    heard: bytes
    late: bool  # intact answers to an earlier request came
    damaged: bool


class CycleReader:
    """Asks all servos once per cycle and keeps the time.

    first_wait_ns, end_ns: how long the read waits for the merged reply, and for everything.
    """

    def __init__(
        self, bus: Bus, arm: ArmMap, clock: Now, counters: DxlCounters, *, fast: bool, link: LinkTiming
    ) -> None:
        self.fast = fast
        self._bus = bus
        self._clock = clock
        self._counters = counters
        self._ids = tuple(slot.servo_id for slot in arm.slots)
        self._needed = {joint.ids[0] for joint in arm.controlled}
        self._arm = arm
        self._link = link
        self._fast_groups = _marked(self._ids, fast=True) if fast else []
        self._each_groups = _marked(self._ids, fast=False)
        budget = cycle_budget(arm, fast=fast, link=link)
        careful = cycle_budget(arm, fast=False, link=link)
        self.end_ns = round(END_SHARE * arm.period_ns)
        worst_ns = round(1.05e9 * budget.read_worst_s)
        before_retry_ns = self.end_ns - self._retry_ns(1) - HOST_NS
        # a little patience, for a host that was late is no reason to ask again; none when there is no time to
        self.first_wait_ns = min(before_retry_ns, worst_ns + PATIENCE_NS) if worst_ns < before_retry_ns else self.end_ns
        self._sampled_ns = round(1e9 * (budget.request_s + link.turnaround_s))
        self._careful_fits = careful.read_worst_s * 1e9 < self.end_ns
        self._careful_left = 0
        self._number = 0

    def read(self) -> CycleRows:
        """One cycle.  The caller has thrown away older input.  Raises PortLostError, WriteTimeoutError."""
        careful = self._careful_left > 0 or not self.fast
        groups = self._each_groups if careful else self._fast_groups
        number = self._number
        group = groups[number % len(groups)]
        self._number += 1
        self._careful_left -= careful
        begin_ns = self._clock.now_ns()
        reply, heard = self._bus.exchange(group, begin_ns + (self.end_ns if careful else self.first_wait_ns))
        found = dict(zip(group.ids, reply.rows, strict=True))
        damaged, late = reply.damaged, reply.late
        if not reply.complete:
            if not careful and self._careful_fits:
                self._careful_left = CAREFUL_CYCLES
            again, heard = self._ask_again(group, number % MARKS, heard, found, begin_ns + self.end_ns)
            damaged, late = again.damaged, again.late
        rows = [found[servo_id] for servo_id in self._ids]
        rows = [None if row is None or row[0] & ~ALERT_BIT else row for row in rows]  # it said that it did not
        self._count(rows, damaged, late)
        stamp_ns = min(begin_ns + self._sampled_ns, self._clock.now_ns())
        return CycleRows(stamp_ns, rows, heard, late > 0, damaged > 0)

    def _ask_again(
        self, group: GroupRead, mark: int, heard: bytes, found: dict[int, Row | None], end_ns: int
    ) -> tuple[GroupReply, bytes]:
        """Ask the missing servos one by one; fills `found`.  The first answer may still be on its way and counts."""
        missing = [servo_id for servo_id, row in found.items() if row is None]
        # the first is the one that ended the reply: asked last, it cannot keep the others waiting
        order = [*sorted(missing[1:], key=lambda servo_id: servo_id not in self._needed), missing[0]]
        while order and self._clock.now_ns() + self._retry_ns(len(order)) > end_ns:
            order.pop()
        if not order:
            return group.parse(heard, final=True), heard
        self._counters.retries += 1
        each = _group(order, mark, fast=False)
        self._bus.port.write(each.request, end_ns)
        after = b""
        while True:
            after += self._bus.port.read_until(end_ns)
            final = len(after) > BABBLE_BYTES or self._clock.now_ns() >= end_ns
            merged, single = group.parse(heard + after, final=final), each.parse(after, final=final)
            for reply in (merged, single):
                ids = group.ids if reply is merged else each.ids
                found.update((i, row) for i, row in zip(ids, reply.rows, strict=True) if row is not None)
            if final or None not in found.values() or single.finished:
                return GroupReply([], True, merged.damaged + single.damaged, merged.late), heard + after

    def _retry_ns(self, servos: int) -> int:
        wire = sum(group_read_s(servos, CYCLE_BYTES + MARKS - 1, self._arm.baud, fast=False, link=self._link))
        return round(1e9 * (wire + self._link.usb_latency_s))

    def _count(self, rows: list[Row | None], damaged: int, late: int) -> None:
        counters = self._counters
        if None not in rows and not damaged and not late:
            return
        counters.corrupt += damaged
        counters.late += late
        for servo_id, row in zip(self._ids, rows, strict=True):
            if row is None:
                counters.per_servo[servo_id] = counters.per_servo.get(servo_id, 0) + 1
        counters.timeouts += None in rows


def _group(ids: Sequence[int], more: int, *, fast: bool) -> GroupRead:
    """Read of the block at 126 to 135, begun `more` bytes earlier."""
    return GroupRead(_BLOCK_END - CYCLE_BYTES - more, (f"{more}x" if more else "") + "hii", ids, fast=fast)


def _marked(ids: tuple[int, ...], *, fast: bool) -> list[GroupRead]:
    """Group reads to be used in turn, at least MARKS of them that cannot be taken for each other."""
    turned = [[*ids[turn:], *ids[:turn]] for turn in range(len(ids))]
    if fast and 2 * len(ids) >= MARKS:
        return [_group(order, 0, fast=True) for turn in turned for order in (turn, turn[::-1])]
    return [_group(turned[mark % len(ids)], mark, fast=fast) for mark in range(MARKS)]
