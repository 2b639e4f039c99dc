"""The emulated cell in which all arms begin at their rest, from the files of the cell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from agent.config.cell import Cell
from agent.config.session import fingers, grip_width, rest_joints
from agent.process.emulate import wiring, with_fingers
from agent.process.simulated import plant_spec
from drivers.interface import Vector
from sim_backend.physics.spec import GraspSpec, PlantSpec
from sim_backend.wire.cell import EmulatedCell
from sim_backend.wire.plant_world import emulate_whole
from sim_backend.wire.timing import BusTiming
from sim_backend.wire.whole_world import HandSpec, WholeSpec, WholeWorld
from sim_backend.wire.wiring import ArmWiring

PADS = GraspSpec(stiffness_N_per_m=2e4, stiffness_Nm_per_rad=50.0, damping_ratio=0.5)  # where the cell says nothing
WHERE_IT_SHOULD = pin.SE3.Identity()


def whole_cell(cell: Cell, q_grasp: Sequence[Vector], object_off: pin.SE3 = WHERE_IT_SHOULD) -> tuple[
    PlantSpec, WholeSpec, list[ArmWiring]
]:  # fmt: skip
    """The emulated cell before a run; object_off: where the object really stands, in the frame it should have there.

    Raises ConfigError, PlantError.
    """
    spec = plant_spec(cell, q_grasp)
    if spec.grasp is None:
        spec = replace(spec, grasp=PADS)
    hands = tuple(HandSpec(fingers(arm), grip_width(cell, arm)) for arm in cell.arms)
    rest = tuple(rest_joints(arm) for arm in cell.arms)
    whole = WholeSpec(rest, hands, np.array(cell.file.object.size_m), object_off)
    return spec, whole, [with_fingers(wiring(arm, i, arm.baud), fingers(arm)) for i, arm in enumerate(cell.arms)]


def at_rest(cell: Cell, q_start: Sequence[Vector], timing: BusTiming | None) -> tuple[EmulatedCell, WholeWorld]:
    """Emulated arms that begin at their rest, the object on a table.  Raises ConfigError, PlantError."""
    spec, whole, wired = whole_cell(cell, q_start)
    return emulate_whole(spec, whole, wired, timing=timing)
