"""What driver, tools and servo emulator must know of an arm, built from its files."""

from __future__ import annotations

from dataclasses import replace

from agent.config.cell import Arm, Cell
from agent.config.schema.arm import ArmFile, ServoJoint, Servos
from drivers.dynamixel.arm_map import ArmMap, JointMap, JointRole, Mark
from drivers.dynamixel.servo.models import SERVOS
from drivers.dynamixel.servo.units import ticks_rad
from drivers.fingers import Fingers
from drivers.interface import Vector

GRIPPER = "gripper"


def arm_map(cell: Cell, arm: Arm, port: str, q_start: Vector) -> ArmMap:
    """Servo map of the arm on `port`, expected at q_start (n,): its rest, or a start.  Raises MapError."""
    start = {**arm.entry.locked_rad, **dict(zip(arm.entry.controlled, q_start.tolist(), strict=True))}
    at_rest = all(arm.rest_rad.get(joint) == start[joint] for joint in arm.entry.controlled)
    mapped = [_joint(cell, arm, joint, start.get(joint.name)) for joint in drivable(arm.file)]
    joints = [replace(joint, at_rest=at_rest) for joint in mapped]
    gripper = gripper_map(arm.file)
    if gripper is not None:
        joints.append(gripper)
    rate_hz = cell.file.rate_hz
    return ArmMap(arm.name, port, arm.baud, rate_hz, tuple(joints), mark=mark_of(cell, arm))


def mark_of(cell: Cell, arm: Arm) -> Mark:
    """By what the arm is told from the others of the cell."""
    others = [(a.entry.mark, a.name) for a in cell.arms if a.name != arm.name]
    return Mark(arm.name, arm.entry.mark, tuple((mark, name) for mark, name in others if mark is not None))


def drivable(file: ArmFile) -> list[ServoJoint]:
    """Joints whose servos speak the arm's protocol; the others (an AX-12A) are held by other means."""
    return [joint for joint in file.joints if SERVOS[joint.servo].protocol == file.protocol]


def resting_joints(file: ArmFile) -> tuple[JointMap, ...]:
    """All joints with their servos, gripper last, whatever a cell does with them: none is to take torque."""
    gripper = gripper_map(file)
    joints = [_joint_map(joint.name, joint, JointRole.HELD) for joint in drivable(file)]
    return (*joints, gripper) if gripper is not None else tuple(joints)


def gripper_map(file: ArmFile) -> JointMap | None:
    """The gripper; None when its servo does not speak the arm's protocol."""
    if SERVOS[file.gripper.servo].protocol != file.protocol:
        return None
    gripper, fingers = file.gripper, fingers_of(file)
    plain = _joint_map(GRIPPER, gripper, JointRole.GRIPPER)
    if fingers is None or gripper.grip_effort is None:
        return plain
    return replace(plain, fingers=fingers, grip_effort=gripper.grip_effort.value)


def fingers_of(file: ArmFile) -> Fingers | None:
    """Geometry of the gripper; None where the file does not say enough to close it on an object."""
    g = file.gripper
    if g.closed_tick is None or g.open_tick is None or g.horn_radius_m is None or g.rod_length_m is None:
        return None
    if g.missing or not g.obeys:
        return None
    closed, opened = (ticks_rad(tick - g.zero_tick) for tick in (g.closed_tick, g.open_tick))
    return Fingers(g.horn_radius_m, g.rod_length_m, closed, opened)


def _joint_map(name: str, servos: Servos, role: JointRole) -> JointMap:
    return JointMap(
        name=name,
        servo=servos.servo,
        ids=tuple(servos.ids),
        reverse=tuple(servos.reverse),
        zero_tick=servos.zero_tick,
        position_limit_ticks=servos.position_limit_ticks,
        role=role,
    )


def _joint(cell: Cell, arm: Arm, joint: ServoJoint, start_rad: float | None) -> JointMap:
    resting = replace(_joint_map(joint.name, joint, JointRole.HELD), start_rad=start_rad)
    if joint.name not in arm.entry.controlled:
        return resting
    constant = joint.torque_constant_Nm_per_A
    stall = SERVOS[joint.servo].stall_torque_Nm * len(joint.ids)
    return replace(
        resting,
        role=JointRole.CONTROLLED,
        tau_max_Nm=stall * cell.file.safety.tau_max_fraction_of_stall,
        torque_constant_Nm_per_A=constant.value if constant is not None else None,
    )
