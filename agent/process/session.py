"""The session of one arm from the files of its cell: its gripper, and what each phase waits for."""

from __future__ import annotations

from agent.config.cell import Arm, Cell
from agent.config.reading import ConfigError
from agent.config.session import grip_plan
from agent.loop import Agent
from agent.session import SessionLoop, StartBound
from drivers.interface import Driver, Gripper


def session_loop(cell: Cell, arm: Arm, agent: Agent, driver: Driver) -> SessionLoop:
    """What the arm does beside its torque.  Raises ConfigError."""
    if agent.session is None:
        raise ConfigError(
            f"cell {cell.file.name}", found="no [session]", expected="one, for a run from rest to rest",
            remedy="add the table [session]; every key of it has a default",
        )  # fmt: skip
    if not isinstance(driver, Gripper):
        raise ConfigError(
            f"arm {arm.name}", found="a driver without a gripper", expected="servos, real or emulated",
            remedy="sessions from rest to rest are for --driver dynamixel",
        )  # fmt: skip
    safety = cell.file.safety
    bound = StartBound(safety.start_error_max_m, safety.start_error_max_rad)
    return SessionLoop(agent, driver, grip_plan(cell, arm), bound)
