"""From the files of a cell to the way of an arm between its rest and its grasp, and to what its gripper closes on."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from agent.config.cell import Arm, Cell
from agent.config.reading import ConfigError
from agent.config.schema.session import Session
from agent.config.servo_map import fingers_of
from agent.control import ik
from agent.control.joint_path import JointPath, straight, timed
from agent.control.life import Life
from agent.control.models import ArmModel
from agent.grip import GripPlan
from drivers.fingers import Fingers
from drivers.interface import Vector

KNOTS = 7  # of the straight line along the gripper's axis, from the place before the grasp to the grasp
FINGER_AXIS = 1  # of the frame `ee`: the fingers close along its y
LEAST_S = 1.0  # of a leg
CLEARANCE_M = 2e-3  # between open fingers and the object, on each side
MEASURED = {  # how, by key of [gripper]
    "closed_tick": "closed_tick (position in `coop motors scan`, fingers shut by hand)",
    "open_tick": "open_tick (the same, wide open)",
    "horn_radius_m": "horn_radius_m (axis of the servo to the rod's pin)",
    "rod_length_m": "rod_length_m (a rod from pin to pin)",
    "grip_effort": "grip_effort (share of stall torque that the servo bears standing; 0.25 on the shipped arms)",
}
DECIMALS = 6  # of joint angles on the way, so that hosts agree on them bit for bit


def rest_joints(arm: Arm) -> Vector:
    """(n,) rad of the controlled joints at rest.  Raises ConfigError where neither cell nor arm file says it."""
    rest = arm.rest_rad
    missing = [joint for joint in arm.entry.controlled if joint not in rest]
    if missing:
        raise ConfigError(
            f"rest pose of arm {arm.name}", found=f"none of {', '.join(missing)}", expected="an angle of every joint",
            remedy="give rest_rad in the cell, or sleep_rad in the arm file",
        )  # fmt: skip
    return np.array([rest[joint] for joint in arm.entry.controlled])


def build_life(cell: Cell, arm: Arm) -> Life:
    """The way of this arm, to the microradian the same on every host.  Raises ConfigError."""
    session = cell.file.session or Session()
    knots = _approach(cell, arm, cell.model(arm), session.back_off_m)
    speed = session.speed_max_rad_per_s
    legs = straight(rest_joints(arm), knots[0], speed, LEAST_S), timed(knots, speed, LEAST_S)
    return Life(
        path=JointPath(legs),
        place=(cell.file.p_place_m, cell.file.object.quat_start),
        ease_s=session.ease_s,
        take_up_s=session.take_up_s,
        lower_s=session.lower_s,
        rate_rad_per_s=session.rate_rad_per_s,
        soft_rad=session.soft_rad,
        off_max_rad=session.off_max_rad,
    )


def _approach(cell: Cell, arm: Arm, model: ArmModel, back_off_m: float) -> Vector:
    """(K, n) joints on the straight line to the grasp, the gripper's axis being that of its frame, x."""
    q, backwards = np.array(arm.entry.q_near_rad), []
    for part in np.linspace(0.0, 1.0, KNOTS).tolist():
        T_ee_back = pin.SE3(np.eye(3), np.array([-part * back_off_m, 0.0, 0.0]))
        # where the object would be if it came along
        T_world_object = cell.T_world_object_start * arm.T_object_ee * T_ee_back * arm.T_object_ee.inverse()
        try:
            q = ik.solve(model, T_world_object, q)
        except ik.Unreachable as error:
            raise ConfigError(
                f"way of arm {arm.name} to its grasp",
                found=f"{part * back_off_m * 1e3:.0f} mm before it unreachable by {error.distance_m * 1e3:.3g} mm",
                expected=f"a straight line of {back_off_m * 1e3:.0f} mm",
                remedy="lower session.back_off_m, or move the base or the grasp",
            ) from error
        backwards.append(q)
    return np.array(np.round(backwards[::-1], DECIMALS), dtype=np.float64)


def grip_width(cell: Cell, arm: Arm) -> float:
    """m between the fingers when they hold the object."""
    if arm.entry.grip_width_m is not None:
        return arm.entry.grip_width_m
    across = arm.T_object_ee.rotation[:, FINGER_AXIS]
    return float(np.abs(across) @ np.array(cell.file.object.size_m))


def grip_plan(cell: Cell, arm: Arm) -> GripPlan:
    """What the gripper of the arm does with the object.  Raises ConfigError where it cannot."""
    hand, width = fingers(arm), grip_width(cell, arm)
    plan = GripPlan(hand.closed_m, hand.open_m, width, arm.file.gripper.grip_effort.value)  # type: ignore[union-attr]
    low, high = hand.closed_m + plan.tolerance_m, hand.open_m - 2.0 * CLEARANCE_M
    if not low <= width <= high:
        raise ConfigError(
            f"object between the fingers of arm {arm.name}",
            found=f"{width * 1e3:.1f} mm",
            expected=f"{low * 1e3:.1f} to {high * 1e3:.1f} mm",
            remedy="grasp it elsewhere, or say with grip_width_m how wide it is there",
        )
    return plan


def fingers(arm: Arm) -> Fingers:
    """Geometry of its gripper.  Raises ConfigError."""
    gripper, found = arm.file.gripper, fingers_of(arm.file)
    if found is not None:
        return found
    where = f"gripper of arm {arm.name} ({arm.file.model})"
    if not gripper.obeys:
        raise ConfigError(
            where,
            found=f"{gripper.servo}, which takes no command on this bus",
            expected="a servo with Protocol 2.0",
            remedy="fit one, and describe it in [gripper] of a file of this arm's own (arm_file)",
        )
    raise ConfigError(
        where,
        found=f"no {', no '.join(gripper.missing)}",
        expected="what it takes to close on an object and to know that it has",
        remedy=f"measure {'; '.join(MEASURED[key] for key in gripper.missing)}; write it into [gripper] of a file of "
        "this arm's own (arm_file; docs/arms.md)",
    )
