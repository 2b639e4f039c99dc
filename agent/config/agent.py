"""What determines one arm's torque, from the cell's files alone."""

from __future__ import annotations

import math
from dataclasses import replace

from agent.config import coordination, floating, noticing, observer, session
from agent.config.cell import Arm, Cell
from agent.loop import Agent
from agent.phases import Session
from agent.safety import Limits
from drivers.interface import Vector

HOLD_RATE_MAX_RAD_PER_S = 20.0
ALONE_STEP_FRACTION = 0.05  # of the largest torque, from tick to tick, of an arm that holds nothing


def build_agent(cell: Cell, arm: Arm) -> Agent:
    """Everything that determines the arm's torque, from the cell file, its arm files and their URDFs alone.

    Raises ConfigError where the cell has a session and the arm no way to its grasp.
    """
    spec = floating.spec_of(cell, arm)
    if spec is None:
        return _working(cell, arm)
    agent = _working(cell, arm, alone=True)
    if spec.moves(arm.name):  # a hand, and an arm that gives way, are what it would notice
        return replace(agent, floating=floating.build(cell, arm, spec), residual=None, brace=None)
    return replace(
        agent,
        offline=floating.carried(agent.offline, spec),
        floating=floating.build(cell, arm, spec),
        sigma_min=0.0,
        alignment=None,
        residual=None,
        brace=None,
    )


def _working(cell: Cell, arm: Arm, *, alone: bool = False) -> Agent:
    """An agent that works; alone: it needs no way to a grasp."""
    safety = cell.file.safety
    tau_max = arm.tau_stall_Nm * safety.tau_max_fraction_of_stall
    return Agent(
        name=arm.name,
        model=cell.model(arm),
        offline=cell.offline(arm),
        trajectory=cell.trajectory(),
        limits=Limits(tuple(tau_max.tolist()), tuple((tau_max * safety.tau_step_max_fraction).tolist())),
        observer=observer.build(cell.file),
        sigma_min=safety.sigma_min,
        error_max_m=safety.tracking_error_max_m,
        error_max_rad=safety.tracking_error_max_rad,
        period_s=1.0 / cell.file.rate_hz,
        hold_rate_rad_per_s=_hold_rate(cell),
        start=coordination.start_pose(cell),
        alignment=coordination.alignment(cell, arm),
        residual=coordination.residual(cell, arm),
        friction_factor=coordination.friction_factor(cell, arm),
        brace=noticing.brace(cell),
        damp_above_rad_per_s=math.inf if safety.hold_speed_max_rad_per_s is None else safety.hold_speed_max_rad_per_s,
        session=None if alone else _session(cell, arm, tau_max),
    )


def _session(cell: Cell, arm: Arm, tau_max: Vector) -> Session | None:
    if cell.file.session is None:
        return None
    alone = Limits(tuple(tau_max.tolist()), tuple((ALONE_STEP_FRACTION * tau_max).tolist()))
    return Session(session.build_life(cell, arm), alone, cell.file.session.start_blend_s)


def _hold_rate(cell: Cell) -> float:
    """As stiff as keeps a third of a radian between two effective samples: settles with 30 % of inertia missing too."""
    effective_hz = cell.file.rate_hz / (1.0 + cell.file.delay_periods)
    return min(HOLD_RATE_MAX_RAD_PER_S, effective_hz / 3.0)
