"""Group reads and writes compiled once, used every cycle: bytes in, a row per servo out.  Pure.

The merged reply of a fast sync read carries, per servo, ERROR, ID, data and a checksum over all before it.  It is
not stuffed, so it is parsed by position.  A servo that does not answer ends the reply; the blocks before it stay valid.
A damaged block does not void the later ones: a block's own checksum field, as received, is what the next servo heard,
and gives the checksum state from which the next block is judged.

A reply that belongs to an earlier request must not pass as this one's: the IDs of a merged reply must come in the order
asked for, and a servo's own packet must have the length asked for.  It is for the caller to make requests differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from struct import Struct

from drivers.dynamixel.line import codec
from drivers.dynamixel.line.codec import CRC_TABLE, HEADER, MAX_PACKET, StatusScanner
from drivers.dynamixel.servo.codes import ALERT_BIT, BROADCAST_ID, Instruction

Row = tuple[int, ...]  # (error byte, value, value, …) of one servo


@dataclass(slots=True)
class GroupReply:
    """What one group read brought; `rows` in the order of the IDs asked for, None where nothing can be trusted."""

    rows: list[Row | None]
    finished: bool  # nothing more can come: stop waiting
    damaged: int  # checksum, length or ID wrong
    late: int  # intact, but the answer to another request

    @property
    def complete(self) -> bool:
        """Every servo answered, intact and in time."""
        return None not in self.rows


class GroupRead:
    """The same registers of several servos in one exchange.

    fields: struct codes of the data block, little-endian ("hii" for 126 to 135), padding included.  A servo's error
    byte is put in front of its row, alert bit and all.  proof: how many intact blocks of a merged reply must be in the
    order asked for before any is believed: one more than the places in which the orders of two requests agree.
    """

    def __init__(self, address: int, fields: str, ids: Sequence[int], *, fast: bool, proof: int = 1) -> None:
        self.ids = tuple(ids)
        self.fast = fast
        self.data_length = Struct("<" + fields).size
        self.request = codec.sync_read(address, self.data_length, ids, fast=fast)
        self._proof = proof
        self._fields = Struct("<" + fields)
        self._block = self.data_length + 4
        if fast:
            self.reply_bytes = 8 + len(ids) * self._block
            length = 1 + len(ids) * self._block
            self._head = HEADER + bytes((BROADCAST_ID, length & 0xFF, length >> 8, Instruction.STATUS))
            self._head_crc = codec.crc16(self._head)
            self._rows = Struct(f"<BB{fields}2x")
            self._words = Struct(f">{self._block >> 1}H")
        else:
            self.reply_bytes = len(ids) * (self.data_length + 11)
            self._place = {servo_id: place for place, servo_id in enumerate(ids)}
            self._last_mark = HEADER + bytes((ids[-1],))
        if self.reply_bytes > MAX_PACKET:
            raise ValueError(f"group read of {self.reply_bytes} bytes: at most {MAX_PACKET}")

    def worth_parsing(self, data: bytes) -> bool:
        """True when the answer may be whole: enough bytes, or the servo that answers last has begun."""
        return len(data) >= self.reply_bytes or (not self.fast and self._last_mark in data)

    def parse(self, data: bytes, *, final: bool) -> GroupReply:
        """Rows found in the bytes received since the request.  final: nothing more will come."""
        return self._parse_fast(data, final) if self.fast else self._parse_each(data, final)

    def _parse_fast(self, data: bytes, final: bool) -> GroupReply:
        count = len(self.ids)
        damaged = late = 0
        start = data.find(self._head)
        while start >= 0:
            body = memoryview(data)[start + 8 : start + self.reply_bytes]
            blocks = len(body) // self._block
            if blocks < count and not final:
                break
            intact = self._intact(body, blocks)
            rows: list[Row | None] = [None] * count
            found, strange = 0, False
            unpacked = self._rows.iter_unpack(body[: blocks * self._block])
            for place, (row, good) in enumerate(zip(unpacked, intact, strict=True)):
                if good and row[1] == self.ids[place]:
                    rows[place] = (row[0], *row[2:])
                    found += 1
                elif good:
                    strange = True
            begun_right = None not in rows[: self._proof]
            if begun_right or (found >= self._proof and not strange):
                return GroupReply(rows, True, damaged + blocks - found, late)
            if strange:  # the intact answer to another request, all of it: look behind it
                late += 1
            else:
                damaged += blocks - found
            start = data.find(self._head, start + 8)
        return GroupReply([None] * count, final, damaged, late)

    def _intact(self, body: memoryview, blocks: int) -> list[bool]:
        table = CRC_TABLE
        state = self._head_crc
        intact = []
        if self._block & 1:
            for end in range(self._block, blocks * self._block + 1, self._block):
                crc = codec.crc16(body[end - self._block : end - 2], state)
                received = body[end - 2] | body[end - 1] << 8
                intact.append(crc == received)
                state = codec.crc16(body[end - 2 : end], received)
            return intact
        for words in self._words.iter_unpack(body[: blocks * self._block]):
            crc = state
            for word in words[:-1]:
                crc = table[crc ^ word]
            field = words[-1]
            received = field >> 8 | field << 8 & 0xFF00
            intact.append(crc == received)
            state = table[received ^ field]
        return intact

    def _parse_each(self, data: bytes, final: bool) -> GroupReply:
        rows: list[Row | None] = [None] * len(self.ids)
        scanner = StatusScanner()
        scanner.feed(data)
        late = 0
        finished = final
        while (reply := scanner.take(final=final)) is not None:
            place = self._place.get(reply.servo_id)
            if place is None or len(reply.params) != self.data_length:
                late += 1
                continue
            error = reply.error | (ALERT_BIT if reply.alert else 0)
            rows[place] = (error, *self._fields.unpack(reply.params))
            finished = finished or place == len(rows) - 1  # it answers last, whoever is missing before it
        return GroupReply(rows, finished, scanner.damaged, late)


class GroupWrite:
    """The same register of several servos in one packet; field: struct code of the value, "h" for two bytes."""

    def __init__(self, address: int, field: str, ids: Sequence[int]) -> None:
        self.ids = tuple(ids)
        self._address = address
        self._value = Struct("<" + field)
        self._params = Struct("<" + f"B{field}" * len(ids))
        self._arguments = [value for servo_id in ids for value in (servo_id, 0)]
        template = codec.sync_write(address, self._value.size, {i: bytes(self._value.size) for i in ids})
        self._head = template[:12]

    def packet(self, values: Sequence[int]) -> bytes:
        """Sync write of one value per servo, in the order of `ids`."""
        self._arguments[1::2] = values
        params = self._params.pack(*self._arguments)
        if b"\xff\xff\xfd" in params:
            data = {i: self._value.pack(value) for i, value in zip(self.ids, values, strict=True)}
            return codec.sync_write(self._address, self._value.size, data)
        packet = self._head + params
        crc = codec.crc16(packet)
        return packet + bytes((crc & 0xFF, crc >> 8))
