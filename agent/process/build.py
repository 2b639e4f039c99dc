"""One agent from the cell file: everything that determines its torque, and nothing else."""

from __future__ import annotations

from agent.config.cell import Arm, Cell
from agent.config.schema import VelocitySource
from agent.control.estimator import Observer
from agent.loop import Agent
from agent.safety import Limits


def build_agent(cell: Cell, arm: Arm) -> Agent:
    """Everything that determines the arm's torque, from the cell file alone."""
    safety = cell.file.safety
    tau_max = arm.tau_stall_Nm * safety.tau_max_fraction_of_stall
    observer = None
    if cell.file.controller.velocity is VelocitySource.OBSERVER:
        observer = Observer(
            period_s=1.0 / cell.file.rate_hz,
            position_gain=0.2,
            velocity_gain_per_s=5.0,
            velocity_gain=0.2,
            delay_cycles=min(cell.file.simulation.effects.delay_cycles, 1),
        )
    return Agent(
        name=arm.name,
        model=cell.model(arm),
        offline=cell.offline(arm),
        trajectory=cell.trajectory(),
        limits=Limits(tuple(tau_max.tolist()), tuple((tau_max * safety.tau_step_max_fraction).tolist())),
        observer=observer,
        sigma_min=safety.sigma_min,
        period_s=1.0 / cell.file.rate_hz,
    )
