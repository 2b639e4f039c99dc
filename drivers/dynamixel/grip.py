"""The gripper of an arm: a width in, goals of its servo out, and what the servo says back as width and force.

Position mode with an effort that bounds it: a goal inside the object is what presses.  Where the servo has
current-based position mode (`JointMap.mode`) the bound is a current, else a voltage.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from drivers.dynamixel.arm_map import ArmMap, JointMap
from drivers.dynamixel.errors import NoGripperError
from drivers.dynamixel.line.group import GroupWrite, Row
from drivers.dynamixel.servo.table import GOAL_CURRENT, GOAL_POSITION, GOAL_PWM
from drivers.dynamixel.servo.units import AngleScale, angle_ticks, current_or_load, velocity_rad_per_s
from drivers.fingers import Fingers
from drivers.interface import GripState

TIMES = 2  # that each goal is sent: nobody answers it, and it would not come again


class GripControl:
    """Goals of one gripper, and the one last sent."""

    def __init__(self, joint: JointMap, fingers: Fingers, effort_limit: int) -> None:
        """effort_limit: the largest count that the servo takes in its effort register."""
        register = GOAL_CURRENT if joint.model.has_current_mode else GOAL_PWM
        self.servo_id = joint.ids[0]
        self.effort = min(effort_limit, joint.model.share_count(register, joint.grip_effort))
        self._joint = joint
        self._fingers = fingers
        self._full = joint.model.share_count(register, 1.0)
        self._scale = AngleScale(joint)
        self._goal: int | None = None
        self._left = 0  # packets with it
        self._efforts = GroupWrite(register.address, "h", [self.servo_id])
        self._goals = GroupWrite(GOAL_POSITION.address, "i", [self.servo_id])

    @classmethod
    def of(cls, arm: ArmMap, limits: Mapping[int, int]) -> GripControl | None:
        """Of an arm whose gripper can be closed on an object; limits: largest count that each servo takes."""
        joint = arm.gripper
        if joint is None or joint.fingers is None:
            return None
        return cls(joint, joint.fingers, limits[joint.ids[0]])

    def go_to(self, width_m: float) -> None:
        """Have the next packets send the fingers there."""
        angle = self._fingers.angle(width_m)
        self._goal = self._joint.zero_tick + angle_ticks(angle)
        self._left = TIMES

    def go_on(self, other: GripControl) -> None:
        """Have the next packets send the fingers where another was sending them."""
        self._goal = other._goal
        self._left = TIMES

    def packets(self) -> bytes:
        """What is to be sent now; nothing where the goal is that of before."""
        if not self._left or self._goal is None:
            return b""
        self._left -= 1
        return self._efforts.packet([self.effort]) + self._goals.packet([self._goal])

    def state(self, row: Row, stamp_ns: int) -> GripState:
        """What the servo said: (error byte, current or load, velocity, position)."""
        _, present, velocity, position = row
        angle, fingers = self._scale.angle_rad(position), self._fingers
        model, lever = self._joint.model, fingers.lever(angle)
        share = present / self._full if model.has_current_mode else current_or_load(model, present)[1]
        effort = -share if fingers.open_rad > fingers.closed_rad else share
        return GripState(
            stamp_ns,
            width_m=fingers.width(angle),
            speed_m_per_s=lever * velocity_rad_per_s(velocity),
            effort=effort,
            force_N=effort * model.stall_torque_Nm / abs(lever),
            width_cmd_m=math.nan if self._goal is None else fingers.width(self._scale.angle_rad(self._goal)),
            force_max_N=abs(self.effort) / self._full * model.stall_torque_Nm / abs(lever),
        )


def no_gripper(arm: ArmMap) -> NoGripperError:
    """Of an arm that has none which can be closed on an object."""
    return NoGripperError(
        f"arm {arm.arm}: gripper",
        found="none that its file describes well enough",
        expected="closed_tick, open_tick, horn_radius_m, rod_length_m and grip_effort",
        remedy="add them to [gripper] of the arm file",
    )
