"""The session of one arm from the files of its cell: its gripper, and what each phase waits for."""

from __future__ import annotations

from agent.around import Beginning
from agent.config.cell import Arm, Cell
from agent.config.reading import ConfigError
from agent.config.session import grip_plan
from agent.loop import Agent
from agent.operator.socket import Standing
from agent.session import SessionLoop, StartBound, way_back
from drivers.interface import Driver, Gripper

LEADS_BACK = {
    "found": "the guard holds the arm in its agent's place and leads it back alone", "expected": "its agent",
    "remedy": "lead it back, `coop release` it, then start its guard and its agent anew",
}  # fmt: skip


def led_back(cell: Cell, arm: Arm, agent: Agent, driver: Driver, begun: Beginning, standing: Standing) -> SessionLoop:
    """The session as a guard goes on with it: the grip is kept, and the words that lead back are taken."""
    session = session_loop(cell, arm, agent, driver, leads_back_only=True)
    session.resume(begun.mode)
    standing.session, standing.mode, standing.no_start = session.not_yet, begun.mode, LEADS_BACK
    standing.reason = way_back(begun.mode, begun.reason)
    return session


def session_loop(cell: Cell, arm: Arm, agent: Agent, driver: Driver, *, leads_back_only: bool = False) -> SessionLoop:
    """What the arm does beside its torque; leads_back_only: for a guard.  Raises ConfigError."""
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
    return SessionLoop(agent, driver, grip_plan(cell, arm), bound, leads_back_only=leads_back_only)
