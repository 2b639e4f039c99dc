"""Protocol 2.0 as a servo sees it: find instruction packets in a byte stream, build status packets.

It never uses the driver's codec: of two independent implementations each finds the other's mistakes.
Source: the ROBOTIS e-manual, pages Protocol 2.0 and CRC.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

HEADER = b"\xff\xff\xfd"
STUFFED_HEADER = b"\xff\xff\xfd\xfd"
STATUS_INSTRUCTION = 0x55
BROADCAST_ID = 0xFE
MAX_LENGTH = 1024  # LENGTH a servo believes; a larger one is noise
GAP_NS = 1_500_000  # silence inside a packet after which a servo forgets what it heard

_FRONT = 7  # header 3, reserved 1, ID 1, length 2
_FORBIDDEN_IDS = (b"\xfd", b"\xff")


def _crc_table() -> tuple[int, ...]:
    """Entry i is the CRC of the single byte i: polynomial 0x8005, most significant bit first."""
    entries = []
    for index in range(256):
        value = index << 8
        for _ in range(8):
            value = ((value << 1) ^ 0x8005 if value & 0x8000 else value << 1) & 0xFFFF
        entries.append(value)
    return tuple(entries)


_CRC = _crc_table()


def crc16(data: bytes | bytearray, crc: int = 0) -> int:
    """CRC-16 (poly 0x8005, init 0, no reflection, no final xor) of `data`, continued from `crc`."""
    table = _CRC
    for byte in data:
        crc = ((crc & 0xFF) << 8) ^ table[(crc >> 8) ^ byte]
    return crc


def stuff(body: bytes) -> bytes:
    """Insert FD after each FF FF FD, so that no header can appear inside a packet."""
    return body.replace(HEADER, STUFFED_HEADER) if HEADER in body else body


def unstuff(body: bytes) -> bytes:
    """Undo `stuff`."""
    return body.replace(STUFFED_HEADER, HEADER) if STUFFED_HEADER in body else body


def status_packet(servo_id: int, error: int, parameters: bytes = b"") -> bytes:
    """One status packet, stuffed, with its CRC."""
    body = stuff(bytes((STATUS_INSTRUCTION, error)) + parameters)
    packet = HEADER + bytes((0, servo_id)) + (len(body) + 2).to_bytes(2, "little") + body
    return packet + crc16(packet).to_bytes(2, "little")


class FastBlock(NamedTuple):
    """What one servo contributes to the merged reply of a fast read."""

    servo_id: int
    error: int
    data: bytes


def fast_status(blocks: list[FastBlock], announced: int | None = None) -> list[bytes]:
    """Return what each servo of a fast read puts on the wire, in order; the first one sends the header too.

    The LENGTH announces `announced` parameter bytes (default: those of `blocks`), since the first servo computes it
    from the instruction and cannot know that a later one stays silent.  Nothing is stuffed, and each CRC runs over
    every byte before it, earlier CRCs included.
    """
    total = announced if announced is not None else sum(len(block.data) + 4 for block in blocks)
    crc = 0
    pieces = []
    piece = HEADER + bytes((0, BROADCAST_ID)) + (total + 1).to_bytes(2, "little") + bytes((STATUS_INSTRUCTION,))
    for servo_id, error, data in blocks:
        piece += bytes((error, servo_id)) + data
        crc = crc16(piece, crc)
        tail = crc.to_bytes(2, "little")
        pieces.append(piece + tail)
        crc = crc16(tail, crc)
        piece = b""
    return pieces


class Command(NamedTuple):
    """One instruction packet with a right CRC; parameters are unstuffed.  `size` counts its bytes on the wire."""

    servo_id: int
    instruction: int
    parameters: bytes
    size: int


class Damaged(NamedTuple):
    """A packet whose CRC is wrong; a servo with this ID answers CRC error."""

    servo_id: int
    size: int


class UnstuffedHeader(Enum):
    """What a servo does with FF FF FD inside a packet that should have been stuffed; the manual leaves it open."""

    RESTARTS = "restarts"  # it is a header: what came before is forgotten
    ACCEPTED = "accepted"


@dataclass(slots=True)
class ParserCounters:
    """Cumulative since power-up."""

    packets: int = 0
    damaged: int = 0
    discarded_bytes: int = 0


class InstructionParser:
    """Incremental receiver of one bus; keeps at most one unfinished packet."""

    def __init__(self, unstuffed: UnstuffedHeader = UnstuffedHeader.RESTARTS) -> None:
        self.counters = ParserCounters()
        self._buffer = bytearray()
        self._unstuffed = unstuffed
        self._last_ns = 0

    def feed(self, data: bytes, now_ns: int) -> list[Command | Damaged]:
        """Take bytes that arrived at `now_ns`; return the packets they completed, in order.  Never raises."""
        if self._buffer and now_ns - self._last_ns > GAP_NS:
            self.reset()
        self._last_ns = now_ns
        self._buffer += data
        found: list[Command | Damaged] = []
        while self._align():
            packet = self._take()
            if packet is None:
                break
            found.append(packet)
        return found

    def reset(self) -> None:
        """Forget an unfinished packet."""
        self.counters.discarded_bytes += len(self._buffer)
        self._buffer.clear()

    def _drop(self, count: int) -> None:
        self.counters.discarded_bytes += count
        del self._buffer[:count]

    def _align(self) -> bool:
        """Bring a plausible front to the start of the buffer; False while there is none."""
        buffer = self._buffer
        while True:
            start = buffer.find(HEADER)
            if start < 0:
                keep = 2 if buffer.endswith(b"\xff\xff") else 1 if buffer.endswith(b"\xff") else 0
                self._drop(len(buffer) - keep)
                return False
            if start:
                self._drop(start)
            if (buffer[3:4] or b"\0") != b"\0" or buffer[4:5] in _FORBIDDEN_IDS:
                self._drop(3)
            elif len(buffer) < _FRONT:
                return False
            elif not 3 <= buffer[5] | buffer[6] << 8 <= MAX_LENGTH:
                self._drop(3)
            else:
                inner = self._inner_header()
                if inner == 0:
                    return True
                self._drop(inner)

    def _inner_header(self) -> int:
        """Position of a header that was not stuffed, which starts a new packet; 0 when there is none."""
        if self._unstuffed is UnstuffedHeader.ACCEPTED:
            return 0
        buffer = self._buffer
        body_end = _FRONT + (buffer[5] | buffer[6] << 8) - 2
        available = min(body_end, len(buffer))
        at = buffer.find(HEADER, _FRONT, available)
        while at >= 0:
            after = at + 3
            if after == available < body_end:
                return 0
            if after == body_end or buffer[after] != 0xFD:
                return at
            at = buffer.find(HEADER, after + 1, available)
        return 0

    def _take(self) -> Command | Damaged | None:
        """Remove one whole packet from the start of the buffer; None while it is unfinished."""
        buffer = self._buffer
        size = _FRONT + (buffer[5] | buffer[6] << 8)
        if len(buffer) < size:
            return None
        servo_id = buffer[4]
        if crc16(buffer[: size - 2]) != buffer[size - 2] | buffer[size - 1] << 8:
            self.counters.damaged += 1
            # the length itself may be the damaged part: look for a packet inside what it claimed
            self._drop(3)
            return Damaged(servo_id, size)
        body = unstuff(bytes(buffer[_FRONT : size - 2]))
        del buffer[:size]
        self.counters.packets += 1
        return Command(servo_id, body[0], body[1:], size)
