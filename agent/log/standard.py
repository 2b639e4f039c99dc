"""Standard ROS 2 messages from rows, many at a time, for viewers that know nothing of ours.

With fixed strings and counts these messages have a constant layout too: one encoded template, numbers filled in.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.telemetry.row.event import Event
from agent.telemetry.row.sample import CDR_LITTLE_ENDIAN
from agent.telemetry.row.topics import ROOT

WORLD: Final = "world"
RATE_HZ: Final = 50.0
_SLOT_NS: Final = np.int64(1e9 / RATE_HZ)
LOG_TOPIC: Final = "/rosout"
TF_TOPIC: Final = "/tf"
_STRING_HEAD: Final = struct.Struct("<II")  # encapsulation, length with the closing zero

Rows = NDArray[np.void]


class Stamp(NamedTuple):
    """Time of each row as ROS has it."""

    sec: NDArray[np.int64]
    nanosec: NDArray[np.int64]

    @staticmethod
    def of(rows: Rows) -> Stamp:
        """The rows' UTC."""
        return Stamp(*np.divmod(rows["utc_ns"], 1_000_000_000))


Fill = Callable[[Rows, Rows, Stamp], None]  # (messages to fill, rows to fill them from, their stamps), equally long


class CdrTemplate:
    """Builds one little-endian CDR message and remembers where the numbers are."""

    def __init__(self) -> None:
        self._data = bytearray(b"\0\1\0\0")
        self._names: list[str] = []
        self._formats: list[object] = []
        self._offsets: list[int] = []

    def number(self, name: str, code: str, count: int = 0) -> CdrTemplate:
        """A number, or a fixed array of `count`; `code` is numpy's, such as `<f8`."""
        size = np.dtype(code).itemsize
        self._align(size)
        self._names.append(name)
        self._formats.append((code, (count,)) if count else code)
        self._offsets.append(len(self._data))
        self._data += bytes(size * max(count, 1))
        return self

    def length(self, count: int) -> CdrTemplate:
        """Number of elements of a sequence, which the caller adds."""
        self._align(4)
        self._data += struct.pack("<I", count)
        return self

    def string(self, text: str) -> CdrTemplate:
        """A string that never changes."""
        encoded = text.encode() + b"\0"
        self.length(len(encoded))
        self._data += encoded
        return self

    def header(self, prefix: str, frame: str) -> CdrTemplate:
        """std_msgs/Header whose stamp is filled in."""
        return self.number(f"{prefix}sec", "<i4").number(f"{prefix}nanosec", "<u4").string(frame)

    @property
    def message(self) -> bytes:
        """The encoded message, all numbers zero."""
        return bytes(self._data)

    @property
    def dtype(self) -> np.dtype[np.void]:
        """The message as a numpy record."""
        return np.dtype(
            {
                "names": self._names,
                "formats": self._formats,
                "offsets": self._offsets,
                "itemsize": len(self._data),
            }
        )

    def _align(self, size: int) -> None:
        self._data += bytes((4 - len(self._data)) % size)


@dataclass(frozen=True)
class StandardTopic:
    """One topic of standard messages made from rows."""

    topic: str
    ros_name: str
    template: bytes  # a complete message, all numbers zero
    dtype: np.dtype[np.void]
    fill: Fill


def arm_topics(cell: str, arm: str, joints: Sequence[str], *, is_first: bool, has_plant: bool) -> list[StandardTopic]:
    """Standard topics of an arm's rows.

    The first arm also gives the desired object pose and, without a plant that knows the truth, the actual one.
    """
    base = f"/{ROOT}/{cell}/{arm}"
    frames = [(f"{arm}/object", "p_object", "quat_object")]
    topics = [_joint_state(f"{base}/joint_states", joints), _wrench(f"{base}/wrench", "wrench_cmd")]
    if is_first:
        frames.append(("object_des", "p_object_des", "quat_object_des"))
        topics.append(_pose(f"/{ROOT}/{cell}/object/pose_des", "p_object_des", "quat_object_des"))
        if not has_plant:
            frames.append(("object", "p_object", "quat_object"))
            topics.append(_pose(f"/{ROOT}/{cell}/object/pose", "p_object", "quat_object"))
    return [*topics, _transforms(frames)]


def plant_topics(cell: str) -> list[StandardTopic]:
    """Standard topics of the plant's rows: where the object really is."""
    return [
        _pose(f"/{ROOT}/{cell}/object/pose", "p_object", "quat_object"),
        _transforms([("object", "p_object", "quat_object")]),
    ]


def decimated(rows: Rows, last_slot: int) -> tuple[Rows, int]:
    """The first row of each 1/RATE_HZ of time, and the last slot of time seen; pass that in again."""
    if not len(rows):
        return rows, last_slot
    slots = rows["utc_ns"] // _SLOT_NS
    fresh = np.empty(len(rows), np.bool_)
    fresh[0] = slots[0] != last_slot
    np.not_equal(slots[1:], slots[:-1], out=fresh[1:])
    whole = rows.view(f"V{rows.dtype.itemsize}")  # copied as bytes, not field by field
    return whole[fresh].view(rows.dtype), int(slots[-1])


def text_message(text: bytes) -> bytes:
    """std_msgs/String of a UTF-8 text.  (JSON channels would be simpler, but ROS tools refuse a file that has one.)"""
    return _STRING_HEAD.pack(CDR_LITTLE_ENDIAN, len(text) + 1) + text + b"\0"


def text_of(message: bytes) -> bytes:
    """The text of a std_msgs/String.  Raises ValueError when it is none."""
    if len(message) <= _STRING_HEAD.size or message[-1]:
        raise ValueError("not a string message")
    head, length = _STRING_HEAD.unpack_from(message)
    if head != CDR_LITTLE_ENDIAN or _STRING_HEAD.size + length != len(message):
        raise ValueError("not a string message")
    return message[_STRING_HEAD.size : -1]


def log_message(event: Event) -> bytes:
    """rcl_interfaces/Log of an event."""
    out = CdrTemplate().number("sec", "<i4").number("nanosec", "<u4").number("level", "u1")
    out.string(event.source).string(event.text).string("").string("").number("line", "<u4")
    message = np.frombuffer(bytearray(out.message), out.dtype)
    message["sec"], message["nanosec"] = divmod(event.utc_ns, 1_000_000_000)
    message["level"] = event.level.value
    return message.tobytes()


def _topic(topic: str, ros_name: str, template: CdrTemplate, fill: Fill) -> StandardTopic:
    return StandardTopic(topic, ros_name, template.message, template.dtype, fill)


def _set_stamp(out: Rows, stamp: Stamp, prefix: str = "") -> None:
    out[f"{prefix}sec"], out[f"{prefix}nanosec"] = stamp


def _set_pose(out: Rows, p: NDArray[np.float64], quat_scalar_first: NDArray[np.float64], prefix: str = "") -> None:
    out[f"{prefix}p"] = p
    quat = out[f"{prefix}quat"]  # scalar last
    quat[:, :3], quat[:, 3] = quat_scalar_first[:, 1:], quat_scalar_first[:, 0]


def _joint_state(topic: str, joints: Sequence[str]) -> StandardTopic:
    n = len(joints)
    template = CdrTemplate().header("", WORLD).length(n)
    for joint in joints:
        template.string(joint)
    for name in ("position", "velocity", "effort"):
        template.length(n).number(name, "<f8", n)

    def fill(out: Rows, rows: Rows, stamp: Stamp) -> None:
        _set_stamp(out, stamp)
        out["position"] = rows["q_measured"][:, :n]
        out["velocity"] = rows["dq_measured"][:, :n]
        out["effort"] = rows["tau_sent"][:, :n]

    return _topic(topic, "sensor_msgs/JointState", template, fill)


def _wrench(topic: str, field: str) -> StandardTopic:
    def fill(out: Rows, rows: Rows, stamp: Stamp) -> None:
        _set_stamp(out, stamp)
        out["wrench"] = rows[field]

    template = CdrTemplate().header("", WORLD).number("wrench", "<f8", 6)
    return _topic(topic, "geometry_msgs/WrenchStamped", template, fill)


def _pose(topic: str, p: str, quat: str) -> StandardTopic:
    def fill(out: Rows, rows: Rows, stamp: Stamp) -> None:
        _set_stamp(out, stamp)
        _set_pose(out, rows[p], rows[quat])

    template = CdrTemplate().header("", WORLD).number("p", "<f8", 3).number("quat", "<f8", 4)
    return _topic(topic, "geometry_msgs/PoseStamped", template, fill)


def _transforms(frames: Sequence[tuple[str, str, str]]) -> StandardTopic:
    template = CdrTemplate().length(len(frames))
    for i, (child, _, _) in enumerate(frames):
        template.header(f"{i}.", WORLD).string(child).number(f"{i}.p", "<f8", 3).number(f"{i}.quat", "<f8", 4)

    def fill(out: Rows, rows: Rows, stamp: Stamp) -> None:
        for i, (_, p, quat) in enumerate(frames):
            _set_stamp(out, stamp, f"{i}.")
            _set_pose(out, rows[p], rows[quat], f"{i}.")

    return _topic(TF_TOPIC, "tf2_msgs/TFMessage", template, fill)
