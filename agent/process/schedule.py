"""What follows for its loop from how an agent is started: when the ticks are, and how long what may last."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from agent.around import Schedule
from agent.config.cell import Cell
from agent.cycles import Patience
from agent.guard.pulse import SHARED_S, pulse_vigil
from agent.guard.vigil import Vigil
from drivers.dynamixel.arm_map import WATCHDOG_S

QUIET_MARGIN_S = 0.05  # on the servos' watchdogs, which count in steps of 20 ms
RETRY_S = 0.1


def schedule_of(cell: Cell, *, hold: bool, shared: bool, lockstep: bool = False) -> Schedule:
    """When the ticks of an agent are; hold: at the end; shared: what moves the arm has its time of the same host."""
    rate_hz = cell.file.rate_hz
    return Schedule(
        cell.period_ns,
        round(cell.file.duration_s * rate_hz),
        lockstep,
        hold_at_end=hold,
        ready_ns=round(cell.file.simulation.ready_s * rate_hz) * cell.period_ns,
        patience=patience_of(cell, emulated=shared),
    )


def guard_vigil(cell: Cell, *, shared: bool) -> Callable[[], Vigil]:
    """Makes what an agent watches its guard's pulse with; shared: as of `schedule_of`."""
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
