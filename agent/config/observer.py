"""The observer that a cell file asks for, for the agent that runs it and the check that counts with it."""

from __future__ import annotations

from agent.config.schema.cell import CellFile
from agent.config.schema.controller import VelocitySource
from agent.control.estimator import Observer


def build(file: CellFile) -> Observer | None:
    """Observer of every agent of the cell; None when the law takes what the servos say."""
    if file.controller.velocity is not VelocitySource.OBSERVER:
        return None
    gains = file.controller.observer
    return Observer(
        period_s=1.0 / file.rate_hz,
        position_gain=gains.position_gain,
        velocity_from_position_per_s=gains.velocity_from_position_per_s,
        velocity_gain=gains.velocity_gain,
        delay_periods=file.delay_periods,
    )
