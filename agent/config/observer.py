"""The observer that a cell file asks for, for the agent that runs it and the check that counts with it."""

from __future__ import annotations

from agent.config.schema.cell import CellFile, VelocitySource
from agent.control.estimator import Observer


def build(file: CellFile) -> Observer | None:
    """Observer of every agent of the cell; None when the law takes what the servos say."""
    if file.controller.velocity is not VelocitySource.OBSERVER:
        return None
    return Observer(
        period_s=1.0 / file.rate_hz,
        position_gain=0.2,
        velocity_gain_per_s=5.0,
        velocity_gain=0.2,
        delay_cycles=min(file.simulation.effects.delay_cycles, 1),
    )
