"""Protocol 2.0 packets: bytes in, bytes out.  Pure; what is damaged is an error or is counted.

Packet: FF FF FD 00, ID, LENGTH (2), INSTRUCTION, [ERROR], parameters, CRC (2), all little-endian.  LENGTH counts
what follows it.  From INSTRUCTION to the last parameter a sender inserts FD after each FF FF FD (stuffing); LENGTH
and CRC count the stuffed bytes.  The merged reply of the fast reads is the exception: it is not stuffed, must be
parsed by position, and carries one CRC per servo.
"""

from __future__ import annotations

import enum
from array import array
from collections.abc import Mapping, Sequence
from struct import Struct
from struct import unpack as struct_unpack
from typing import NamedTuple

from drivers.dynamixel.servo.codes import ALERT_BIT, BROADCAST_ID, MAX_ID, Instruction
from drivers.interface import DriverError

HEADER = b"\xff\xff\xfd\x00"
MAX_PACKET = 1024  # bytes; the longest legal exchange here is far shorter, so a longer LENGTH is damage

_STUFFED, _UNSTUFFED = b"\xff\xff\xfd\xfd", b"\xff\xff\xfd"
_HEAD = Struct("<4sBHB")
_OVERHEAD = 7  # header, ID and LENGTH: what LENGTH does not count


class PacketFault(enum.Enum):
    """Why bytes are not a packet."""

    SHORT = "shorter than its length field says"
    HEADER = "no header FF FF FD 00"
    ID = "an ID that no servo can have"
    LENGTH = "a length no packet has"
    CRC = "a wrong checksum"
    STUFFING = "FF FF FD inside the packet without its stuffing byte"
    INSTRUCTION = "an instruction where a status packet was expected"


class PacketError(DriverError):
    """Bytes that are not the packet they should be."""

    def __init__(self, fault: PacketFault, data: bytes) -> None:
        super().__init__(
            "packet on the servo bus",
            found=f"{fault.value} ({data[:24].hex(' ')}{' …' if len(data) > 24 else ''})",
            expected="an intact Protocol 2.0 status packet",
            remedy="check cable, termination and baud rate; a single one is noise and is retried",
        )
        self.fault = fault


class Status(NamedTuple):
    """One reply of one servo."""

    servo_id: int
    error: int  # 0 or a StatusError code, without the alert bit
    alert: bool  # the servo has a hardware error: read register 70
    params: bytes


def _crc_table() -> array[int]:
    """Remainder of every 16-bit word followed by two zero bytes; poly 0x8005, MSB first."""
    table = [0]
    for bit in range(16):
        remainder = 1 << bit
        for _ in range(16):
            remainder = (remainder << 1 ^ 0x8005) & 0xFFFF if remainder & 0x8000 else remainder << 1
        table += [remainder ^ other for other in table]  # the remainder is linear in the word
    return array("H", table)


# Two bytes per look-up: 2.7 µs for the 134 bytes of a nine-servo reply, against 6.6 µs byte by byte.
CRC_TABLE = _crc_table()


def crc16(data: bytes | bytearray | memoryview, crc: int = 0) -> int:
    """CRC-16/BUYPASS: poly 0x8005, not reflected, no final xor.  crc: the value over what came before, 0 at first."""
    table = CRC_TABLE
    if len(data) & 1:
        crc = (crc << 8 & 0xFF00) ^ table[crc >> 8 ^ data[0]]
        data = data[1:]
    for word in struct_unpack(f">{len(data) >> 1}H", data):
        crc = table[crc ^ word]
    return crc


def stuff(body: bytes) -> bytes:
    """INSTRUCTION…parameters with FD inserted after each FF FF FD."""
    return body.replace(_UNSTUFFED, _STUFFED)


def unstuff(body: bytes) -> bytes:
    """Inverse of `stuff`.  Raises PacketError when FF FF FD stands without its stuffing byte."""
    if _UNSTUFFED not in body:
        return body
    if body.count(_UNSTUFFED) != body.count(_STUFFED):
        raise PacketError(PacketFault.STUFFING, body)
    return body.replace(_STUFFED, _UNSTUFFED)


def instruction(servo_id: int, code: Instruction, params: bytes = b"") -> bytes:
    """Instruction packet.  Raises ValueError for an ID no servo can have or a packet above MAX_PACKET."""
    if not (0 <= servo_id <= MAX_ID or servo_id == BROADCAST_ID):
        raise ValueError(f"servo ID {servo_id}: expected 0 to {MAX_ID}, or {BROADCAST_ID} for all")
    return _packet(servo_id, bytes((code,)) + params)


def status(servo_id: int, error: int = 0, params: bytes = b"") -> bytes:
    """Status packet as a servo sends it; error includes the alert bit."""
    return _packet(servo_id, bytes((Instruction.STATUS, error)) + params)


def _packet(servo_id: int, body: bytes) -> bytes:
    body = stuff(body)
    packet = HEADER + Struct("<BH").pack(servo_id, len(body) + 2) + body
    if len(packet) + 2 > MAX_PACKET:
        raise ValueError(f"packet of {len(packet) + 2} bytes: at most {MAX_PACKET}")
    return packet + crc16(packet).to_bytes(2, "little")


def ping(servo_id: int) -> bytes:
    """Ask for model number and firmware."""
    return instruction(servo_id, Instruction.PING)


def read(servo_id: int, address: int, length: int) -> bytes:
    """Ask for `length` bytes from `address`."""
    return instruction(servo_id, Instruction.READ, Struct("<HH").pack(address, length))


def write(servo_id: int, address: int, data: bytes) -> bytes:
    """Write bytes from `address`."""
    return instruction(servo_id, Instruction.WRITE, address.to_bytes(2, "little") + data)


def reboot(servo_id: int) -> bytes:
    """Restart a servo; it goes limp and forgets its RAM registers."""
    return instruction(servo_id, Instruction.REBOOT)


def sync_read(address: int, length: int, ids: Sequence[int], *, fast: bool = False) -> bytes:
    """Ask several servos for the same registers; they answer in this order, fast: in one merged packet."""
    code = Instruction.FAST_SYNC_READ if fast else Instruction.SYNC_READ
    return instruction(BROADCAST_ID, code, Struct("<HH").pack(address, length) + bytes(ids))


def sync_write(address: int, length: int, values: Mapping[int, bytes]) -> bytes:
    """Write the same registers of several servos, no replies.  Raises ValueError for data of another length."""
    if any(len(data) != length for data in values.values()):
        raise ValueError(f"sync write: every servo's data must be {length} bytes")
    params = b"".join(bytes((servo_id,)) + data for servo_id, data in values.items())
    return instruction(BROADCAST_ID, Instruction.SYNC_WRITE, Struct("<HH").pack(address, length) + params)


def decode_status(packet: bytes) -> Status:
    """Read one complete status packet.  Raises PacketError; `fault` says why."""
    if packet[:4] != HEADER:
        raise PacketError(PacketFault.HEADER, packet)
    if len(packet) < _OVERHEAD + 4:
        raise PacketError(PacketFault.SHORT, packet)
    _, servo_id, length, code = _HEAD.unpack_from(packet)
    if length > MAX_PACKET - _OVERHEAD:
        raise PacketError(PacketFault.LENGTH, packet)
    if len(packet) < _OVERHEAD + length:
        raise PacketError(PacketFault.SHORT, packet)
    if len(packet) > _OVERHEAD + length:
        raise PacketError(PacketFault.LENGTH, packet)
    if crc16(packet[:-2]) != packet[-2] | packet[-1] << 8:
        raise PacketError(PacketFault.CRC, packet)
    if code != Instruction.STATUS:
        raise PacketError(PacketFault.INSTRUCTION, packet)
    if servo_id > MAX_ID:
        raise PacketError(PacketFault.ID, packet)
    body = unstuff(packet[8:-2])
    return Status(servo_id, body[0] & ~ALERT_BIT, bool(body[0] & ALERT_BIT), body[1:])


class StatusScanner:
    """Finds status packets in a byte stream, whatever else is in it.  Never raises, holds at most MAX_PACKET bytes."""

    def __init__(self) -> None:
        self.damaged = 0  # packets dropped: checksum, length, stuffing
        self.cut = 0  # packets that ended too early, or only claimed to be so long
        self.foreign = 0  # intact packets that are no status: an echo of our own instruction
        self.garbage = 0  # bytes that belonged to nothing
        self._buffer = bytearray()

    def feed(self, chunk: bytes | bytearray | memoryview) -> None:
        """Append received bytes; the oldest are dropped beyond MAX_PACKET."""
        self._buffer += chunk[-MAX_PACKET:]
        excess = len(self._buffer) - MAX_PACKET
        if excess > 0:
            del self._buffer[:excess]
            self.garbage += excess

    def clear(self) -> None:
        """Forget what was received; counters stay."""
        self._buffer.clear()

    def take(self, *, final: bool = False) -> Status | None:
        """Next intact status packet, or None.

        final: nothing more will come, so a packet that claims to be longer than what is here is damaged,
        and what it would have hidden is searched.
        """
        buffer = self._buffer
        while True:
            start = buffer.find(HEADER)
            if start < 0:
                keep = min(3, len(buffer))  # a header may be cut anywhere
                self._drop(len(buffer) - keep)
                return None
            self._drop(start)
            length = buffer[5] | buffer[6] << 8 if len(buffer) >= _OVERHEAD else MAX_PACKET - _OVERHEAD
            if length < 3 or length > MAX_PACKET - _OVERHEAD:
                self._damage()
            elif len(buffer) < _OVERHEAD + length:
                if not final:
                    return None
                self.cut += 1
                del buffer[:4]
            else:
                found = self._decode(bytes(buffer[: _OVERHEAD + length]))
                if found is not None:
                    return found

    def _decode(self, packet: bytes) -> Status | None:
        try:
            found = decode_status(packet)
        except PacketError as error:
            intact = crc16(packet[:-2]) == packet[-2] | packet[-1] << 8
            if intact and error.fault is not PacketFault.STUFFING:
                self.foreign += 1
                del self._buffer[: len(packet)]
            else:
                self._damage()
            return None
        del self._buffer[: len(packet)]
        return found

    def _drop(self, count: int) -> None:
        del self._buffer[:count]
        self.garbage += count

    def _damage(self) -> None:
        """Give up this header only: a packet hidden behind a wrong length is still found."""
        self.damaged += 1
        del self._buffer[:4]
