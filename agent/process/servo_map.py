"""What the Dynamixel driver and the servo emulator must know of an arm, built from its files; opens nothing."""

from __future__ import annotations

from agent.config.cell import Arm, Cell
from agent.config.schema import ServoJoint
from drivers.dynamixel.arm_map import ArmMap, JointMap, JointRole
from drivers.dynamixel.table import SERVOS
from drivers.interface import Vector

GRIPPER = "gripper"


def arm_map(cell: Cell, arm: Arm, port: str, q_start: Vector) -> ArmMap:
    """Servo map of the arm on `port`, expected at q_start (n,).  Raises MapError."""
    start = {**arm.entry.locked_rad, **dict(zip(arm.entry.controlled, q_start.tolist(), strict=True))}
    joints = [_joint(cell, arm, joint, start.get(joint.name)) for joint in drivable(arm)]
    gripper = arm.file.gripper
    if SERVOS[gripper["servo"]].protocol == arm.file.protocol:
        joints.append(
            JointMap(
                name=GRIPPER,
                servo=gripper["servo"],
                ids=tuple(gripper["ids"]),
                reverse=tuple(gripper["reverse"]),
                zero_tick=gripper["zero_tick"],
                position_limit_ticks=tuple(gripper["position_limit_ticks"]),
                role=JointRole.GRIPPER,
            )
        )
    return ArmMap(arm=arm.name, port=port, baud=arm.baud, rate_hz=cell.file.rate_hz, joints=tuple(joints))


def drivable(arm: Arm) -> list[ServoJoint]:
    """Joints whose servos speak the arm's protocol; the others (an AX-12A) are held by other means."""
    return [joint for joint in arm.file.joints if SERVOS[joint.servo].protocol == arm.file.protocol]


def _joint(cell: Cell, arm: Arm, joint: ServoJoint, start_rad: float | None) -> JointMap:
    controlled = joint.name in arm.entry.controlled
    constant = joint.torque_constant_Nm_per_A
    stall = SERVOS[joint.servo].stall_torque_Nm * len(joint.ids)
    return JointMap(
        name=joint.name,
        servo=joint.servo,
        ids=tuple(joint.ids),
        reverse=tuple(joint.reverse),
        zero_tick=joint.zero_tick,
        position_limit_ticks=joint.position_limit_ticks,
        role=JointRole.CONTROLLED if controlled else JointRole.HELD,
        tau_max_Nm=stall * cell.file.safety.tau_max_fraction_of_stall if controlled else 0.0,
        torque_constant_Nm_per_A=constant.value if constant is not None else None,
        start_rad=start_rad,
    )
