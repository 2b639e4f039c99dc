"""How long the control cycle takes on this bus: computed from its bytes, and measured.  Never writes to a servo."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from agent.tools.finding import Finding, Verdict, judged
from agent.tools.servo_check import ServoState
from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.budget import CycleBudget, LinkTiming, cycle_budget
from drivers.dynamixel.bus import Bus
from drivers.dynamixel.cycle import marked_groups
from drivers.dynamixel.pace import SHARE, WAIT_NS
from drivers.dynamixel.table import RETURN_DELAY_TIME, RETURN_DELAY_UNIT_S
from drivers.interface import Clock

READS = 200
AGREEMENT = 0.15
_GOLDEN = 0.6180339887498949


@dataclass(frozen=True, slots=True)
class CycleFigures:
    """One arm's cycle, s; `read_*` are measured."""

    budget: CycleBudget  # of the bus as it is
    budget_set: CycleBudget  # once Return Delay Time is 0, which the agent sees to
    fast: bool
    read_median_s: float
    read_p99_s: float
    missed: int  # reads that did not bring every servo
    reads: int

    @property
    def deviation(self) -> float:
        """Measured median over computed mean, less 1.

        The wait in the adapter is spread evenly, so its median is its mean, and does not count how busy the host was.
        """
        return self.read_median_s / self.budget.read_mean_s - 1.0


def measure(
    bus: Bus, arm: ArmMap, states: Sequence[ServoState], clock: Clock, latency_timer_ms: int | None, reads: int = READS
) -> CycleFigures:
    """Read as the control loop does, at its rate.  All servos must be there.

    A reply waits in the USB adapter for the next tick of its latency timer.  Requests that follow each other at once,
    or in step with that timer, always see the same wait; so each is sent at another phase of it.
    """
    fast = all(_fast(state) for state in states)
    delay_s = sum(s.values.get(RETURN_DELAY_TIME.name, 0) for s in states) * RETURN_DELAY_UNIT_S / len(states)
    latency_s = 1e-3 if latency_timer_ms is None else latency_timer_ms * 1e-3
    budget = cycle_budget(arm, fast=fast, link=LinkTiming(return_delay_s=delay_s, usb_latency_s=latency_s))
    budget_set = cycle_budget(arm, fast=fast, link=LinkTiming(usb_latency_s=latency_s))
    groups = marked_groups(tuple(slot.servo_id for slot in arm.slots), fast=fast)
    period_ns = max(arm.period_ns, round(1.5e9 * budget.read_worst_s))
    durations, missed, start_ns = [], 0, clock.now_ns()
    for number in range(reads):
        phase_ns = round(number * _GOLDEN % 1.0 * latency_s * 1e9)
        clock.sleep_until(start_ns + number * period_ns + phase_ns)
        bus.port.discard_input()
        begin_ns = clock.now_ns()
        reply = bus.exchange(groups[number % len(groups)], begin_ns + WAIT_NS).reply
        durations.append((clock.now_ns() - begin_ns) * 1e-9)
        missed += not reply.complete
    durations.sort()
    return CycleFigures(budget, budget_set, fast, durations[reads // 2], durations[reads * 99 // 100], missed, reads)


def judge(arm: ArmMap, figures: CycleFigures) -> list[Finding]:
    """The budget beside the measurement, and what the rate allows."""
    return [_agreement(arm, figures), _share(arm, figures), _budget(arm, figures), _misses(arm, figures)]


def _fast(state: ServoState) -> bool:
    least = state.slot.model.fast_sync_min_firmware
    return least is not None and state.firmware >= least


def _ms(seconds: float) -> str:
    return f"{seconds * 1e3:.2f} ms"


def _agreement(arm: ArmMap, figures: CycleFigures) -> Finding:
    budget, much = figures.budget, figures.deviation
    parts = f"{_ms(budget.request_s + budget.reply_s)} on the wire, {_ms(0.5 * budget.usb_worst_s)} in the adapter"
    return judged(
        "read of all servos, measured", arm.arm, f"{_ms(figures.read_median_s)} in the median ({much:+.0%})",
        f"{_ms(budget.read_mean_s)} computed ({parts}), within {AGREEMENT:.0%}",
        holds=much <= AGREEMENT, otherwise=Verdict.WARNING,
        remedy="slower than the bus can be: check the adapter's latency timer, a USB hub between, and what else this "
        "host is doing",
    )  # fmt: skip


def _share(arm: ArmMap, figures: CycleFigures) -> Finding:
    allowed_s = SHARE / arm.rate_hz
    median_set_s = figures.read_median_s - figures.budget.read_mean_s + figures.budget_set.read_mean_s
    found = f"{_ms(figures.read_p99_s)} in the 99th percentile"
    return judged(
        "read in its period", arm.arm, found, f"≤ {_ms(allowed_s)}, {SHARE:.0%} of the period at {arm.rate_hz:g} Hz",
        holds=figures.read_p99_s <= allowed_s,
        otherwise=Verdict.PROBLEM if median_set_s > allowed_s else Verdict.WARNING,
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
        otherwise=Verdict.PROBLEM if figures.missed > figures.reads // 10 else Verdict.WARNING,
        remedy="check the cables and plugs of the chain, one by one",
    )  # fmt: skip
