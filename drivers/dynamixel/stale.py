"""The error of a cycle that brought no state: whose is missing, and why."""

from __future__ import annotations

from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.cycle import CycleRows
from drivers.dynamixel.errors import StaleJointsError
from drivers.dynamixel.interpret import Reading, servo_names


def unasked(arm: ArmMap) -> StaleJointsError:
    """Of a cycle whose question the port did not take."""
    ids = [slot.servo_id for slot in arm.slots]
    reason = "no answer, for the port took no request,"
    return StaleJointsError(joints=joint_names(arm), servo_ids=ids, partial=None, reason=reason)


def stale(arm: ArmMap, cycle: CycleRows, reading: Reading) -> StaleJointsError:
    """Of a cycle that left out a servo, or a joint whose position cannot be."""
    reason = "no reply"
    if reading.jumped:
        reason = "a position it cannot have reached"
    elif cycle.late:
        reason = "only a late reply to an earlier request"
    elif cycle.damaged:
        reason = "a damaged reply"
    partial = reading.state if len(reading.stale) < len(arm.controlled) else None
    servos = servo_names(arm.slots, cycle.rows)
    return StaleJointsError(joints=reading.stale, servo_ids=servos, partial=partial, reason=reason)


def joint_names(arm: ArmMap) -> tuple[str, ...]:
    """Of the controlled joints, in their order."""
    return tuple(joint.name for joint in arm.controlled)
