"""What the Dynamixel driver costs the processor: parsing a reply, and a whole cycle on a bus that never waits."""

from __future__ import annotations

import struct
from collections import deque

import numpy as np
from dynamixel_sdk import GroupSyncRead
from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler

from drivers.clock import MonotonicClock
from drivers.dynamixel.driver import DynamixelDriver
from drivers.dynamixel.line import codec
from drivers.dynamixel.line.group import GroupRead
from drivers.dynamixel.servo.codes import Instruction
from drivers.dynamixel.servo.table import INDIRECT_DATA, PRESENT_CURRENT
from tests.bench.common import Figure, median_us
from tests.support.servos.dxl_rig import enabled

NAMES = ("dxl_parse_fast_9", "dxl_parse_plain_9", "dxl_read_7", "dxl_write_7")
IDS = tuple(range(1, 10))
BLOCK = struct.pack("<hii", 30, 2, 2048)
CALLS, REPEATS = 50, 101


def bench() -> dict[str, Figure]:
    fast = GroupRead(PRESENT_CURRENT.address, "hii", IDS, fast=True)
    plain = GroupRead(PRESENT_CURRENT.address, "hii", IDS, fast=False)
    merged = merged_reply(dict.fromkeys(IDS, BLOCK))
    packets = b"".join(codec.status(i, 0, BLOCK) for i in IDS)
    assert fast.parse(merged, final=False).complete
    assert plain.parse(packets, final=False).complete
    sdk = median_us(sdk_parse(packets), CALLS, REPEATS)
    read, write = cycle()
    return {
        "dxl_parse_fast_9": Figure(median_us(lambda: fast.parse(merged, final=False), CALLS, REPEATS), "µs", sdk),
        "dxl_parse_plain_9": Figure(median_us(lambda: plain.parse(packets, final=False), CALLS, REPEATS), "µs", sdk),
        "dxl_read_7": Figure(read, "µs"),
        "dxl_write_7": Figure(write, "µs"),
    }


def merged_reply(blocks: dict[int, bytes]) -> bytes:
    """Fast sync read reply as servos build it together."""
    length = 1 + sum(len(block) + 4 for block in blocks.values())
    reply = codec.HEADER + bytes((0xFE, length & 0xFF, length >> 8, Instruction.STATUS))
    for servo_id, block in blocks.items():
        reply += bytes((0, servo_id)) + block
        reply += codec.crc16(reply).to_bytes(2, "little")
    return reply


class _Replay:
    """What the SDK's packet handler needs of a port: the same answer for ever, at once."""

    is_using = False

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._left: deque[int] = deque()

    def rewind(self) -> None:
        self._left = deque(self._data)

    def readPort(self, length: int) -> list[int]:
        return [self._left.popleft() for _ in range(min(length, len(self._left)))]

    def isPacketTimeout(self) -> bool:
        return False


def sdk_parse(packets: bytes):
    """The SDK's own parsing of the plain reply."""
    port = _Replay(packets)
    group = GroupSyncRead(port, Protocol2PacketHandler(), PRESENT_CURRENT.address, len(BLOCK))
    for servo_id in IDS:
        group.addParam(servo_id)

    def parse() -> None:
        port.rewind()
        assert group.rxPacket() == 0

    return parse


class _InstantPort:
    """Answers every group read at once with healthy servos; `sent` gives the goals that a health read must show."""

    is_open, latency_timer_ms, baud = True, None, 1_000_000

    def __init__(self, sent) -> None:
        self._sent = sent
        self._ready = b""
        self._cache: dict[tuple, bytes] = {}

    def read_now(self) -> bytes:
        data, self._ready = self._ready, b""
        return data

    def read_until(self, _deadline_ns: int) -> bytes:
        return self.read_now()

    def discard_input(self) -> int:
        return len(self.read_now())

    def write(self, data: bytes, _deadline_ns: int) -> None:
        packet = data[data.rfind(codec.HEADER) :]
        if packet[7] == Instruction.FAST_SYNC_READ:
            key = (packet, *map(self._sent, packet[12:-2]))
            if key not in self._cache:
                self._cache[key] = self._answer(packet)
            self._ready = self._cache[key]

    def _answer(self, packet: bytes) -> bytes:
        address, length = struct.unpack_from("<HH", packet, 8)
        ids = packet[12:-2]
        if address == INDIRECT_DATA[0].address:
            return merged_reply({i: struct.pack("<BBBbh", 1, 1, 0, 10, self._sent(i)) for i in ids})
        return merged_reply(dict.fromkeys(ids, BLOCK if length == len(BLOCK) else struct.pack("<HB", 120, 30)))


def cycle() -> tuple[float, float]:
    """Medians of `read` and `write` of an enabled seven-servo arm, µs; the bus answers in no time."""
    driver = instant_driver()
    tau = np.full(4, 0.1)
    times: tuple[list[int], list[int]] = ([], [])
    clock = MonotonicClock()
    for _ in range(CALLS * REPEATS):
        begin = clock.now_ns()
        driver.read()
        middle = clock.now_ns()
        driver.write(tau)
        times[0].append(middle - begin)
        times[1].append(clock.now_ns() - middle)
    assert driver.counters.timeouts == 0
    return float(np.median(times[0])) / 1e3, float(np.median(times[1])) / 1e3


def instant_driver() -> DynamixelDriver:
    """A driver brought up on emulated servos, then put on a port without a bus behind it."""
    driver = enabled().driver
    running = driver._running
    assert running is not None
    sent = {record.slot.servo_id: record for record in running._records}
    driver._bus.port = _InstantPort(lambda servo_id: sent[servo_id].sent)
    for part in (driver, driver._bus, running, running.reader):
        part._clock = MonotonicClock()
    return driver
