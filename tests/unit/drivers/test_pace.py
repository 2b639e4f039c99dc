"""The measured and the computed pace of a bus, on a line whose every answer takes as long as the test says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest

from drivers.dynamixel.budget import LinkTiming, cycle_budget
from drivers.dynamixel.line import codec
from drivers.dynamixel.line.bus import Bus, DxlCounters
from drivers.dynamixel.pace import PaceError, ReadTimes, check_rate, check_read, measure_read
from drivers.dynamixel.servo.codes import Instruction
from tests.support.servos.dxl_rig import WX200, at

US, MS = 1_000, 1_000_000
NEVER_NS = 86_400_000 * MS
IDS = tuple(range(1, 8))
SLOW_CABLE = LinkTiming(usb_latency_s=2e-3)  # with WX200 and merged replies a read takes 2.34 ms on average


class Line:
    """A port and its clock: the answers take what the list says, one after the other, then the last one for ever."""

    baud = 1_000_000

    def __init__(self, took_ns: Sequence[int]) -> None:
        self.ns = 1_000 * MS
        self.took_ns = list(took_ns)
        self.requests: list[bytes] = []
        self.allowed_ns: list[int] = []  # for each answer
        self.discarded = 0
        self._answers: list[tuple[int, bytes]] = []

    def now_ns(self) -> int:
        return self.ns

    def discard_input(self) -> int:
        self.discarded += 1
        self._answers.clear()
        return 0

    def write(self, data: bytes, deadline_ns: int) -> None:
        took_ns = self.took_ns.pop(0) if len(self.took_ns) > 1 else self.took_ns[0]
        self.requests.append(data)
        self.allowed_ns.append(deadline_ns - self.ns)
        self._answers.append((self.ns + took_ns, answer(data)))

    def read_until(self, deadline_ns: int) -> bytes:
        due_ns, data = self._answers.pop(0) if self._answers else (NEVER_NS, b"")
        if due_ns > deadline_ns:
            self._answers.insert(0, (due_ns, data))
            due_ns, data = deadline_ns, b""
        self.ns = max(self.ns, due_ns)
        return data


def answer(request: bytes) -> bytes:
    """What all servos answer to a group read: zeros."""
    length, ids = int.from_bytes(request[10:12], "little"), request[12:-2]
    if request[7] == Instruction.SYNC_READ:
        return b"".join(codec.status(servo_id, 0, bytes(length)) for servo_id in ids)
    size = 1 + len(ids) * (length + 4)
    reply = codec.HEADER + bytes((0xFE, size & 0xFF, size >> 8, Instruction.STATUS))
    for servo_id in ids:
        reply += bytes((0, servo_id, *bytes(length)))
        reply += codec.crc16(reply).to_bytes(2, "little")
    return reply


def bus_of(line: Line) -> Bus:
    port: Any = line
    return Bus(port, line, DxlCounters())


def measured(took_ns: Sequence[int], **how: int) -> tuple[ReadTimes, Line]:
    line = Line(took_ns)
    return measure_read(bus_of(line), WX200, line, fast=True, **how), line


# --- measured --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fast", [True, False])
def test_what_is_measured_is_the_read_of_the_cycle(fast: bool) -> None:
    line = Line([2 * MS])
    times = measure_read(bus_of(line), WX200, line, fast=fast)
    assert line.requests == 20 * [codec.sync_read(126, 10, IDS, fast=fast)]
    assert (times.missed, times.reads) == (0, 20)
    assert [times.median_s, times.p99_s] == pytest.approx([2e-3, 2e-3])


def test_the_median_and_the_slowest_percent_are_of_the_sorted_times() -> None:
    times, _ = measured([(i * 37 % 20 + 1) * MS for i in range(20)])
    assert times.median_s == pytest.approx(11e-3)
    assert times.p99_s == pytest.approx(20e-3)
    times, _ = measured([(200 - i) * US for i in range(200)], reads=200)
    assert [times.median_s, times.p99_s] == pytest.approx([101e-6, 199e-6])


def test_a_read_without_its_answer_is_missed_and_waited_for_200_ms() -> None:
    times, line = measured([1 * MS, NEVER_NS, 3 * MS, NEVER_NS, 5 * MS], reads=5)
    assert (times.missed, times.reads) == (2, 5)
    assert [times.median_s, times.p99_s] == pytest.approx([5e-3, 0.2])
    assert line.allowed_ns == 5 * [200 * MS]


def test_no_answer_to_an_earlier_read_is_taken_for_this_one_s() -> None:
    times, line = measured([201 * MS, 2 * MS], reads=2)
    assert line.discarded == 2
    assert times.missed == 1
    assert times.p99_s == pytest.approx(0.2)
    assert line.ns == 1_000 * MS + 202 * MS


# --- computed --------------------------------------------------------------------------------------------------------


def test_the_highest_rate_that_fits_is_accepted_and_its_budget_given() -> None:
    budget = cycle_budget(WX200, fast=True, link=SLOW_CABLE)
    fits = at(WX200, rate_hz=budget.rate_max_hz)
    assert check_rate(fits, fast=True, link=SLOW_CABLE) == budget
    with pytest.raises(
        PaceError, match=f"found {budget.rate_max_hz + 1:g} Hz, expected at most {budget.rate_max_hz:g}"
    ):
        check_rate(at(WX200, rate_hz=budget.rate_max_hz + 1), fast=True, link=SLOW_CABLE)


def test_plain_reads_and_a_slower_adapter_make_the_highest_rate_lower() -> None:
    rate = cycle_budget(WX200, fast=True).rate_max_hz
    check_rate(at(WX200, rate_hz=rate), fast=True)
    with pytest.raises(PaceError, match="for 7 servos at 1000000 bit/s"):
        check_rate(at(WX200, rate_hz=rate), fast=False)
    with pytest.raises(PaceError, match="lower rate_hz"):
        check_rate(at(WX200, rate_hz=rate), fast=True, link=SLOW_CABLE)


# --- both ------------------------------------------------------------------------------------------------------------


def refusal(took_ns: int, *, link: LinkTiming | None = None, rate_hz: float = 100.0, **how: Any) -> PaceError | None:
    """What a read of that length gets on WX200: nothing when it is let through."""
    line = Line([took_ns])
    arm = at(WX200, rate_hz=rate_hz)
    try:
        times = check_read(bus_of(line), arm, line, fast=True, link=link or LinkTiming(), **how)
    except PaceError as refused:
        return refused
    assert times.median_s == pytest.approx(took_ns * 1e-9)
    return None


def test_a_read_may_take_six_tenths_of_the_period() -> None:
    assert refusal(3 * MS, rate_hz=200.0) is None
    refused = refusal(3 * MS + US, rate_hz=200.0)
    assert refused is not None
    assert (refused.found, refused.expected) == ("3.00 ms", "at most 3.00 ms at 200 Hz")
    assert refusal(4 * MS, rate_hz=125.0, share=0.5) is None
    assert refusal(4 * MS + US, rate_hz=125.0, share=0.5) is not None
    assert refusal(6 * MS + US) is not None


def test_five_milliseconds_more_than_the_wire_takes_are_a_latency_timer() -> None:
    slow_wire, slow_timer = (refusal(7_340 * US + more_ns, link=SLOW_CABLE) for more_ns in (0, US))
    assert slow_wire is not None
    assert "lower rate_hz" in slow_wire.remedy
    assert slow_timer is not None
    assert "latency timer" in slow_timer.remedy


def test_a_slow_wire_is_known_by_what_its_servos_take() -> None:
    """A read that is slow because its servos answer one by one is no latency timer's."""
    line = Line([8 * MS])
    link = replace(SLOW_CABLE, turnaround_s=400e-6)
    with pytest.raises(PaceError, match="lower rate_hz"):
        check_read(bus_of(line), at(WX200, rate_hz=100.0), line, fast=False, link=link)
    with pytest.raises(PaceError, match="latency timer"):
        check_read(bus_of(line), at(WX200, rate_hz=100.0), line, fast=True, link=link)
