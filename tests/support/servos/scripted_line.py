"""A cycle's reader on a line whose every answer comes when the test says, to the nanosecond."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Any

from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.budget import LinkTiming
from drivers.dynamixel.cycle import CycleReader, CycleRows
from drivers.dynamixel.line import codec
from drivers.dynamixel.line.bus import Bus, DxlCounters
from tests.support.servos.dxl_rig import WX200, at

MS, US = 1_000_000, 1_000
BEGIN_NS = 1_000_000_000
# 7 servos at 1 Mbit/s, 10 µs per byte: 21 bytes of request, turnaround 40 µs and 6 gaps of 5 µs, 106 bytes of reply,
# 1 ms in the adapter
FAST_WORST_NS = 210 * US + 40 * US + 30 * US + 1060 * US + 1 * MS
# one status packet each, of 18 bytes and 11 more
EACH_WORST_NS = 210 * US + 7 * (40 + 290) * US + 1 * MS
Arrivals = list[tuple[int, bytes]]  # ns after the request, and what comes then
Answer = Callable[[int, bytes], Arrivals]


def retry_ns(servos: int) -> int:
    """Asking some servos again, one status packet each."""
    return (14 + servos) * 10 * US + servos * (40 + 290) * US + 1 * MS


class Line:
    """A port and its clock: bytes come when the script says, time passes in waiting alone."""

    baud = 1_000_000

    def __init__(self, answer: Answer) -> None:
        self.ns = BEGIN_NS
        self.answer = answer
        self.writes: list[tuple[int, bytes, int]] = []
        self.waits: list[tuple[int, int]] = []  # when it began and how long it would have lasted
        self.coming: Arrivals = []
        self.number = 0  # of requests in this cycle

    def now_ns(self) -> int:
        return self.ns

    def write(self, data: bytes, deadline_ns: int) -> None:
        self.writes.append((self.ns, data, deadline_ns))
        self.number += 1
        self.coming += [(self.ns + delay_ns, part) for delay_ns, part in self.answer(self.number, data)]

    def read_until(self, deadline_ns: int) -> bytes:
        self.waits.append((self.ns, deadline_ns))
        due = min(self.coming, default=None, key=lambda arrival: arrival[0])
        if due is None or due[0] > deadline_ns:
            self.ns = max(self.ns, deadline_ns)
            return b""
        self.coming.remove(due)
        self.ns = max(self.ns, due[0])
        return due[1]


def asked(request: bytes) -> tuple[bool, int, int, tuple[int, ...]]:
    """Whether merged, address, length and servos of a request."""
    address, length = struct.unpack("<HH", request[8:12])
    return request[7] == 0x8A, address, length, tuple(request[12:-2])


def block(servo_id: int, length: int = 10) -> bytes:
    """What a servo has at the end of its block: current 10, 20, …, velocity 1, 2, …, position 2049, …"""
    return bytes(length - 10) + struct.pack("<hii", 10 * servo_id, servo_id, 2048 + servo_id)


def row(servo_id: int, error: int = 0) -> tuple[int, ...]:
    return error, 10 * servo_id, servo_id, 2048 + servo_id


def reply(
    request: bytes, *, silent: Sequence[int] = (), damaged: Sequence[int] = (), errors: dict[int, int] | None = None
) -> bytes:
    """What the servos answer; a silent one ends a merged reply."""
    merged, _, length, ids = asked(request)
    errors = errors or {}
    if not merged:
        packets = [codec.status(i, errors.get(i, 0), block(i, length)) for i in ids if i not in silent]
        whole = [p if p[4] not in damaged else p[:-1] + bytes((p[-1] ^ 0xFF,)) for p in packets]
        return b"".join(whole)
    size = 1 + len(ids) * (length + 4)
    out, bad = codec.HEADER + bytes((0xFE, size & 0xFF, size >> 8, 0x55)), []
    for servo_id in ids:
        if servo_id in silent:
            break
        out += bytes((errors.get(servo_id, 0), servo_id)) + block(servo_id, length)
        if servo_id in damaged:
            bad.append(len(out) - 1)
        out += codec.crc16(out).to_bytes(2, "little")
    return bytes(byte ^ 0xFF if place in bad else byte for place, byte in enumerate(out))


def whole(delay_ns: int = 2 * MS, **how: Any) -> Answer:
    """Every request is answered at once after a while."""
    return lambda _, request: [(delay_ns, reply(request, **how))]


def silence(_: int, __: bytes) -> Arrivals:
    return []


class Bench:
    """A reader on a scripted line."""

    def __init__(
        self, answer: Answer, arm: ArmMap = WX200, *, fast: bool = True, link: LinkTiming | None = None
    ) -> None:
        self.arm = arm
        self.line = Line(answer)
        self.counters = DxlCounters()
        port: Any = self.line
        bus = Bus(port, self.line, self.counters)
        self.reader = CycleReader(bus, arm, self.line, self.counters, fast=fast, link=link or LinkTiming())

    def read(self) -> CycleRows:
        """One cycle, a period after the last one began."""
        self.begin_ns = self.line.ns = BEGIN_NS if not self.line.writes else self.line.ns + 10 * MS
        self.line.coming.clear()
        self.line.number = 0
        self.first = len(self.line.writes)
        self.line.waits.clear()
        return self.reader.read()

    @property
    def requests(self) -> list[tuple[int, bytes]]:
        """When and what the last cycle asked."""
        return [(at_ns - self.begin_ns, data) for at_ns, data, _ in self.line.writes[self.first :]]


ROWS = [row(i) for i in range(1, 8)]
SLOW = at(WX200, rate_hz=100.0)


def then(first: dict[str, Any] | None, second: dict[str, Any] | None = None, delay_ns: int = 2 * MS) -> Answer:
    """The first request of a cycle is answered in one way, the second in another or not at all."""

    def answer(number: int, request: bytes) -> Arrivals:
        how = first if number == 1 else second
        return [] if how is None else [(delay_ns if number == 1 else 200 * US, reply(request, **how))]

    return answer
