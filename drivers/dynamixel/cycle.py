"""The read of one control cycle: every servo's current, velocity and position, fresh or missing, and never old.

Each request is marked so that the answer to an earlier one cannot pass for it, however late it is.  In a merged reply
the mark is the order of the IDs, rotated and reversed from cycle to cycle; where each servo sends its own packet (and
on a bus of few servos) it is the number of bytes read.  There are more marks than cycles that a servo may stay silent
before it is a fault, so no mark is used again while an answer to it may still come.  The realtime tick register would
do the same for 6 more bytes per servo, 0.5 ms of every cycle of nine servos at 1 Mbit/s.

A servo that stays silent ends a merged reply.  So the servos without an answer are asked once more, one status packet
each, if the period leaves time for it, and for some cycles after that status packets are used throughout.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.budget import CYCLE_BYTES, PLAIN_BYTES_MAX, CycleBudget, LinkTiming, cycle_budget, group_read_s
from drivers.dynamixel.line.bus import BABBLE_BYTES, Bus, DxlCounters
from drivers.dynamixel.line.group import GroupRead, GroupReply, Row
from drivers.dynamixel.line.port import Now
from drivers.dynamixel.servo.codes import ALERT_BIT
from drivers.dynamixel.servo.table import PRESENT_POSITION

END_SHARE = 0.9  # of the period: the read is over by then, whatever happens
CAREFUL_CYCLES = 10  # after a merged reply that a servo cut short
PATIENCE_NS = 500_000
HOST_NS = 50_000  # between noticing that an answer is missing and asking again
MARKS = PLAIN_BYTES_MAX - CYCLE_BYTES + 1
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
    """Asks all servos once per cycle and keeps the time; end_ns: how long a cycle's read may take."""

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
        self._fast_groups = marked_groups(self._ids, fast=True) if fast else []
        self._each_groups = marked_groups(self._ids, fast=False)
        budget = cycle_budget(arm, fast=fast, link=link)
        careful = cycle_budget(arm, fast=False, link=link, plain_bytes=PLAIN_BYTES_MAX)
        self.end_ns = round(END_SHARE * arm.period_ns)
        self._first_wait_ns = {True: self._patience_ns(budget), False: self._patience_ns(careful)}
        self._latency_ns = round(1.1e9 * link.usb_latency_s)
        self._byte_ns = 10_000_000_000 // arm.baud
        self._sampled_ns = round(1e9 * (budget.request_s + link.turnaround_s))
        self._careful_fits = careful.read_worst_s * 1e9 < self.end_ns
        self._careful_left = 0
        self._number = 0
        self._outdated = b""  # what the last cycle heard, if answers to earlier requests were in it

    @property
    def answer_bytes(self) -> int:
        """Most that the answers of a healthy cycle have."""
        return max(group.reply_bytes for group in (*self._fast_groups, *self._each_groups))

    def read(self) -> CycleRows:
        """One cycle.  The caller has thrown away older input.  Raises PortLostError, WriteTimeoutError."""
        careful = self._careful_left > 0 or not self.fast
        groups = self._each_groups if careful else self._fast_groups
        number = self._number
        group = groups[number % len(groups)]
        self._number += 1
        self._careful_left -= careful
        begin_ns = self._clock.now_ns()
        end_ns = begin_ns + self.end_ns
        self._bus.port.write(group.request, end_ns)
        reply, heard = self._listen(group, begin_ns + self._first_wait_ns[group.fast], end_ns)
        found = dict(zip(group.ids, reply.rows, strict=True))
        damaged, late = reply.damaged, reply.late
        if not reply.complete:
            if any(found.values()) and not careful and self._careful_fits:  # if not, the host was late, not a servo
                self._careful_left = CAREFUL_CYCLES
            damaged, late, heard = self._ask_again(
                group, number % MARKS, heard, found, end_ns, cut_short=reply.damaged == 0
            )
        if heard and heard in self._outdated:  # an adapter that repeats itself comes upon the right mark some time
            found, late = dict.fromkeys(found), late + 1
        rows = [found[servo_id] for servo_id in self._ids]
        rows = [None if row is None or row[0] & ~ALERT_BIT else row for row in rows]  # it said that it did not
        self._outdated = heard if late else b""
        self._count(rows, damaged, late)
        stamp_ns = min(begin_ns + self._sampled_ns, self._clock.now_ns())
        return CycleRows(stamp_ns, rows, heard, late > 0, damaged > 0)

    def _listen(self, group: GroupRead, until_ns: int, end_ns: int) -> tuple[GroupReply, bytes]:
        """Wait for one answer; longer than until_ns while the rest of what has begun to come may be on its way."""
        port, heard = self._bus.port, b""
        while True:
            more = port.read_until(until_ns)
            now_ns = self._clock.now_ns()
            heard += more
            if more:
                rest_ns = self._latency_ns + max(0, group.reply_bytes - len(heard)) * self._byte_ns
                until_ns = min(end_ns, max(until_ns, now_ns + rest_ns))
            final = now_ns >= until_ns or len(heard) > BABBLE_BYTES
            if final or group.worth_parsing(heard):
                reply = group.parse(heard, final=final)
                if reply.finished:
                    return reply, heard

    def _ask_again(
        self, group: GroupRead, mark: int, heard: bytes, found: dict[int, Row | None], end_ns: int, *, cut_short: bool
    ) -> tuple[int, int, bytes]:
        """Ask the missing servos one by one, if there is time, and listen to the end; fills `found`.

        The first answer may still be on its way and counts.  Returns (damaged, late, all bytes heard).
        """
        order = [servo_id for servo_id, row in found.items() if row is None]
        if cut_short:  # by the first that is missing: asked last, it cannot keep the others waiting
            order = [*order[1:], order[0]]
        else:
            order.sort(key=lambda servo_id: servo_id not in self._needed)
        while order and self._clock.now_ns() + self._retry_ns(len(order)) > end_ns:
            order.pop()
        each = _group(order, mark, fast=False) if order else None
        if each is not None:
            self._counters.retries += 1
            self._bus.port.write(each.request, end_ns)
        already = len(heard)
        while True:
            heard += self._bus.port.read_until(end_ns)
            final = len(heard) > BABBLE_BYTES or self._clock.now_ns() >= end_ns
            first = group.parse(heard, final=final)
            again = each.parse(heard[already:], final=final) if each is not None else None
            for ids, reply in ((group.ids, first), (order, again)):
                if reply is not None:
                    found.update((i, row) for i, row in zip(ids, reply.rows, strict=True) if row is not None)
            if final or None not in found.values() or (again.finished if again is not None else first.finished):
                return first.damaged + (again.damaged if again is not None else 0), first.late, heard

    def _patience_ns(self, budget: CycleBudget) -> int:
        """How long to wait for the first answer: all the time there is, unless that leaves enough to ask again.

        A little more than the worst that is healthy: a host that was late is no reason to ask again.
        """
        worst_ns = round(1.05e9 * budget.read_worst_s)
        before_retry_ns = self.end_ns - self._retry_ns(1) - HOST_NS
        return min(before_retry_ns, worst_ns + PATIENCE_NS) if worst_ns < before_retry_ns else self.end_ns

    def _retry_ns(self, servos: int) -> int:
        wire = sum(group_read_s(servos, PLAIN_BYTES_MAX, self._arm.baud, fast=False, link=self._link))
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


def _group(ids: Sequence[int], more: int, *, fast: bool, proof: int = 1) -> GroupRead:
    """Read of the block at 126 to 135, begun `more` bytes earlier."""
    fields = (f"{more}x" if more else "") + "hii"
    return GroupRead(_BLOCK_END - CYCLE_BYTES - more, fields, ids, fast=fast, proof=proof)


def marked_groups(ids: tuple[int, ...], *, fast: bool) -> list[GroupRead]:
    """Group reads to be used in turn, at least MARKS of them that cannot be taken for each other."""
    turned = [[*ids[turn:], *ids[:turn]] for turn in range(len(ids))]
    if fast and 2 * len(ids) >= MARKS:
        # a rotation and a reversed one agree in one place of an odd number, in two or none of an even one
        proof = 2 if len(ids) % 2 else 3
        return [_group(order, 0, fast=True, proof=proof) for turn in turned for order in (turn, turn[::-1])]
    return [_group(turned[mark % len(ids)], mark, fast=fast) for mark in range(MARKS)]
