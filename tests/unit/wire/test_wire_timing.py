"""When bytes reach the host, on virtual time."""

from __future__ import annotations

import pytest

from sim_backend.wire.timing import BusTiming, Delivery, Line, UsbBuffer, UsbTiming, byte_ns

MS = 1_000_000


def test_a_byte_takes_ten_bits() -> None:
    assert byte_ns(1_000_000) == 10_000.0
    assert byte_ns(57_600) == pytest.approx(173_611.1, rel=1e-6)


def test_without_an_adapter_bytes_arrive_when_they_end_on_the_wire() -> None:
    assert UsbBuffer(None).push(1000, 10_000.0, b"abc") == [Delivery(31_000, b"abc")]


def test_short_reply_waits_for_the_latency_timer() -> None:
    usb = UsbBuffer(UsbTiming(latency_ns=MS, drift_ppm=0))
    assert usb.push(200_000, 10_000.0, b"abc") == []
    assert usb.due_ns() == MS
    assert usb.settle(MS - 1) == []
    assert usb.settle(MS) == [Delivery(MS, b"abc")]
    assert usb.due_ns() is None


def test_latency_timer_of_16_ms_holds_a_reply_16_times_longer() -> None:
    usb = UsbBuffer(UsbTiming(latency_ns=16 * MS, drift_ppm=0))
    usb.push(200_000, 10_000.0, b"abc")
    assert usb.due_ns() == 16 * MS


def test_timer_that_fires_inside_a_reply_splits_it() -> None:
    usb = UsbBuffer(UsbTiming(latency_ns=MS, drift_ppm=0))
    data = bytes(range(100))
    (first,) = usb.push(500_000, 10_000.0, data)
    assert first == Delivery(MS, data[:50])
    assert usb.settle(2 * MS) == [Delivery(2 * MS, data[50:])]


def test_timer_that_fires_before_the_first_byte_ends_delivers_nothing() -> None:
    usb = UsbBuffer(UsbTiming(latency_ns=MS, drift_ppm=0))
    assert usb.push(MS - 5_000, 10_000.0, b"ab") == []
    assert usb.due_ns() == 2 * MS


def test_full_usb_packet_does_not_wait_and_restarts_the_timer() -> None:
    usb = UsbBuffer(UsbTiming(latency_ns=MS, payload_bytes=62, drift_ppm=0))
    data = bytes(range(70))
    assert usb.push(0, 10_000.0, data) == [Delivery(620_000, data[:62])]
    assert usb.due_ns() == 620_000 + MS
    assert usb.settle(2 * MS) == [Delivery(620_000 + MS, data[62:])]


def test_no_byte_is_lost_or_reordered_by_any_split() -> None:
    usb = UsbBuffer(UsbTiming(latency_ns=300_000, payload_bytes=17))
    data = bytes(range(250)) * 2
    out = []
    at = 0
    for start in range(0, 500, 10):
        out += usb.push(start * 13_000, 10_000.0, data[start : start + 10])
        at = start * 13_000
    out += usb.settle(at + MS)
    assert b"".join(piece for _, piece in out) == data
    assert [due for due, _ in out] == sorted(due for due, _ in out)


def test_reply_follows_request_and_turnaround_on_the_wire() -> None:
    line = Line(BusTiming(turnaround_ns=30_000, usb=None))
    assert line.request(0, 14, 1_000_000)
    assert line.reply(21, 1_000_000, 30_000) == 140_000 + 30_000
    assert line.free_ns == 170_000 + 210_000


def test_instruction_during_a_reply_collides() -> None:
    line = Line(BusTiming(usb=None))
    line.request(0, 14, 1_000_000)
    line.reply(100, 1_000_000, 0)
    assert not line.request(500_000, 14, 1_000_000)
    assert line.request(line.reply_end_ns, 14, 1_000_000)


def test_two_instructions_in_a_row_queue_without_collision() -> None:
    line = Line(BusTiming(usb=None))
    assert line.request(0, 41, 1_000_000)
    assert line.request(50_000, 23, 1_000_000)
    assert line.free_ns == (41 + 23) * 10_000


def test_without_timing_the_line_is_never_busy() -> None:
    line = Line(None)
    assert line.request(7, 1000, 1_000_000)
    assert line.reply(1000, 1_000_000, 500_000) == 7


def test_loop_at_a_multiple_of_the_latency_sees_every_phase_of_the_timer() -> None:
    usb = UsbBuffer(UsbTiming(latency_ns=MS))
    waits = []
    for cycle in range(1000):
        end_ns = cycle * 5 * MS + 20_000
        usb.push(end_ns - 20_000, 10_000.0, b"ab")
        due_ns = usb.due_ns()
        assert due_ns is not None
        waits.append(due_ns - end_ns)
        usb.settle(due_ns)
    assert min(waits) < 0.05 * MS
    assert max(waits) > 0.95 * MS
