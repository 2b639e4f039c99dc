"""What may stand under `[[arms]]` of a cell file."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, ClassVar

from pydantic import AfterValidator, Field, model_validator

from agent.config.schema.arm import Baud
from agent.config.schema.types import (
    HOST_PATTERN,
    PORT_PATTERN,
    Angle,
    FileStem,
    Label,
    Length,
    Name,
    PerAxis,
    Quaternion,
    Share,
    Strict,
    Vec3,
    Wrench,
    wrong,
)
from drivers.dynamixel.servo.models import SERVOS
from drivers.dynamixel.servo.table import MOVING_THRESHOLD

TASK_ROWS = 6
FACTORY_MARKS = sorted({mark for model in SERVOS.values() if (mark := model.default(MOVING_THRESHOLD)) is not None})


def _telling(mark: int) -> int:
    """A number that no servo has by itself."""
    if mark in FACTORY_MARKS:
        raise wrong(
            "", found=mark, expected="a number with which no servo leaves the factory",
            remedy=f"they have {' or '.join(map(str, FACTORY_MARKS))}: take another",
        )  # fmt: skip
    return mark


class DynamixelPort(Strict):
    """How a host reaches the servos of this arm."""

    port: Annotated[Label, Field(pattern=PORT_PATTERN)]
    """Serial device of the arm's bus."""
    baud: Baud | None = None
    """Speed of the bus, bit/s; none: as the arm file says."""
    mark: Annotated[int, Field(ge=1, le=MOVING_THRESHOLD.maximum), AfterValidator(_telling)] | None = None
    """Number that its servos keep and no other arm's do, written by `coop motors mark`; none: no such number."""


class PostureSpec(Strict):
    """Null-space posture of an arm with more than six controlled joints."""

    q_rad: list[Angle]
    """Joint angles that the arm is drawn to where the task leaves it free, one per controlled joint."""
    stiffness_Nm_per_rad: Annotated[float, Field(ge=0.0, le=1e4)]
    """How strongly."""
    damping_Nm_s_per_rad: Annotated[float, Field(gt=0.0, le=1e4)]
    """Damping of that motion."""


class Arm(Strict):
    """One arm of the cell."""

    absent: ClassVar[Mapping[str, str]] = MappingProxyType(
        {
            "k_v_Nm_s_per_rad": "give the rotation a k_v of its own, N·m·s/rad: the number of k_v_N_s_per_m is mostly "
            "far too much for a wrist; 0.1 is a beginning, `coop tune` finds a better one"
        }
    )

    name: Name
    """Name of the arm in topics, logs and commands."""
    host: Annotated[str, Field(pattern=HOST_PATTERN)] | None = None
    """Host whose agent this is; none: any host on which it is started."""
    model: FileStem
    """Arm model; where there is no `arm_file`, its figures are those that ship."""
    arm_file: Annotated[str, Field(min_length=1, max_length=255)] | None = None
    """File of this very arm with figures of its own, relative to the cell file; none: the one that ships."""
    p_world_base_m: Vec3
    """Where the base stands, world axes."""
    quat_world_base: Quaternion
    """How it is turned, w x y z: x of the base points forward."""
    p_object_ee_m: Vec3
    """Where the end effector holds the object, object axes."""
    quat_object_ee: Quaternion
    """Attitude of the end effector in object axes, w x y z: its x points out of the gripper."""
    load_share: Share
    """Part of the object that this arm carries; all shares sum to 1, 0 damps and carries nothing."""
    k_v_N_s_per_m: PerAxis
    """Damping of the object's translation by this arm; one number or three; larger is stiffer, and unstable sooner."""
    k_v_Nm_s_per_rad: PerAxis
    """Damping of its rotation; the paper prints one number for both, which is far too much for a wrist."""
    internal_wrench_N_Nm: Wrench | None = None
    """Force and moment that the grasp is to carry beside the load, at the end effector, object axes; none: zero."""
    grip_force_max_N: Annotated[float, Field(gt=0.0, le=1e4)] | None = None
    """What the gripper holds by friction, held against its part of the object and internal wrench; none: not judged."""
    controlled: Annotated[list[Label], Field(min_length=3, max_length=7)]
    """Joints the law moves, from base to tip: three parallel ones for a plane, six or seven for space."""
    locked_rad: dict[Label, Angle] = Field(default_factory=dict)
    """Angles at which all other joints are held, by joint."""
    q_near_rad: list[Angle]
    """Angles near those that hold the object at the start, one per controlled joint: they choose the elbow."""
    rest_rad: dict[Label, Angle] = Field(default_factory=dict)
    """Angles at which the arm rests, by joint, in the place of those of its arm file."""
    grip_width_m: Length | None = None
    """How wide the object is between the fingers; none: its size in the direction in which they close."""
    posture: PostureSpec | None = None
    """Null-space posture, of an arm with seven controlled joints."""
    dynamixel: DynamixelPort | None = None
    """Where the servos of this arm are; needed with driver = "dynamixel"."""

    @property
    def mark(self) -> int | None:
        """By which it is told from others of its make; None: by nothing."""
        return None if self.dynamixel is None else self.dynamixel.mark

    @model_validator(mode="after")
    def _consistent(self) -> Arm:
        n = len(self.controlled)
        if len(self.q_near_rad) != n:
            raise wrong(
                "q_near_rad",
                found=f"{len(self.q_near_rad)} values",
                expected=f"one q_near_rad per controlled joint, {n}",
                remedy="give angles near those that hold the object at the start",
            )
        if (self.posture is not None) != (n > TASK_ROWS):
            raise wrong(
                "posture", found="none" if self.posture is None else f"one with {n} controlled joints",
                expected="a posture for more than six controlled joints, and for no other",
                remedy="give q_rad, stiffness and damping, or leave it out",
            )  # fmt: skip
        if self.posture is not None and len(self.posture.q_rad) != n:
            raise wrong(
                "posture.q_rad", found=f"{len(self.posture.q_rad)} values", expected=f"one per controlled joint, {n}",
                remedy="give the angles the arm is to rest at in its null space",
            )  # fmt: skip
        both = set(self.controlled) & set(self.locked_rad)
        if both:
            raise wrong(
                "locked_rad", found=", ".join(sorted(both)), expected="no joint that is controlled as well",
                remedy="name each joint either as controlled or as locked",
            )  # fmt: skip
        return self
