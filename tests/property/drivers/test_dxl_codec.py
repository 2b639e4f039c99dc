"""The codec for every payload: stuffing is undone, damage never becomes a value, nothing is raised but PacketError."""

from __future__ import annotations

import random
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.dynamixel.cycle import MARKS, marked_groups
from drivers.dynamixel.line import codec
from drivers.dynamixel.line.codec import PacketError, StatusScanner
from drivers.dynamixel.line.group import GroupRead, GroupWrite

# payloads as bad as they can be for stuffing: mostly FF and FD
NASTY = st.lists(st.sampled_from([0xFF, 0xFF, 0xFD, 0x00, 0x55]), max_size=40).map(bytes)
IDS = st.lists(st.integers(0, 252), min_size=1, max_size=9, unique=True)


def merged_reply(ids, blocks, errors=None) -> bytes:
    """Fast sync read reply as servos build it together: each appends its block and the checksum of all before."""
    length = 1 + len(ids) * (len(blocks[0]) + 4)
    reply = codec.HEADER + bytes((0xFE, length & 0xFF, length >> 8, 0x55))
    for servo_id, block, error in zip(ids, blocks, errors or [0] * len(ids), strict=True):
        reply += bytes((error, servo_id)) + block
        reply += codec.crc16(reply).to_bytes(2, "little")
    return reply


@given(NASTY)
@pytest.mark.fault("B9")
def test_stuffing_is_undone(payload):
    assert codec.unstuff(codec.stuff(payload)) == payload


@given(NASTY)
@pytest.mark.fault("B9")
def test_stuffed_payload_never_shows_a_header(payload):
    assert codec.HEADER not in codec.stuff(payload)


@given(st.integers(0, 252), st.integers(0, 255), NASTY)
def test_status_packets_survive_the_wire(servo_id, error, payload):
    packet = codec.status(servo_id, error, payload)
    assert codec.decode_status(packet) == (servo_id, error & 0x7F, error >= 0x80, payload)


@given(st.lists(st.tuples(st.integers(0, 252), NASTY), max_size=8), st.integers(1, 7))
def test_scanner_finds_all_packets_however_they_are_cut(messages, cut):
    stream = b"".join(codec.status(i, 0, p) for i, p in messages)
    scanner, found = StatusScanner(), []
    for start in range(0, len(stream), cut):
        scanner.feed(stream[start : start + cut])
        while (reply := scanner.take()) is not None:
            found.append((reply.servo_id, reply.params))
    assert found == messages


@given(IDS, st.data())
def test_merged_reply_is_parsed_by_position(ids, data):
    blocks = [
        data.draw(st.binary(min_size=10, max_size=10) | st.just(codec.HEADER + b"\xff\xff\xfd\x00ab")) for _ in ids
    ]
    errors = [data.draw(st.sampled_from([0, 0x80])) for _ in ids]
    reply = GroupRead(126, "hii", ids, fast=True).parse(merged_reply(ids, blocks, errors), final=False)
    assert reply.rows == [(e, *struct.unpack("<hii", b)) for e, b in zip(errors, blocks, strict=True)]
    assert (reply.complete, reply.damaged, reply.late) == (True, 0, 0)


@given(IDS, st.integers(1, 13), st.data())
def test_merged_reply_cut_short_keeps_the_servos_before_the_cut(ids, length, data):
    blocks = [data.draw(st.binary(min_size=length, max_size=length)) for _ in ids]
    group = GroupRead(64, f"{length}B", ids, fast=True)
    whole = merged_reply(ids, blocks)
    cut = data.draw(st.integers(0, len(whole) - 1))
    assert not group.parse(whole[:cut], final=False).finished
    rows = group.parse(whole[:cut], final=True).rows
    answered = max(0, (cut - 8) // (length + 4))
    assert rows == [(0, *b) for b in blocks[:answered]] + [None] * (len(ids) - answered)


@given(IDS, st.data())
def test_one_damaged_block_voids_only_that_servo_unless_its_checksum_field_is_hit(ids, data):
    blocks = [data.draw(st.binary(min_size=10, max_size=10)) for _ in ids]
    reply = bytearray(merged_reply(ids, blocks))
    victim = data.draw(st.integers(0, len(ids) - 1))
    at = 8 + 14 * victim + data.draw(st.integers(0, 13))
    reply[at] ^= data.draw(st.integers(1, 255))
    rows = GroupRead(126, "10B", ids, fast=True).parse(bytes(reply), final=False).rows
    assert rows[victim] is None
    hurt = {victim, victim + 1} if (at - 8) % 14 >= 12 else {victim}
    for place, block in enumerate(blocks):
        assert rows[place] == (None if place in hurt else (0, *block))


@given(st.lists(st.integers(0, 252), min_size=2, max_size=9, unique=True), st.data())
def test_merged_reply_in_another_order_is_late_and_never_a_state(ids, data):
    asked, answered = data.draw(st.permutations(range(len(ids))).map(lambda p: p[:2]))
    values = {i: struct.pack("<hii", 1, 2, i) for i in ids}
    old, new = ([*ids[turn:], *ids[:turn]] for turn in (answered, asked))
    group = GroupRead(126, "hii", new, fast=True)
    late = merged_reply(old, [values[i] for i in old])
    reply = group.parse(late, final=True)
    assert (reply.rows, reply.late) == ([None] * len(ids), 1)
    assert group.parse(late + merged_reply(new, [values[i] for i in new]), final=False).complete


@given(IDS, st.booleans(), st.data())
def test_no_part_of_an_answer_to_another_cycle_is_ever_believed(ids, fast, data):
    groups = marked_groups(tuple(ids), fast=fast)
    assert len(groups) >= MARKS
    asked = data.draw(st.integers(0, len(groups) - 1))
    answered = groups[(asked - data.draw(st.integers(1, MARKS - 1))) % len(groups)]
    blocks = [bytes(answered.data_length)] * len(ids)
    if fast:
        late = bytearray(merged_reply(answered.ids, blocks))
    else:
        late = bytearray(b"".join(codec.status(i, 0, b) for i, b in zip(answered.ids, blocks, strict=True)))
    for _ in range(data.draw(st.integers(0, 3))):
        late[data.draw(st.integers(0, len(late) - 1))] ^= data.draw(st.integers(1, 255))
    part = bytes(late[: data.draw(st.integers(0, len(late)))])
    assert groups[asked].parse(part, final=True).rows == [None] * len(ids)


@given(IDS, st.data())
@pytest.mark.fault("B8")
def test_status_packet_of_another_length_is_late_and_never_a_state(ids, data):
    more = data.draw(st.integers(1, 8))
    late = b"".join(codec.status(i, 0, bytes(10 + more)) for i in ids)
    reply = GroupRead(126, "hii", ids, fast=False).parse(late, final=True)
    assert (reply.rows, reply.late) == ([None] * len(ids), len(ids))


@given(IDS, st.data())
def test_sync_write_equals_the_general_builder(ids, data):
    values = [data.draw(st.integers(-885, 885)) for _ in ids]
    expected = codec.sync_write(100, 2, {i: struct.pack("<h", v) for i, v in zip(ids, values, strict=True)})
    assert GroupWrite(100, "h", ids).packet(values) == expected


@pytest.mark.fault("B9")
def test_sync_write_stuffs_what_needs_it():
    group = GroupWrite(116, "i", [1, 2])
    packet = group.packet([-513, 0])  # FF FD FF FF after ID 1: no pattern
    assert packet == codec.sync_write(116, 4, {1: b"\xff\xfd\xff\xff", 2: bytes(4)})
    packet = group.packet([-131073, -3])  # FF FF FD FF after ID 1
    assert packet.count(b"\xff\xff\xfd\xfd") == 1


@settings(max_examples=300)
@given(st.binary(max_size=300), st.integers(1, 50))
def test_scanner_ends_on_any_bytes(noise, cut):
    scanner = StatusScanner()
    for start in range(0, len(noise), cut):
        scanner.feed(noise[start : start + cut])
        while scanner.take() is not None:
            pass
    while scanner.take(final=True) is not None:
        pass


def _mutate(rng: random.Random, packet: bytes) -> bytes:
    data = bytearray(packet)
    for _ in range(rng.randrange(1, 4)):
        kind = rng.randrange(5)
        at = rng.randrange(len(data)) if data else 0
        if kind == 0 and data:
            data[at] ^= 1 << rng.randrange(8)
        elif kind == 1 and data:
            data[at] = rng.choice((0x00, 0x55, 0xFD, 0xFE, 0xFF))
        elif kind == 2 and data:
            del data[at : at + rng.randrange(1, 9)]
        elif kind == 3:
            data[at:at] = rng.choice((codec.HEADER, b"\xff\xff\xfd", b"\xff\xff", rng.randbytes(5)))
        else:
            data += data[rng.randrange(len(data) + 1) :][:20]
    return bytes(data)


@pytest.mark.fault("B8")
@pytest.mark.parametrize("count", [20_000, pytest.param(100_000, marks=pytest.mark.long)])
def test_damaged_packets_give_no_wrong_value(count: int) -> None:
    rng = random.Random(20)
    ids = [1, 2, 3]
    fast = GroupRead(126, "hii", ids, fast=True)
    each = GroupRead(126, "hii", ids, fast=False)
    accepted = 0
    for round_ in range(count):
        if round_ % 4 == 0:
            servo_id, payload = rng.randrange(253), rng.randbytes(rng.randrange(14))
            data = _mutate(rng, codec.status(servo_id, 0, payload)) if round_ % 8 else rng.randbytes(rng.randrange(60))
            try:
                reply = codec.decode_status(data)
            except PacketError:
                continue
            assert codec.crc16(data[:-2]) == int.from_bytes(data[-2:], "little")
            assert data == codec.status(reply.servo_id, reply.error | (0x80 if reply.alert else 0), reply.params)
            accepted += 1
            continue
        blocks = [rng.randbytes(10) for _ in ids]
        if round_ % 2:
            sent = merged_reply(ids, blocks)
            rows = fast.parse(_mutate(rng, sent), final=True).rows
        else:
            sent = b"".join(codec.status(i, 0, b) for i, b in zip(ids, blocks, strict=True))
            rows = each.parse(_mutate(rng, sent), final=True).rows
        truth = [(0, *struct.unpack("<hii", b)) for b in blocks]
        for row, true in zip(rows, truth, strict=True):
            assert row is None or row == true
            accepted += row is not None
    assert accepted > 10_000  # the test would mean nothing if everything were refused
