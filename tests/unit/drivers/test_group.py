"""Group reads and writes byte by byte: what is believed, what is damaged, what is late, when the waiting ends."""

from __future__ import annotations

import random
import struct
from collections.abc import Mapping, Sequence
from itertools import permutations

import pytest

from drivers.dynamixel.cycle import marked_groups
from drivers.dynamixel.line import codec
from drivers.dynamixel.line.codec import MAX_PACKET
from drivers.dynamixel.line.group import GroupRead, GroupReply, GroupWrite, Row
from drivers.dynamixel.servo.codes import Instruction

IDS = (4, 9, 2, 7, 1, 30, 5)
MANY = tuple(range(60, 30, -1))  # so many that the length of a merged reply needs its second byte
NONE = [None] * len(IDS)
EVEN, ODD = 10, 9  # bytes of data: checksums go by words for the one and by bytes for the other
HEAD = 8  # bytes before the first block of a merged reply
BLOCK = EVEN + 4


def data_of(servo_id: int, length: int = EVEN) -> bytes:
    """Other bytes for every servo."""
    return random.Random(servo_id).randbytes(length)


def merged(ids: Sequence[int], length: int = EVEN, errors: Mapping[int, int] | None = None) -> bytes:
    """A merged reply: each servo appends its block and the checksum of all before."""
    size = 1 + len(ids) * (length + 4)
    reply = codec.HEADER + bytes((0xFE, size & 0xFF, size >> 8, Instruction.STATUS))
    for servo_id in ids:
        reply += bytes(((errors or {}).get(servo_id, 0), servo_id)) + data_of(servo_id, length)
        reply += codec.crc16(reply).to_bytes(2, "little")
    return reply


def each(ids: Sequence[int], length: int = EVEN, errors: Mapping[int, int] | None = None) -> bytes:
    """A status packet from each."""
    return b"".join(codec.status(i, (errors or {}).get(i, 0), data_of(i, length)) for i in ids)


def rows_of(ids: Sequence[int], errors: Mapping[int, int] | None = None) -> list[Row | None]:
    return [((errors or {}).get(i, 0), *struct.unpack("<hii", data_of(i))) for i in ids]


def hit(data: bytes, *places: int) -> bytes:
    """With one bit of each of these bytes flipped."""
    return bytes(byte ^ 0x10 if place in places else byte for place, byte in enumerate(data))


def late_and_damaged(ids: Sequence[int], asked_for: Sequence[int], length: int) -> bytes:
    """An answer to other IDs in which only those blocks are intact whose place fits what was asked for."""
    hits = [place * (length + 4) + HEAD + 4 for place, i in enumerate(ids) if i != asked_for[place]]
    return hit(merged(ids, length), *hits)


def read(ids: Sequence[int] = IDS, *, fast: bool = True, **how: int) -> GroupRead:
    return GroupRead(126, "hii", ids, fast=fast, **how)


def said(reply: GroupReply) -> tuple[bool, int, int]:
    return reply.finished, reply.damaged, reply.late


# --- whole answers ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ids", [IDS, MANY, (3,)])
@pytest.mark.parametrize("fast", [True, False])
def test_a_whole_answer_is_a_row_for_each_in_the_order_asked_for(ids: tuple[int, ...], fast: bool) -> None:
    group, errors = read(ids, fast=fast), {ids[0]: 0x84, ids[-1]: 0x80}
    answer = (merged if fast else each)(ids, errors=errors)
    assert (group.ids, group.fast, group.data_length, group.reply_bytes) == (ids, fast, EVEN, len(answer))
    assert group.request == codec.sync_read(126, EVEN, ids, fast=fast)
    for final in (False, True):
        reply = group.parse(answer, final=final)
        assert reply.rows == rows_of(ids, errors)
        assert said(reply) == (True, 0, 0)
        assert reply.complete


def test_a_servo_without_an_alert_has_its_error_alone() -> None:
    rows = read(fast=False).parse(each(IDS, errors={9: 3}), final=True).rows
    assert [row[0] for row in rows if row] == [0, 3, 0, 0, 0, 0, 0]


@pytest.mark.parametrize("length", [EVEN, ODD, 11])
def test_damage_voids_its_own_block_and_a_damaged_checksum_the_next_one_too(length: int) -> None:
    group, block = GroupRead(126, f"{length}B", IDS, fast=True), length + 4
    whole: list[Row | None] = [(0, *data_of(i, length)) for i in IDS]
    for place in range(len(IDS)):
        for byte in range(block):
            void = {place, place + 1} & set(range(len(IDS))) if byte >= block - 2 else {place}
            reply = group.parse(hit(merged(IDS, length), HEAD + place * block + byte), final=False)
            assert reply.rows == [None if i in void else row for i, row in enumerate(whole)]
            assert said(reply) == (True, len(void), 0)
            assert not reply.complete


def test_a_reply_must_fit_in_the_longest_packet() -> None:
    assert GroupRead(0, f"{MAX_PACKET - 12}B", [1], fast=True).reply_bytes == MAX_PACKET
    for fast, over in ((True, 11), (False, 10)):
        with pytest.raises(ValueError, match=f"{MAX_PACKET + 1} bytes: at most {MAX_PACKET}"):
            GroupRead(0, f"{MAX_PACKET - over}B", [1], fast=fast)


# --- merged answers in parts -----------------------------------------------------------------------------------------


def test_a_merged_answer_is_waited_for_to_its_last_byte_and_what_is_there_at_the_end_counts() -> None:
    answer = merged(IDS)
    for cut in range(len(answer)):
        waiting, ended = (read().parse(answer[:cut], final=final) for final in (False, True))
        assert (waiting.rows, said(waiting)) == (NONE, (False, 0, 0))
        answered = max(0, cut - HEAD) // BLOCK
        assert ended.rows == rows_of(IDS[:answered]) + NONE[answered:]
        assert said(ended) == (True, 0, 0)


def test_what_comes_before_an_answer_is_passed_over() -> None:
    answer = merged(IDS)
    assert read().parse(b"\x00" + answer, final=False).rows == rows_of(IDS)
    reply = read().parse(answer[:HEAD] + answer, final=False)  # the first head has seven blocks behind it, none intact
    assert reply.rows == rows_of(IDS)
    assert said(reply) == (True, 7, 0)
    reply = read().parse(answer[:HEAD] + hit(answer, HEAD), final=False)
    assert said(reply) == (True, 7 + 1, 0)
    reply = read().parse(merged(IDS[::-1]) + merged(IDS[::-1]) + answer, final=False)
    assert reply.rows == rows_of(IDS)
    assert said(reply) == (True, 0, 2)


def test_an_answer_to_another_order_is_late_even_where_one_servo_has_the_same_place() -> None:
    reply = read().parse(merged(IDS[::-1]), final=True)  # the one in the middle has it
    assert (reply.rows, said(reply)) == (NONE, (True, 0, 1))
    reply = read().parse(merged((IDS[0], *IDS[:0:-1])), final=True)  # begins right: that is proof enough
    assert reply.rows == [*rows_of(IDS[:1]), *NONE[1:]]
    assert said(reply) == (True, 6, 0)


def test_two_blocks_of_proof_are_the_first_two_or_any_two_where_none_contradicts() -> None:
    group, answer = read(proof=2), merged(IDS)
    one = group.parse(answer[: HEAD + BLOCK], final=True)
    assert (one.rows, said(one)) == (NONE, (True, 0, 0))
    one = group.parse(hit(answer[: HEAD + 2 * BLOCK], HEAD + BLOCK), final=True)
    assert (one.rows, said(one)) == (NONE, (True, 1, 0))
    two = group.parse(hit(answer[: HEAD + 3 * BLOCK], HEAD), final=True)
    assert two.rows == [None, *rows_of(IDS[1:3]), *NONE[3:]]
    assert said(two) == (True, 1, 0)
    begun_right = group.parse(merged((*IDS[:2], *IDS[:1:-1])), final=True)
    assert begun_right.rows[:2] == rows_of(IDS[:2])
    assert begun_right.late == 0
    begun_wrong = group.parse(merged((IDS[1], IDS[0], *IDS[2:])), final=True)
    assert (begun_wrong.rows, said(begun_wrong)) == (NONE, (True, 0, 1))
    begun_half_right = group.parse(merged((IDS[0], *IDS[2:0:-1], *IDS[3:])), final=True)
    assert (begun_half_right.rows, said(begun_half_right)) == (NONE, (True, 0, 1))


# --- one packet each -------------------------------------------------------------------------------------------------


def test_the_last_servo_s_packet_ends_the_wait_whoever_is_missing() -> None:
    group = read(fast=False)
    assert said(group.parse(each(IDS[:-1]), final=False)) == (False, 0, 0)
    assert said(group.parse(each(IDS[:-1]), final=True)) == (True, 0, 0)
    ended = group.parse(each((IDS[0], IDS[-1], IDS[1])), final=False)
    assert ended.rows == [*rows_of(IDS[:2]), *NONE[2:-1], *rows_of(IDS[-1:])]
    assert said(ended) == (True, 0, 0)


def test_packets_of_others_and_of_another_length_are_late_and_damaged_ones_are_counted() -> None:
    group = read(fast=False)
    strange = each((11,)) + each(IDS[:2], EVEN + 1) + each(IDS[:1])
    reply = group.parse(strange, final=True)
    assert reply.rows == [*rows_of(IDS[:1]), *NONE[1:]]
    assert said(reply) == (True, 0, 3)
    reply = group.parse(hit(each(IDS), EVEN), final=False)
    assert reply.rows == [None, *rows_of(IDS[1:])]
    assert said(reply) == (True, 1, 0)


# --- worth parsing ---------------------------------------------------------------------------------------------------


def test_a_merged_answer_is_worth_parsing_from_its_last_byte_on() -> None:
    group = read()
    mark = codec.HEADER + bytes((IDS[-1],))
    assert not group.worth_parsing(mark + bytes(group.reply_bytes - 1 - len(mark)))
    assert group.worth_parsing(bytes(group.reply_bytes))
    assert group.worth_parsing(bytes(group.reply_bytes + 1))


def test_packets_are_worth_parsing_from_the_last_servo_s_header_on() -> None:
    group = read(fast=False)
    before = each(IDS[:-1])
    assert not group.worth_parsing(before)
    assert not group.worth_parsing(before + codec.HEADER)
    assert group.worth_parsing(before + codec.HEADER + bytes((IDS[-1],)))
    assert not group.worth_parsing(bytes(group.reply_bytes - 1))
    assert group.worth_parsing(bytes(group.reply_bytes))


# --- writes ----------------------------------------------------------------------------------------------------------


def test_a_write_is_the_general_builder_s_for_every_value() -> None:
    group = GroupWrite(100, "h", IDS)
    assert group.ids == IDS
    for value in range(-600, 600):
        values = [value + i for i in range(len(IDS))]
        data = {i: struct.pack("<h", v) for i, v in zip(IDS, values, strict=True)}
        assert group.packet(values) == codec.sync_write(100, 2, data)


def test_a_write_that_looks_like_a_header_is_stuffed() -> None:
    packet = GroupWrite(116, "i", [1, 2]).packet([-131073, -3])  # FF FF FD FF after ID 1
    assert packet == codec.sync_write(116, 4, {1: b"\xff\xff\xfd\xff", 2: b"\xfd\xff\xff\xff"})
    assert packet.count(b"\xff\xff\xfd\xfd") == 1


@pytest.mark.parametrize("count", range(2, 10))
def test_no_old_row_is_believed_of_an_answer_to_any_other_request_of_which_all_that_contradicts_is_damaged(
    count: int,
) -> None:
    for group, other in permutations(marked_groups(tuple(range(1, count + 1)), fast=True), 2):
        old = late_and_damaged(other.ids, group.ids, other.data_length)
        assert group.parse(old, final=True).rows == [None] * count, (group.ids, other.ids)
        reply = group.parse(old + merged(group.ids, group.data_length), final=True)
        assert None not in reply.rows
