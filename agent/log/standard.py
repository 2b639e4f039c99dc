"""Standard ROS 2 messages from rows, many at a time, for viewers that know nothing of ours.

Topics and frames are those that ROS tools look for by themselves; agent.log.scene has the frames.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from agent.control.quaternion import Quat, multiply
from agent.log.cdr import CdrTemplate, stamp_of, text_message
from agent.log.scene import WORLD, Joint, Pose, Scene, SceneArm, Transform
from agent.log.unshifted import unshifted
from agent.telemetry.row.event import Event

RATE_HZ: Final = 50.0
_SLOT_NS: Final = np.int64(1e9 / RATE_HZ)
LOG_TOPIC: Final = "/rosout"
TF_TOPIC: Final = "/tf"
TF_STATIC_TOPIC: Final = "/tf_static"
POSE_TOPIC: Final = "/object/pose"
POSE_DES_TOPIC: Final = "/object/pose_des"

_AXES: Final = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

Rows = NDArray[np.void]
Stamp = NDArray[np.uint32]  # (k, 2): seconds and nanoseconds of each row's UTC
Placed = tuple[NDArray[Any], NDArray[Any]]  # (k, 3), (k, 4) scalar first, in the world
Fill = Callable[[Rows, Rows, Stamp], None]  # (messages to fill, rows to fill them from, their stamps), equally long


def stamps(rows: Rows) -> Stamp:
    """Time of each row as ROS has it."""
    out = np.empty((len(rows), 2), np.uint32)
    out[:, 0], out[:, 1] = np.divmod(rows["utc_ns"], 1_000_000_000)
    return out


@dataclass(frozen=True)
class StandardTopic:
    """One topic of standard messages made from rows."""

    topic: str
    ros_name: str
    template: bytes  # a complete message; `fill` leaves what never changes
    dtype: np.dtype[np.void]
    fill: Fill


@dataclass(frozen=True)
class Latched:
    """A message that does not depend on any row, and that whoever comes late must have."""

    topic: str
    ros_name: str
    message: bytes


def arm_topics(arm: SceneArm, *, is_first: bool, has_plant: bool) -> list[StandardTopic]:
    """Standard topics of an arm's rows.

    The first arm also gives the desired object pose and, without a plant that knows the truth, the actual one: where it
    sees the object, and what it makes that follow; with a plant, the motion that all follow.
    """
    frames = [(arm.frame("object"), _seen)]
    topics = [_joint_state(arm), _wrench(arm)]
    if is_first:
        desired = _of_all if has_plant else _followed
        frames.append(("object_des", desired))
        topics.append(_pose(POSE_DES_TOPIC, desired))
        if not has_plant:
            frames.append(("object", _seen))
            topics.append(_pose(POSE_TOPIC, _seen))
    return [*topics, _transforms(arm, frames)]


def plant_topics() -> list[StandardTopic]:
    """Standard topics of the plant's rows: where the object really is."""
    return [
        _pose(POSE_TOPIC, _seen),
        _transforms(None, [("object", _seen)]),
    ]


def latched(scene: Scene, utc_ns: int) -> list[Latched]:
    """All frames that never move, in one message, and the URDF of every arm."""
    found = [Latched(TF_STATIC_TOPIC, "tf2_msgs/TFMessage", static_transforms(scene.statics(), utc_ns))]
    for arm in scene.arms:
        found.append(Latched(f"/{arm.name}/robot_description", "std_msgs/String", text_message(arm.urdf_xml.encode())))
    return found


def decimated(rows: Rows, last_slot: int) -> tuple[Rows, int]:
    """The first row of each 1/RATE_HZ of time, and the last slot of time seen; pass that in again."""
    if not len(rows):
        return rows, last_slot
    slots = rows["utc_ns"] // _SLOT_NS
    fresh = np.empty(len(rows), np.bool_)
    fresh[0] = slots[0] != last_slot
    np.not_equal(slots[1:], slots[:-1], out=fresh[1:])
    whole = np.ndarray(len(rows), f"V{rows.dtype.itemsize}", rows)  # copied as bytes, not field by field
    some = whole[fresh]
    return np.ndarray(len(some), rows.dtype, some), int(slots[-1])


def log_message(event: Event) -> bytes:
    """rcl_interfaces/Log of an event."""
    out = CdrTemplate().given("<u4", stamp_of(event.utc_ns)).given("u1", [event.level.value])
    return out.string(event.source).string(event.text).string("").string("").given("<u4", [0]).message


def static_transforms(transforms: Sequence[Transform], utc_ns: int) -> bytes:
    """tf2_msgs/TFMessage of frames that never move."""
    out = CdrTemplate().length(len(transforms))
    for t in transforms:
        out.given("<u4", stamp_of(utc_ns)).string(t.parent).string(t.child).given("<f8", _numbers(t.pose))
    return out.message


def _numbers(pose: Pose) -> list[float]:
    """Position, then attitude with the scalar last, as messages have them."""
    w, x, y, z = pose.quat
    return [*pose.p, x, y, z, w]


def _topic(topic: str, ros_name: str, template: CdrTemplate, fill: Fill) -> StandardTopic:
    return StandardTopic(topic, ros_name, template.message, template.dtype, fill)


def _put_pose(out: NDArray[np.float64], p: NDArray[np.float64], quat_scalar_first: NDArray[np.float64]) -> None:
    """Poses (k, 7) as messages have them."""
    out[:, :3] = p
    out[:, 3:6], out[:, 6] = quat_scalar_first[:, 1:], quat_scalar_first[:, 0]


def _joint_state(arm: SceneArm) -> StandardTopic:
    """All movable joints: controlled ones as measured, locked ones where the cell has them locked."""
    names = arm.movable
    where = {name: i for i, name in enumerate(arm.joints)}
    own, columns = [i for i, name in enumerate(names) if name in where], [where[n] for n in names if n in where]
    held = [arm.locked.get(name, 0.0) for name in names]
    template = CdrTemplate().header("", "").length(len(names))
    for name in names:
        template.string(name)
    nothing = [0.0 if name in where else np.nan for name in names]  # knows what a locked joint's servo does
    for quantity, start in (("position", held), ("velocity", [0.0] * len(names)), ("effort", nothing)):
        template.length(len(names)).number(quantity, "<f8", len(names), start)
    put, take = _compact(own), _compact(columns)

    def fill(out: Rows, rows: Rows, stamp: Stamp) -> None:
        out["stamp"] = stamp
        out["position"][:, put] = rows["q_measured"][:, take]
        out["velocity"][:, put] = rows["dq_measured"][:, take]
        out["effort"][:, put] = rows["tau_sent"][:, take]

    return _topic(f"/{arm.name}/joint_states", "sensor_msgs/JointState", template, fill)


def _compact(indices: Sequence[int]) -> Any:
    """The same indices as a slice where they are consecutive: numpy copies those faster."""
    first, count = (indices[0], len(indices)) if indices else (0, 0)
    return slice(first, first + count) if list(indices) == [*range(first, first + count)] else list(indices)


def _wrench(arm: SceneArm) -> StandardTopic:
    """The commanded wrench at the end effector, in its axes: R_eeᵀ u_i with R_ee = R_O R_O,ee (the grasp is rigid)."""
    to_ee = rotation_form(arm.quat_object_ee)

    def fill(out: Rows, rows: Rows, stamp: Stamp) -> None:
        out["stamp"] = stamp
        quat = rows["quat_object"]
        squares = (quat[:, :, None] * quat[:, None, :]).reshape(-1, 1, 16)
        R_world_ee = (squares @ to_ee).reshape(-1, 3, 3)  # row by row: the same bits however many there are
        out["wrench"] = (rows["wrench_cmd"].reshape(-1, 2, 3) @ R_world_ee).reshape(-1, 6)

    template = CdrTemplate().header("", arm.frame(arm.ee_link)).number("wrench", "<f8", 6)
    return _topic(f"/{arm.name}/wrench", "geometry_msgs/WrenchStamped", template, fill)


def rotation_form(after: Quat) -> NDArray[np.float64]:
    """(16, 9): maps the products of the components of a quaternion ξ to the matrix R(ξ) R(after), row by row."""
    basis = np.eye(4)

    def R(quat: NDArray[np.float64]) -> NDArray[np.float64]:  # homogeneous of degree two in its argument
        w, x, y, z = quat.tolist()
        columns = [multiply(multiply((w, x, y, z), (0.0, *e)), (w, -x, -y, -z))[1:] for e in _AXES]
        return np.array(columns).T

    R_after = R(np.array(after))
    form = np.empty((4, 4, 3, 3))
    for a in range(4):
        for b in range(4):
            form[a, b] = 0.5 * (R(basis[a] + basis[b]) - R(basis[a]) - R(basis[b])) @ R_after
    return form.reshape(16, 9)


def _seen(rows: Rows) -> Placed:
    return rows["p_object"], rows["quat_object"]


def _followed(rows: Rows) -> Placed:
    return rows["p_object_des"], rows["quat_object_des"]


def _of_all(rows: Rows) -> Placed:
    return unshifted(*_followed(rows), rows["shift"]) if rows["shift"].any() else _followed(rows)


def _pose(topic: str, of: Callable[[Rows], Placed]) -> StandardTopic:
    def fill(out: Rows, rows: Rows, stamp: Stamp) -> None:
        out["stamp"] = stamp
        _put_pose(out["pose"], *of(rows))

    template = CdrTemplate().header("", WORLD).number("pose", "<f8", 7)
    return _topic(topic, "geometry_msgs/PoseStamped", template, fill)


def _transforms(arm: SceneArm | None, frames: Sequence[tuple[str, Callable[[Rows], Placed]]]) -> StandardTopic:
    """The frames behind the moving joints of an arm, and frames in the world that rows have as they are."""
    moving = () if arm is None else arm.moving
    links = [] if arm is None else [(arm.frame(j.parent), arm.frame(j.child)) for _, j in moving]
    pairs = [*links, *((WORLD, child) for child, _ in frames)]
    template = CdrTemplate().length(len(pairs))
    for i, (parent, child) in enumerate(pairs):
        template.header(f"{i}.", parent).string(child).number(f"{i}.pose", "<f8", 7)
    joints = _Joints([joint for _, joint in moving])
    take = _compact([column for column, _ in moving])
    at = [slice(7 * i, 7 * i + 7) for i in range(len(moving))]
    stamped = [f"{i}.stamp" for i in range(len(pairs))]
    posed = [f"{i}.pose" for i in range(len(pairs))]

    def fill(out: Rows, rows: Rows, stamp: Stamp) -> None:
        for name in stamped:
            out[name] = stamp
        if moving:
            poses = joints.poses(rows["q_measured"][:, take])
            for name, part in zip(posed, at, strict=False):
                out[name] = poses[:, part]
        for name, (_, of) in zip(posed[len(moving) :], frames, strict=True):
            _put_pose(out[name], *of(rows))

    return _topic(TF_TOPIC, "tf2_msgs/TFMessage", template, fill)


class _Joints:
    """Poses of the children of some joints in their parents, for many values at a time."""

    def __init__(self, joints: Sequence[Joint]) -> None:
        """One matrix maps (1, cos q/2, sin q/2, q) of all joints to all poses: ξ(q) = cos(q/2) ξ(0) + sin(q/2) ξ(π)."""
        n = len(joints)
        self._half = np.array([0.5 * joint.turns for joint in joints])
        self._map = np.zeros((1 + 3 * n, 7 * n))
        for i, joint in enumerate(joints):
            start, far = np.array(_numbers(joint.pose(0.0))), np.array(_numbers(joint.pose(np.pi)))
            p, quat = slice(7 * i, 7 * i + 3), slice(7 * i + 3, 7 * i + 7)
            self._map[0, p] = start[:3]
            self._map[1 + i, quat] = start[3:]
            self._map[1 + n + i, quat] = far[3:] if joint.turns else 0.0
            self._map[1 + 2 * n + i, p] = (far[:3] - start[:3]) / np.pi
        self._slide = any(not joint.turns for joint in joints)
        if not self._slide:
            self._map = self._map[: 1 + 2 * n]

    def poses(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Poses (k, 7 n), attitude with the scalar last, at joint values q (k, n)."""
        k, n = q.shape
        half, basis = q * self._half, np.empty((k, 1, len(self._map)))
        basis[:, 0, 0] = 1.0
        np.cos(half, out=basis[:, 0, 1 : 1 + n])
        np.sin(half, out=basis[:, 0, 1 + n : 1 + 2 * n])
        if self._slide:
            basis[:, 0, 1 + 2 * n :] = q
        return (basis @ self._map)[:, 0]  # row by row: the same bits however many there are
