"""What the joints of an arm hold at rest."""

from __future__ import annotations

from agent.config.cell import Arm, Cell
from agent.control.models import Kinematics
from drivers.interface import Vector


def carried_Nm(cell: Cell, arm: Arm, k: Kinematics) -> Vector:
    """(n,) N·m that the arm's share of the object takes."""
    carried: Vector = k.Jt[:, :3] @ (-arm.entry.load_share * cell.file.object.mass_kg * cell.gravity)
    return carried
