"""Whether an arm's bus can carry the cell's rate, computed from the bytes and pauses of a cycle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from agent.config.cell import Cell, ConfigError
from agent.config.schema.driver import DriverKind
from agent.config.servo_map import arm_map
from agent.verify.finding import Finding, Verdict, judged
from drivers.dynamixel.arm_map import MapError
from drivers.dynamixel.budget import FAULT_WITHIN_S, Round, cycle_budget, round_of
from drivers.interface import Vector

DELAY_SHARE = 0.9  # of the computed delay that a cell may believe in: a host can be quicker than the budget


@dataclass(frozen=True, slots=True)
class BusRate:
    """The highest rate that the bus of one arm carries, with the driver's own budget."""

    arm: str
    rate_max_hz: float
    delay_s: float  # from a sample to its torque
    servos: int
    baud: int
    checks: Round  # of its servos' registers
    fast: bool  # all servos can answer in one merged reply, if their firmware is not too old

    @property
    def text(self) -> str:
        """What the bus is, for a table."""
        return f"{self.servos} servos at {self.baud} bit/s, {'fast' if self.fast else 'plain'} sync read"


def bus_rates(cell: Cell, q_start: Sequence[Vector]) -> list[BusRate]:
    """Rates of the arms that have a Dynamixel port; q_start[i] (n,): start of arm i.

    Raises ConfigError when the servo map of an arm, with or without a port, contradicts itself.
    """
    found = []
    for arm, q in zip(cell.arms, q_start, strict=True):
        port = arm.entry.dynamixel
        try:
            servos = arm_map(cell, arm, "" if port is None else port.port, q)
        except MapError as error:
            raise ConfigError(error.what, found=error.found, expected=error.expected, remedy=error.remedy) from error
        if port is None:
            continue
        fast = all(slot.model.fast_sync_min_firmware is not None for slot in servos.slots)
        budget = cycle_budget(servos, fast=fast)
        checks, count = round_of(servos, fast=fast), len(servos.slots)
        found.append(BusRate(arm.name, budget.rate_max_hz, budget.delay_mean_s, count, servos.baud, checks, fast))
    return found


def buses(cell: Cell, q_start: Sequence[Vector], *, wired: bool) -> list[Finding]:
    """Whether the bus of every arm with a port carries the cell's rate, within the delay that the cell believes in.

    wired: a rate that is not carried is refused.  A delay that no bus has is refused when servos move the arms.
    """
    rate, delay_s = cell.file.rate_hz, cell.file.delay_s
    moved = cell.file.driver is DriverKind.DYNAMIXEL
    findings = []
    for bus in bus_rates(cell, q_start):
        rate_finding = judged(
            "rate on the servo bus", bus.arm, f"{rate:g} Hz", f"≤ {bus.rate_max_hz:g} Hz ({bus.text})",
            holds=rate <= bus.rate_max_hz,
            remedy="lower rate_hz, or raise the servos' Baud Rate (`coop motors setup`) and `baud`",
            otherwise=Verdict.REFUSED if wired else Verdict.WARNING,
        )  # fmt: skip
        delay_finding = judged(
            "loop_delay_s", bus.arm, f"{delay_s * 1e3:.3g} ms", f"≥ {bus.delay_s * 1e3:.3g} ms, which the bus takes",
            holds=delay_s >= DELAY_SHARE * bus.delay_s, otherwise=Verdict.REFUSED if moved else Verdict.WARNING,
            remedy="leave it out for one control period, or give what you have measured; simulated arms may be quicker",
        )  # fmt: skip
        findings += [rate_finding, delay_finding]
        if wired and bus.rate_max_hz >= rate:
            finding = judged(
                "all servos asked for their state", bus.arm, f"within {bus.checks.seconds * 1e3:.0f} ms",
                f"≤ {FAULT_WITHIN_S * 1e3:g} ms, so that one that restarted is noticed", holds=bus.checks.quick,
                remedy=bus.checks.remedy, otherwise=Verdict.WARNING,
            )  # fmt: skip
            findings.append(finding)
    return findings
