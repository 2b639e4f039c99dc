"""How an agent is started, and what follows from it for its loop: when the ticks are, and how long what may last."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from agent.around import Schedule
from agent.config.cell import Cell
from agent.config.schema.driver import DriverKind
from agent.cycles import Patience
from agent.guard.pulse import SHARED_S, pulse_vigil
from agent.guard.vigil import Vigil
from agent.process.build import Connection
from drivers.dynamixel.arm_map import WATCHDOG_S

QUIET_MARGIN_S = 0.05  # on the servos' watchdogs, which count in steps of 20 ms
RETRY_S = 0.1


@dataclass(frozen=True)
class AgentOptions:
    """How one agent is started."""

    arm: str
    driver: DriverKind
    connection: Connection
    ring: Path
    control: Path | None  # socket for start, stop and release; None: nobody says a word
    lockstep: bool
    hold: bool  # at a stop and at the end hold the object until it is released
    priority: int | None = None  # SCHED_FIFO; None: leave the scheduler alone
    guard: Path | None = None  # socket of the arm's guard; None: nobody goes on when this process cannot
    no_realtime: bool = False  # a real arm may be started without real time
    whole: bool = False  # it begins at its rest, and is told word by word
    wait_s: float = 0.0  # for guard and plant, where they start beside it


def schedule_of(cell: Cell, options: AgentOptions) -> Schedule:
    """When the ticks of this agent are."""
    rate_hz = cell.file.rate_hz
    return Schedule(
        cell.period_ns,
        round(cell.file.duration_s * rate_hz),
        options.lockstep,
        hold_at_end=options.hold,
        ready_ns=round(cell.file.simulation.ready_s * rate_hz) * cell.period_ns,
        patience=patience_of(cell, emulated=options.driver is DriverKind.SIM or options.connection.emulated),
    )


def guard_vigil(cell: Cell, options: AgentOptions) -> Callable[[], Vigil]:
    """Makes what this agent watches its guard's pulse with."""
    shared = options.driver is DriverKind.SIM or options.connection.emulated
    return partial(pulse_vigil, cell.period_ns, shared=shared)


def patience_of(cell: Cell, *, emulated: bool) -> Patience:
    """How long the loop bears lost states and lost time.

    What is emulated shares the processor with everything else, and stops with it for some ten milliseconds: it is
    held, silent and late after half a second only, at any share of good cycles.
    """
    safety, rate_hz = cell.file.safety, cell.file.rate_hz
    patient = round(SHARED_S * rate_hz)
    usual = Patience(
        blind=max(1, round(safety.blind_s * rate_hz)),
        quiet=round((WATCHDOG_S + QUIET_MARGIN_S) * rate_hz),
        recover=round(safety.recover_s * rate_hz),
        retry=max(1, round(RETRY_S * rate_hz)),
    )
    if not emulated:
        return usual
    return replace(
        usual, hold=patient, blind=max(patient, usual.blind), gap=max(patient, usual.gap), success_min=0.0
    )  # fmt: skip
