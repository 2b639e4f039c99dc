"""The bridge of an arm in the loop, from the cell file: its gains, its clamp, what it knows of the arm's inertia."""

from __future__ import annotations

from agent.config.cell import Arm, Cell
from drivers.dynamixel.arm_map import WATCHDOG_S
from drivers.interface import Clock, Driver
from sim_backend.hil.coupling import FRESH_CYCLES, Settings
from sim_backend.hil.driver import BridgeDriver, Patience
from sim_backend.hil.guest import Twin

EMULATED_STALE_S = 0.5  # what is emulated shares the processor with everything else, and stops with it


def bridge(cell: Cell, arm: Arm, real: Driver, twin: Twin, clock: Clock, *, emulated: bool) -> BridgeDriver:
    """Driver of an arm that [hil] names; real: its own driver; emulated: its servos are."""
    hil, period_s = cell.file.hil, 1.0 / cell.file.rate_hz
    assert hil is not None
    tau_max = arm.tau_stall_Nm * cell.file.safety.tau_max_fraction_of_stall
    settings = Settings(
        period_s=period_s,
        frequency_rad_per_s=hil.frequency(cell.file.rate_hz),
        damping_ratio=hil.damping_ratio,
        clamp_Nm=hil.tau_share * tau_max,
        ramp_s=hil.ramp_s,
        apart_max_rad=hil.apart_max_rad,
    )
    patience = Patience(EMULATED_STALE_S if emulated else FRESH_CYCLES * period_s, WATCHDOG_S)
    return BridgeDriver(real, twin, clock, settings, patience, cell.model(arm).inertia)
