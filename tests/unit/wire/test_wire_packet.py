"""The emulator's packet layer: every published packet, stuffing, resynchronisation."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from drivers.dynamixel.servo.codes import Instruction
from sim_backend.wire.packet import (
    GAP_NS,
    HEADER,
    Command,
    Damaged,
    FastBlock,
    InstructionParser,
    UnstuffedHeader,
    crc16,
    fast_status,
    status_packet,
    stuff,
    unstuff,
)

VECTORS = json.loads((Path(__file__).parents[2] / "data" / "dynamixel_protocol2_vectors.json").read_text())["vectors"]
FAST_REPLY = "fast sync read reply (one packet)"


def packets(kind: str) -> list[tuple[str, bytes]]:
    return [(v["name"], bytes.fromhex(v["hex"])) for v in VECTORS if v["kind"] == kind]


def instruction(servo_id: int, code: int, parameters: bytes = b"") -> bytes:
    body = stuff(bytes((code,)) + parameters)
    packet = HEADER + bytes((0, servo_id)) + (len(body) + 2).to_bytes(2, "little") + body
    return packet + crc16(packet).to_bytes(2, "little")


@pytest.mark.parametrize(("name", "packet"), [(v["name"], bytes.fromhex(v["hex"])) for v in VECTORS])
def test_crc_of_every_published_packet_is_right(name: str, packet: bytes) -> None:
    assert crc16(packet[:-2]) == int.from_bytes(packet[-2:], "little"), name


@pytest.mark.parametrize(("name", "packet"), packets("instruction"))
def test_every_published_instruction_is_parsed_and_built_back(name: str, packet: bytes) -> None:
    (command,) = InstructionParser().feed(packet, 0)
    assert isinstance(command, Command), name
    assert command.size == len(packet)
    assert Instruction(command.instruction)
    assert instruction(command.servo_id, command.instruction, command.parameters) == packet


@pytest.mark.parametrize(("name", "packet"), [p for p in packets("status") if p[0] != FAST_REPLY])
def test_every_published_status_is_built_byte_for_byte(name: str, packet: bytes) -> None:
    assert status_packet(packet[4], packet[8], packet[9:-2]) == packet, name


def test_published_fast_reply_is_built_byte_for_byte_by_three_servos() -> None:
    packet = dict(packets("status"))[FAST_REPLY]
    blocks = [
        FastBlock(3, 0, bytes.fromhex("A6000000")),
        FastBlock(7, 0, bytes.fromhex("1F080000")),
        FastBlock(4, 0, bytes.fromhex("FF030000")),
    ]
    pieces = fast_status(blocks)
    assert b"".join(pieces) == packet
    assert [len(piece) for piece in pieces] == [16, 8, 8]


def test_fast_reply_announces_servos_that_then_stay_silent() -> None:
    (piece,) = fast_status([FastBlock(3, 0, bytes(4))], announced=3 * 8)
    assert int.from_bytes(piece[5:7], "little") == 1 + 3 * 8


def test_fast_reply_is_not_stuffed() -> None:
    (piece,) = fast_status([FastBlock(1, 0, b"\xff\xff\xfd\x00")])
    assert b"\xff\xff\xfd\x00" in piece[8:]


def test_stuffing_grows_by_one_byte_per_header_and_is_undone() -> None:
    body = b"\xff\xff\xfd\xfd\xff\xff\xfd"
    assert stuff(body) == b"\xff\xff\xfd\xfd\xfd\xff\xff\xfd\xfd"
    assert unstuff(stuff(body)) == body


def test_packet_arriving_byte_by_byte_is_found_once_complete() -> None:
    parser = InstructionParser()
    packet = instruction(1, 3, b"\x74\x00\x00\x02\x00\x00")
    found = [parser.feed(packet[i : i + 1], i) for i in range(len(packet))]
    assert not any(found[:-1])
    assert found[-1] == [Command(1, 3, b"\x74\x00\x00\x02\x00\x00", len(packet))]


def test_noise_before_a_packet_is_skipped_and_counted() -> None:
    parser = InstructionParser()
    noise = b"\x00\xff\xff\x12\xff\xff\xfd\xfd\xff"
    assert parser.feed(noise + instruction(1, 1), 0) == [Command(1, 1, b"", 10)]
    assert parser.counters.discarded_bytes == len(noise)


@pytest.mark.parametrize(
    "front",
    [
        b"\xff\xff\xfd\x01\x01\x03\x00",  # reserved byte is not 0
        b"\xff\xff\xfd\x00\xff\x03\x00",  # no such ID
        b"\xff\xff\xfd\x00\x01\x02\x00",  # shorter than any packet
        b"\xff\xff\xfd\x00\x01\xff\xff",  # longer than any packet
    ],
)
def test_impossible_front_does_not_hold_up_the_packet_behind_it(front: bytes) -> None:
    assert InstructionParser().feed(front + instruction(1, 1), 0) == [Command(1, 1, b"", 10)]


def test_truncated_packet_gives_way_to_the_next_header() -> None:
    cut = instruction(1, 3, bytes(20))[:15]
    assert InstructionParser().feed(cut + instruction(2, 1), 0) == [Command(2, 1, b"", 10)]


def test_silence_inside_a_packet_makes_the_servo_forget_it() -> None:
    packet = instruction(1, 1)
    parser = InstructionParser()
    assert parser.feed(packet[:6], 0) == []
    assert parser.feed(packet[6:], GAP_NS + 1) == []
    assert parser.feed(packet, 2 * GAP_NS + 2) == [Command(1, 1, b"", 10)]


def test_wrong_crc_is_reported_with_the_id_it_claims() -> None:
    packet = bytearray(instruction(5, 3, b"\x40\x00\x01"))
    packet[-1] ^= 0x10
    assert InstructionParser().feed(bytes(packet), 0) == [Damaged(5, len(packet))]


def test_packet_swallowed_by_a_damaged_length_is_found_behind_it() -> None:
    first = bytearray(instruction(5, 3, b"\x40\x00\x01"))
    first[5] += 10
    found = InstructionParser(UnstuffedHeader.ACCEPTED).feed(bytes(first) + instruction(2, 1), 0)
    assert found == [Damaged(5, len(first) + 10), Command(2, 1, b"", 10)]


def test_crc_that_completes_a_header_with_the_last_parameters_is_no_header() -> None:
    """FF FF in the data and FD as first CRC byte: only what was stuffed can hold a header."""
    candidates = (instruction(1, 3, word + b"\x00\xff\xff") for word in (i.to_bytes(2, "little") for i in range(65536)))
    packet = next(p for p in candidates if p[-2] == 0xFD and p[-1] != 0xFD)
    (command,) = InstructionParser().feed(packet, 0)
    assert isinstance(command, Command)
    assert command.parameters[-2:] == b"\xff\xff"


def unstuffed_write() -> bytes:
    body = b"\x03\x74\x00\xff\xff\xfd\x07"
    packet = HEADER + bytes((0, 1)) + (len(body) + 2).to_bytes(2, "little") + body
    return packet + crc16(packet).to_bytes(2, "little")


def test_header_that_was_not_stuffed_restarts_the_receiver() -> None:
    assert InstructionParser(UnstuffedHeader.RESTARTS).feed(unstuffed_write(), 0) == []


def test_header_that_was_not_stuffed_is_taken_as_data_where_the_switch_says_so() -> None:
    (command,) = InstructionParser(UnstuffedHeader.ACCEPTED).feed(unstuffed_write(), 0)
    assert isinstance(command, Command)
    assert command.parameters == b"\x74\x00\xff\xff\xfd\x07"
