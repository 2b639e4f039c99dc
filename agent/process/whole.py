"""A session of one arm from the files of its cell, and the emulated cell in which all arms have theirs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from agent.config.cell import Arm, Cell
from agent.config.reading import ConfigError
from agent.config.servo_map import GRIPPER, fingers_of
from agent.config.session import grip_width, rest_joints
from agent.grip import GripPlan
from agent.loop import Agent
from agent.process.emulate import wiring
from agent.process.simulated import plant_spec
from agent.session import SessionLoop, StartBound
from drivers.fingers import Fingers
from drivers.interface import Gripper, Vector
from sim_backend.physics.spec import GraspSpec, PlantSpec
from sim_backend.wire.whole_world import HandSpec, WholeSpec
from sim_backend.wire.wiring import ArmWiring

PADS = GraspSpec(stiffness_N_per_m=2e4, stiffness_Nm_per_rad=50.0, damping_ratio=0.5)  # where the cell says nothing
WHERE_IT_SHOULD = pin.SE3.Identity()
CLEARANCE_M = 2e-3  # between open fingers and the object, on each side


def session_loop(cell: Cell, arm: Arm, agent: Agent, gripper: Gripper) -> SessionLoop:
    """What the arm does beside its torque.  Raises ConfigError."""
    if agent.session is None:
        raise ConfigError(
            f"cell {cell.file.name}", found="no [session]", expected="one, for a run from rest to rest",
            remedy="add the table [session]; every key of it has a default",
        )  # fmt: skip
    safety = cell.file.safety
    bound = StartBound(safety.start_error_max_m, safety.start_error_max_rad)
    return SessionLoop(agent, gripper, grip_plan(cell, arm), bound)


def grip_plan(cell: Cell, arm: Arm) -> GripPlan:
    """What the gripper of the arm does with the object.  Raises ConfigError where it cannot."""
    fingers, width = _fingers(arm), grip_width(cell, arm)
    plan = GripPlan(fingers.closed_m, fingers.open_m, width, arm.file.gripper.grip_effort.value)  # type: ignore[union-attr]
    low, high = fingers.closed_m + plan.tolerance_m, fingers.open_m - 2.0 * CLEARANCE_M
    if not low <= width <= high:
        raise ConfigError(
            f"object between the fingers of arm {arm.name}",
            found=f"{width * 1e3:.1f} mm",
            expected=f"{low * 1e3:.1f} to {high * 1e3:.1f} mm",
            remedy="grasp it elsewhere, or say with grip_width_m how wide it is there",
        )
    return plan


def whole_cell(cell: Cell, q_grasp: Sequence[Vector], object_off: pin.SE3 = WHERE_IT_SHOULD) -> tuple[
    PlantSpec, WholeSpec, list[ArmWiring]
]:  # fmt: skip
    """The emulated cell before a run; object_off: where the object really stands, in the frame it should have there.

    Raises ConfigError, PlantError.
    """
    spec = plant_spec(cell, q_grasp)
    if spec.grasp is None:
        spec = replace(spec, grasp=PADS)
    hands = tuple(HandSpec(_fingers(arm), grip_width(cell, arm)) for arm in cell.arms)
    rest = tuple(rest_joints(arm) for arm in cell.arms)
    whole = WholeSpec(rest, hands, np.array(cell.file.object.size_m), object_off)
    return spec, whole, [_wiring(arm, i) for i, arm in enumerate(cell.arms)]


def _wiring(arm: Arm, index: int) -> ArmWiring:
    wired = wiring(arm, index, arm.baud)
    joints = (replace(j, fingers=_fingers(arm)) if j.name == GRIPPER else j for j in wired.joints)
    return replace(wired, joints=tuple(joints))


def _fingers(arm: Arm) -> Fingers:
    fingers = fingers_of(arm.file)
    if fingers is None:
        raise ConfigError(
            f"gripper of arm {arm.name} ({arm.file.model})",
            found="one that this software cannot close on an object",
            expected="closed_tick, open_tick, horn_radius_m, rod_length_m and grip_effort, of a Protocol 2.0 servo",
            remedy="add them to [gripper] of the arm file",
        )
    return fingers
