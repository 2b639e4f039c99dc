"""The scanner of status packets: it finds each one behind anything, and counts what that was."""

from __future__ import annotations

import pytest

from drivers.dynamixel.line import codec
from drivers.dynamixel.line.codec import StatusScanner


def test_scanner_finds_packets_between_garbage_and_echo():
    scanner = StatusScanner()
    scanner.feed(b"\x00\xff\xff" + codec.ping(1) + codec.status(1, 0, b"ab")[:-3])
    assert scanner.take() is None
    scanner.feed(codec.status(1, 0, b"ab")[-3:] + b"\xff" + codec.status(2, 0, b"cd"))
    assert [scanner.take(), scanner.take(), scanner.take()] == [(1, 0, False, b"ab"), (2, 0, False, b"cd"), None]
    assert (scanner.foreign, scanner.damaged, scanner.garbage) == (1, 0, 4)


def test_scanner_finds_a_packet_hidden_behind_a_wrong_length():
    hidden = codec.status(2, 0, b"ab")
    liar = b"\xff\xff\xfd\x00\x01\x90\x01\x55\x00"
    scanner = StatusScanner()
    scanner.feed(liar + hidden)
    assert scanner.take() is None
    assert scanner.take(final=True) == (2, 0, False, b"ab")
    assert (scanner.damaged, scanner.cut) == (0, 1)


def test_scanner_never_holds_more_than_a_packet():
    scanner = StatusScanner()
    for _ in range(100):
        scanner.feed(b"\xff\xff\xfd\x00\x01\xf0\x03\x55" * 100)
        while scanner.take() is not None:
            pass
        assert len(scanner._buffer) <= codec.MAX_PACKET
    assert scanner.take(final=True) is None


def counts(scanner):
    return scanner.damaged, scanner.cut, scanner.foreign, scanner.garbage


def wrong_sum(packet):
    return packet[:-1] + bytes((packet[-1] ^ 0xFF,))


def with_sum(packet):
    return packet + codec.crc16(packet).to_bytes(2, "little")


HEAD = codec.HEADER + b"\x01"
FOLLOWING = codec.status(2, 0, b"ab")


@pytest.mark.parametrize(
    ("before", "expected"),  # damaged, cut, foreign, bytes of garbage
    [
        (b"", (0, 0, 0, 0)),
        (b"\0" * 9, (0, 0, 0, 9)),
        (codec.ping(1), (0, 0, 1, 0)),
        (codec.ping(1) * 2, (0, 0, 2, 0)),
        (wrong_sum(codec.status(1)), (1, 0, 0, 7)),  # its header alone is given up, the rest may hide another
        (with_sum(HEAD + b"\x08\x00\x55\x00\xff\xff\xfd\x01"), (1, 0, 0, 13 - 2)),  # not stuffed
        (with_sum(HEAD + b"\x02\x00"), (1, 0, 0, 5)),  # no room for an instruction
        (HEAD + b"\xfa\x03", (1, 0, 0, 3)),  # longer than a packet can be
    ],
    ids=["nothing", "garbage", "echo", "two echoes", "checksum", "stuffing", "too short", "too long"],
)
def test_a_packet_is_found_behind_anything_and_what_that_was_is_counted(before, expected):
    scanner = StatusScanner()
    scanner.feed(before + FOLLOWING)
    assert scanner.take() == (2, 0, False, b"ab")
    assert counts(scanner) == expected


def test_a_packet_is_waited_for_byte_by_byte_as_long_as_one_can_be():
    packet = codec.status(2, 0, b"a" * 1013)
    scanner = StatusScanner()
    for place in range(len(packet) - 1):
        scanner.feed(packet[place : place + 1])
        assert scanner.take() is None
    scanner.feed(packet[-1:])
    assert scanner.take() == (2, 0, False, b"a" * 1013)
    assert counts(scanner) == (0, 0, 0, 0)


@pytest.mark.parametrize(
    ("end", "expected"),
    [
        (HEAD, (0, 1, 0, 0)),
        (HEAD + b"\x04\x00", (0, 1, 0, 0)),
        (HEAD + b"\x02\x00", (1, 0, 0, 0)),
        (HEAD + b"\x04\x00\x55\x00", (0, 1, 0, 2)),
        (FOLLOWING[:-1], (0, 1, 0, 12 - 4 - 3)),
    ],
)
def test_what_ends_too_early_is_cut_once_nothing_more_comes(end, expected):
    """The last three bytes stay: they could begin a packet."""
    scanner = StatusScanner()
    scanner.feed(end)
    assert scanner.take(final=True) is None
    assert counts(scanner) == expected


def test_each_byte_of_garbage_counts_and_the_oldest_are_dropped():
    scanner = StatusScanner()
    scanner.feed(bytes(1020))
    assert scanner.garbage == 0
    scanner.feed(bytes(5))
    assert scanner.garbage == 1
    assert scanner.take() is None
    assert scanner.garbage == 1025 - 3


def test_what_was_received_can_be_forgotten_and_is_no_part_of_what_comes():
    scanner = StatusScanner()
    scanner.feed(FOLLOWING[:9])
    scanner.clear()
    scanner.feed(FOLLOWING[9:])
    assert scanner.take() is None
