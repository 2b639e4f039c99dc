"""Where the arms of a cell stand at its start, without the examination of the whole cell that `coop check` makes."""

from __future__ import annotations

from agent.config.cell import Cell
from agent.verify.path import start_configurations
from drivers.interface import Vector


def start_joints(cell: Cell) -> tuple[Vector, ...]:
    """Joint angles (n,) of each arm with the object at its start, rad, as `CheckReport.q_start` has them."""
    return start_configurations(cell, [cell.model(arm) for arm in cell.arms])
