"""The emulator's packet layer under arbitrary bytes."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.dynamixel.servo import table
from drivers.dynamixel.servo.codes import WATCHDOG_TRIPPED, Instruction
from sim_backend.wire.options import BusOptions
from sim_backend.wire.packet import (
    HEADER,
    Command,
    FastBlock,
    InstructionParser,
    UnstuffedHeader,
    crc16,
    fast_status,
    status_packet,
    stuff,
    unstuff,
)
from sim_backend.wire.servo import Servo
from tests.support.servos.wire_bench import Bench, answers, build, word, xl430, xm430

# bytes that make headers are common, so that stuffing and resynchronisation really happen
TRICKY = st.sampled_from([0xFF, 0xFF, 0xFF, 0xFD, 0xFD, 0x00, 0x01, 0x55])
BYTES = st.lists(st.one_of(TRICKY, st.integers(0, 255)), max_size=60).map(bytes)
IDS = st.integers(0, 252)
PACKETS = pytest.mark.parametrize("packets", [8_000, pytest.param(100_000, marks=pytest.mark.long)])


@given(BYTES)
def test_stuffing_is_undone_and_leaves_no_header(body: bytes) -> None:
    stuffed = stuff(body)
    assert unstuff(stuffed) == body
    at = stuffed.find(HEADER)
    while at >= 0:
        assert stuffed[at + 3 : at + 4] == b"\xfd"
        at = stuffed.find(HEADER, at + 1)


@given(IDS, st.sampled_from([Instruction.WRITE, Instruction.SYNC_WRITE]), BYTES)
def test_instruction_with_any_parameters_is_understood(servo_id: int, code: int, parameters: bytes) -> None:
    packet = build(servo_id, code, parameters)
    assert InstructionParser().feed(packet, 0) == [Command(servo_id, code, parameters, len(packet))]


@given(IDS, st.integers(0, 0x87), BYTES)
def test_status_with_any_parameters_is_understood(servo_id: int, error: int, data: bytes) -> None:
    (answer,) = answers(status_packet(servo_id, error, data))
    assert (answer.servo_id, answer.error, answer.data) == (servo_id, error, data)


@given(st.lists(st.tuples(IDS, BYTES), min_size=1, max_size=5), st.data())
def test_how_the_stream_is_cut_makes_no_difference(packets: list[tuple[int, bytes]], data: st.DataObject) -> None:
    stream = b"".join(build(i, Instruction.WRITE, parameters) for i, parameters in packets)
    parser = InstructionParser()
    found = []
    while stream:
        cut = data.draw(st.integers(1, len(stream)))
        found += parser.feed(stream[:cut], 0)
        stream = stream[cut:]
    assert [(p.servo_id, p.parameters) for p in found if isinstance(p, Command)] == packets


@given(st.lists(st.tuples(IDS, st.integers(0, 0x87), st.binary(min_size=4, max_size=4)), min_size=1, max_size=9))
def test_every_block_of_a_fast_reply_has_the_crc_of_all_before_it(blocks: list[tuple[int, int, bytes]]) -> None:
    reply = b"".join(fast_status([FastBlock(*block) for block in blocks]))
    assert int.from_bytes(reply[5:7], "little") == len(reply) - 7
    for end in range(8 + 8, len(reply) + 1, 8):
        assert crc16(reply[: end - 2]) == int.from_bytes(reply[end - 2 : end], "little")


def some_instruction(random_: random.Random) -> bytes:
    """A plausible instruction to servos 1 to 4."""
    servo_id = random_.choice((1, 2, 3, 4, 0xFE))
    code = random_.choice((*Instruction, random_.randrange(256)))
    parameters = random_.choice(
        (
            b"",
            word(random_.randrange(670)) + word(random_.randrange(20)),
            word(random_.choice((7, 11, 64, 100, 102, 116, 224))) + random_.randbytes(random_.randrange(1, 6)),
            word(102) + word(2) + b"".join(bytes((i,)) + random_.randbytes(2) for i in (1, 2, 3)),
            random_.randbytes(random_.randrange(40)),
        )
    )
    return build(servo_id, int(code), parameters)


def spoiled(packet: bytes, random_: random.Random) -> bytes:
    """The packet with bytes flipped, cut out, repeated or put in."""
    data = bytearray(packet)
    for _ in range(random_.randrange(1, 4)):
        at = random_.randrange(len(data)) if data else 0
        match random_.randrange(5):
            case 0 if data:
                data[at] ^= 1 << random_.randrange(8)
            case 1:
                del data[at : at + random_.randrange(1, 5)]
            case 2:
                data[at:at] = data[at : at + 4]
            case 3:
                data[at:at] = random_.choice((b"\xff\xff\xfd", b"\xff", b"\xfd", random_.randbytes(3)))
            case 4:
                del data[at:]
    return bytes(data)


@PACKETS
def test_no_spoiled_packet_with_a_wrong_crc_is_accepted(packets: int) -> None:
    random_ = random.Random(20)
    parser = InstructionParser()
    accepted = damaged = 0
    for _ in range(packets // 50):
        stream = b"".join(
            random_.randbytes(random_.randrange(30))
            if random_.random() < 0.1
            else spoiled(some_instruction(random_), random_)
            for _ in range(50)
        )
        for packet in parser.feed(stream, 0):
            if not isinstance(packet, Command):
                damaged += 1
                continue
            accepted += 1
            body = stuff(bytes((packet.instruction,)) + packet.parameters)
            front = HEADER + bytes((0, packet.servo_id)) + (len(body) + 2).to_bytes(2, "little")
            whole = front + body
            assert whole + crc16(whole).to_bytes(2, "little") in stream
        parser.reset()
    assert accepted > packets // 100
    assert damaged > packets // 100


def registers_in_range(servo: Servo) -> bool:
    memory = servo.firmware.memory
    for register in memory.layout.by_name.values():
        if register.minimum is None or register.maximum is None:
            continue
        value = memory.get(register)
        tripped = register.name == table.BUS_WATCHDOG.name and value == WATCHDOG_TRIPPED
        if not (tripped or register.minimum <= value <= register.maximum):
            return False
    return True


@PACKETS
def test_servos_survive_packets_of_any_kind_and_keep_their_registers_in_range(packets: int) -> None:
    random_ = random.Random(21)
    replies = 0
    for _ in range(packets // 500):
        servos = [xm430(1), xm430(2), xm430(3, secondary_id=2), xl430(4, firmware=40)]
        bench = Bench(*servos, options=BusOptions(unstuffed_header=UnstuffedHeader.ACCEPTED))
        for _ in range(500):
            bench.now_ns += 1_000_000
            packet = some_instruction(random_)
            bench.raw(packet if random_.random() < 0.5 else spoiled(packet, random_))
            bench.bus.tick(bench.now_ns)
        for servo in servos:
            assert registers_in_range(servo)
            assert math.isfinite(servo.firmware.body.step(1e-3, alive=True))
        replies += bench.bus.counters.replies
    assert replies > packets // 10
