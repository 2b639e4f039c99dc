"""Whether adapter and bus are quick enough for the rate: latency timer, computed cycle, and a read that is measured."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.budget import CycleBudget, LinkTiming, cycle_budget
from drivers.dynamixel.errors import PortError
from drivers.dynamixel.line.bus import Bus
from drivers.dynamixel.line.group import GroupRead
from drivers.dynamixel.line.port import Now, Port
from drivers.dynamixel.servo.table import PRESENT_CURRENT
from drivers.interface import ConnectError

SHARE = 0.6  # of the period for the read: the rest is for control step, write and checks
WAIT_NS = 200_000_000
MAX_LATENCY_TIMER_MS = 2
_SLOW_TIMER_S = 5e-3  # more than this above the wire time is a latency timer, not a cable


class PaceError(ConnectError):
    """The bus cannot carry the configured rate."""


@dataclass(frozen=True, slots=True)
class ReadTimes:
    """Measured duration of the cycle's read, s."""

    median_s: float
    p99_s: float
    missed: int  # reads that did not bring every servo
    reads: int


def check_latency_timer(port: Port, arm: ArmMap) -> None:
    """Raise PortError for an adapter that keeps answers back; the port must be open."""
    timer = port.latency_timer_ms
    if timer is not None and timer > MAX_LATENCY_TIMER_MS:
        raise PortError(
            f"port {arm.port}: USB latency timer",
            found=f"{timer} ms",
            expected="1 ms",
            remedy="install the udev rule shipped in systemd/, then unplug and plug the adapter",
        )


def measure_read(bus: Bus, arm: ArmMap, clock: Now, *, fast: bool, reads: int = 20) -> ReadTimes:
    """Read the cycle's block a number of times, as fast as it goes."""
    group = GroupRead(PRESENT_CURRENT.address, "hii", [slot.servo_id for slot in arm.slots], fast=fast)
    durations, missed = [], 0
    for _ in range(reads):
        bus.port.discard_input()
        begin_ns = clock.now_ns()
        reply = bus.exchange(group, begin_ns + WAIT_NS).reply
        durations.append((clock.now_ns() - begin_ns) * 1e-9)
        missed += not reply.complete
    durations.sort()
    return ReadTimes(durations[reads // 2], durations[(reads * 99) // 100], missed, reads)


def check_rate(arm: ArmMap, *, fast: bool, link: LinkTiming | None = None) -> CycleBudget:
    """Computed budget of the cycle.  Raises PaceError, with the highest rate that fits, when the wire is too slow."""
    budget = cycle_budget(arm, fast=fast, link=link)
    if arm.rate_hz > budget.rate_max_hz:
        raise PaceError(
            f"arm {arm.arm}: rate on {arm.port}",
            found=f"{arm.rate_hz:g} Hz",
            expected=f"at most {budget.rate_max_hz:g} Hz for {len(arm.slots)} servos at {arm.baud} bit/s",
            remedy="lower rate_hz, or raise the servos' Baud Rate and `baud`",
        )
    return budget


def check_read(bus: Bus, arm: ArmMap, clock: Now, *, fast: bool, link: LinkTiming, share: float = SHARE) -> ReadTimes:
    """Measure, and refuse a read that takes more than `share` of the period.

    Raises PaceError naming the likely setting.
    """
    times = measure_read(bus, arm, clock, fast=fast)
    allowed_s = share / arm.rate_hz
    if times.median_s > allowed_s:
        excess_s = times.median_s - cycle_budget(arm, fast=fast, link=link).read_mean_s
        if excess_s > _SLOW_TIMER_S:
            remedy = "set the USB adapter's latency timer to 1 ms (install the udev rule); it looks like 16"
        else:
            remedy = "lower rate_hz, raise the baud rate, and check that Return Delay Time is 0"
        raise PaceError(
            f"arm {arm.arm}: read of all servos on {arm.port}",
            found=f"{times.median_s * 1e3:.2f} ms",
            expected=f"at most {allowed_s * 1e3:.2f} ms at {arm.rate_hz:g} Hz",
            remedy=remedy,
        )
    return times
