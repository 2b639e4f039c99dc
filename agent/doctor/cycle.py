"""How long the control cycle takes on an arm's bus: computed from its bytes, and measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from agent.verify.finding import Finding, Verdict, judged
from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.budget import CYCLE_BYTES, PLAIN_BYTES, CycleBudget, LinkTiming, cycle_budget, group_read_s
from drivers.dynamixel.line.bus import Bus
from drivers.dynamixel.line.group import GroupRead
from drivers.dynamixel.pace import SHARE, WAIT_NS
from drivers.dynamixel.servo.found import ServoFound
from drivers.dynamixel.servo.table import PRESENT_CURRENT, RETURN_DELAY_TIME
from drivers.dynamixel.servo.units import return_delay_s
from drivers.interface import Clock

READS = 200
AGREEMENT = 0.15
OVERHEAD_MAX_S = 0.5e-3
QUICK = 0.1  # a busy host delays most reads, but hardly the quickest tenth: that is where the bus itself is seen
_GOLDEN = 0.6180339887498949


@dataclass(frozen=True, slots=True)
class CycleFigures:
    """One arm's cycle, s; `read_*` and `overhead_s` are measured."""

    budget: CycleBudget  # of the bus as it is
    budget_set: CycleBudget  # once Return Delay Time is 0, which the agent sees to
    fast: bool
    overhead_s: float  # what USB, kernel and this program add to each exchange, by the read of a single servo
    read_quick_s: float  # what a share QUICK of all reads did not exceed
    read_median_s: float
    read_p99_s: float
    missed: int  # reads that did not bring every servo
    reads: int

    @property
    def computed_quick_s(self) -> float:
        """What `read_quick_s` must be without overhead: the adapter's wait is spread evenly over its whole timer."""
        return self.budget.request_s + self.budget.reply_s + QUICK * self.budget.usb_worst_s

    @property
    def deviation(self) -> float:
        """Measured, less the overhead, over computed, less 1: how right the budget's wire time is on this bus."""
        return (self.read_quick_s - self.overhead_s) / self.computed_quick_s - 1.0


def measure(
    bus: Bus, arm: ArmMap, servos: Sequence[ServoFound], clock: Clock, latency_timer_ms: int | None
) -> CycleFigures:
    """Read as the control loop does, at its rate.  All servos must be there.

    A reply waits in the USB adapter for the next tick of its latency timer.  Requests that follow each other at once,
    or in step with that timer, always see the same wait; so each is sent at another phase of it.
    """
    fast = all(servo.fast for servo in servos)
    delay_s = return_delay_s(sum(servo.value(RETURN_DELAY_TIME) for servo in servos) / len(servos))
    link = LinkTiming(
        return_delay_s=delay_s, usb_latency_s=1e-3 * (1 if latency_timer_ms is None else latency_timer_ms)
    )
    budget = cycle_budget(arm, fast=fast, link=link)
    group, single = (_block(ids, fast=fast) for ids in (_ids(arm), _ids(arm)[:1]))
    single_s = sum(group_read_s(1, single.data_length, arm.baud, fast=fast, link=link)) + QUICK * link.usb_latency_s
    alone, together = _Stopwatch(bus, clock), _Stopwatch(bus, clock)
    period_ns = max(arm.period_ns, round(1.5e9 * budget.read_worst_s))
    start_ns = clock.now_ns()
    for number in range(2 * READS):  # in turn, so that a host that gets busy slows both
        phase_ns = round(number // 2 * _GOLDEN % 1.0 * link.usb_latency_s * 1e9)
        clock.sleep_until(start_ns + number * period_ns + phase_ns)
        if number % 2:
            alone.time(single)
        else:
            together.time(group)
    return CycleFigures(
        budget,
        cycle_budget(arm, fast=fast, link=replace(link, return_delay_s=0.0)),
        fast,
        alone.share_s(QUICK) - single_s,
        together.share_s(QUICK),
        together.share_s(0.5),
        together.share_s(0.99),
        together.missed,
        READS,
    )


def _ids(arm: ArmMap) -> list[int]:
    return [slot.servo_id for slot in arm.slots]


def _block(ids: Sequence[int], *, fast: bool) -> GroupRead:
    """The control loop's read; without merged replies it asks for some bytes more, on average for these."""
    more = 0 if fast else PLAIN_BYTES - CYCLE_BYTES
    return GroupRead(PRESENT_CURRENT.address - more, f"{more}xhii" if more else "hii", ids, fast=fast)


class _Stopwatch:
    """Durations of one kind of read."""

    def __init__(self, bus: Bus, clock: Clock) -> None:
        self.missed = 0
        self._bus = bus
        self._clock = clock
        self._durations_s: list[float] = []

    def time(self, group: GroupRead) -> None:
        """Make one exchange."""
        self._bus.port.discard_input()
        begin_ns = self._clock.now_ns()
        reply = self._bus.exchange(group, begin_ns + WAIT_NS).reply
        self._durations_s.append((self._clock.now_ns() - begin_ns) * 1e-9)
        self.missed += not reply.complete

    def share_s(self, share: float) -> float:
        """What this share of the exchanges did not exceed."""
        return sorted(self._durations_s)[round(share * (len(self._durations_s) - 1))]


def judge(arm: ArmMap, figures: CycleFigures) -> list[Finding]:
    """The budget beside the measurement, and what the rate allows."""
    return [*_agreement(arm, figures), _share(arm, figures), _budget(arm, figures), _misses(arm, figures)]


def _ms(seconds: float) -> str:
    return f"{seconds * 1e3:.2f} ms"


def _agreement(arm: ArmMap, figures: CycleFigures) -> Sequence[Finding]:
    computed_s, measured_s = figures.computed_quick_s, figures.read_quick_s - figures.overhead_s
    return (
        judged(
            "read of all servos, measured", arm.arm, f"{_ms(measured_s)} ({figures.deviation:+.0%})",
            f"{_ms(computed_s)} computed, within {AGREEMENT:.0%}",
            holds=abs(figures.deviation) <= AGREEMENT, otherwise=Verdict.WARNING,
            remedy="the budget does not describe this bus: servos answer slower than others, or a USB hub is between",
        ),
        judged(
            "overhead of each read", arm.arm, _ms(figures.overhead_s), f"≤ {_ms(OVERHEAD_MAX_S)} for USB and this host",
            holds=figures.overhead_s <= OVERHEAD_MAX_S, otherwise=Verdict.WARNING,
            remedy="check the adapter's latency timer, a USB hub between, and what else this host is doing",
        ),
    )  # fmt: skip


def _share(arm: ArmMap, figures: CycleFigures) -> Finding:
    allowed_s = SHARE / arm.rate_hz
    median_set_s = figures.read_median_s - figures.budget.read_mean_s + figures.budget_set.read_mean_s
    found = f"{_ms(figures.read_median_s)} in the median, {_ms(figures.read_p99_s)} in the 99th percentile"
    return judged(
        "read in its period", arm.arm, found, f"≤ {_ms(allowed_s)}, {SHARE:.0%} of the period at {arm.rate_hz:g} Hz",
        holds=figures.read_p99_s <= allowed_s,
        otherwise=Verdict.REFUSED if median_set_s > allowed_s else Verdict.WARNING,
        remedy="lower rate_hz, raise the baud rate, check latency timer and Return Delay Time",
    )  # fmt: skip


def _budget(arm: ArmMap, figures: CycleFigures) -> Finding:
    budget = figures.budget_set
    parts = (
        f"read {_ms(budget.read_worst_s)}, step {_ms(budget.step_s)}, write {_ms(budget.write_s)}, "
        f"health {_ms(budget.health_s)}, {'fast' if figures.fast else 'plain'} sync read"
    )
    return judged(
        "cycle, computed worst", arm.arm, f"{_ms(budget.cycle_s)} ({parts})",
        f"≤ {_ms(1.0 / arm.rate_hz)}; this bus carries at most {budget.rate_max_hz:g} Hz",
        holds=arm.rate_hz <= budget.rate_max_hz,
        remedy=f"lower rate_hz to {budget.rate_max_hz:g}, or raise the servos' Baud Rate and `baud`",
    )  # fmt: skip


def _misses(arm: ArmMap, figures: CycleFigures) -> Finding:
    return judged(
        "replies", arm.arm, f"{figures.missed} of {figures.reads} reads incomplete", "0", holds=figures.missed == 0,
        otherwise=Verdict.REFUSED if figures.missed > figures.reads // 10 else Verdict.WARNING,
        remedy="check the cables and plugs of the chain, one by one",
    )  # fmt: skip
