"""Whether an arm's bus can carry the cell's rate, computed from the bytes and pauses of a cycle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from agent.config.cell import Cell, ConfigError
from agent.config.servo_map import arm_map
from agent.verify.finding import Finding, Verdict, judged
from drivers.dynamixel.arm_map import MapError
from drivers.dynamixel.budget import cycle_budget
from drivers.interface import Vector


@dataclass(frozen=True, slots=True)
class BusRate:
    """The highest rate that the bus of one arm carries, with the driver's own budget."""

    arm: str
    rate_max_hz: float
    servos: int
    baud: int
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
        found.append(BusRate(arm.name, budget.rate_max_hz, len(servos.slots), servos.baud, fast))
    return found


def buses(cell: Cell, q_start: Sequence[Vector], *, wired: bool) -> list[Finding]:
    """Whether the bus of every arm with a port carries the cell's rate.  wired: one that does not is refused."""
    rate = cell.file.rate_hz
    return [
        judged(
            "rate on the servo bus", bus.arm, f"{rate:g} Hz", f"≤ {bus.rate_max_hz:g} Hz ({bus.text})",
            holds=rate <= bus.rate_max_hz,
            remedy="lower rate_hz, or raise the servos' Baud Rate (`coop motors setup`) and `baud`",
            otherwise=Verdict.REFUSED if wired else Verdict.WARNING,
        )
        for bus in bus_rates(cell, q_start)
    ]  # fmt: skip
