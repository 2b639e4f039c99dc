"""What the joints of an arm hold at rest."""

from __future__ import annotations

import numpy as np

from agent.config.cell import Arm, Cell
from agent.control.law import rotate_wrench
from agent.control.models import Kinematics
from drivers.interface import Vector


def held_Nm(cell: Cell, arm: Arm, k: Kinematics) -> Vector:
    """(n,) N·m of the arm's weight, its share of the object and the internal wrench that is asked of it."""
    held, asked = k.g + carried_Nm(cell, arm, k), cell.internal_wrench(arm)
    return held if asked is None else held + k.Jt @ np.array(rotate_wrench(k.R_world_object, asked))


def carried_Nm(cell: Cell, arm: Arm, k: Kinematics) -> Vector:
    """(n,) N·m that the arm's share of the object takes."""
    carried: Vector = k.Jt[:, :3] @ (-arm.entry.load_share * cell.file.object.mass_kg * cell.gravity)
    return carried
