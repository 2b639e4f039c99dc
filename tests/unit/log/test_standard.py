"""Standard messages decode, by an independent decoder, to the numbers of the rows they were made from."""

from __future__ import annotations

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from agent.control.alignment import shifted
from agent.control.trajectory import Desired
from agent.log import ros_definitions, standard
from agent.log.cdr import text_message, text_of
from agent.telemetry.row.event import Event, Level
from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE
from tests.support.telemetry.scenes import LOCKED_RAD, scene

JOINTS = ("waist", "shoulder", "elbow")
STORE = get_typestore(Stores.ROS2_HUMBLE)


def rows(layout, count: int) -> np.ndarray:
    random = np.random.default_rng(3)
    out = np.zeros(count, layout.dtype)
    for f in layout.fields:
        if f.ros_type == "float64":
            out[f.name] = random.standard_normal(out[f.name].shape)
    out["encapsulation"] = 0x100
    out["sequence"] = np.arange(count)
    out["utc_ns"] = 1_800_000_000_123_456_789 + np.arange(count) * 5_000_000
    return out


def messages(topic: standard.StandardTopic, data: np.ndarray) -> list[bytes]:
    """One complete message per row."""
    out = np.frombuffer(bytearray(topic.template * len(data)), topic.dtype)
    topic.fill(out, data, standard.stamps(data))
    return [message.tobytes() for message in out]


def decode(topic: standard.StandardTopic, message: bytes):
    return STORE.deserialize_cdr(message, ros_definitions.schema_name(topic.ros_name))


def stamp_ns(header) -> int:
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec


def arm(
    joints: tuple[str, ...] = JOINTS, *, first: bool = True, plant: bool = False
) -> dict[str, standard.StandardTopic]:
    described = scene("paper", {"left": joints}).arms[0]
    return {t.topic: t for t in standard.arm_topics(described, is_first=first, has_plant=plant)}


@pytest.mark.parametrize("joints", [("waist",), ("elbow", "waist"), JOINTS, ("shoulder", "elbow", "wrist_angle")])
def test_joint_states_have_measured_joints_and_locked_ones_in_the_order_of_the_urdf(joints: tuple[str, ...]) -> None:
    topic = arm(joints)["/left/joint_states"]
    data = rows(AGENT_STATE, 4)
    for row, message in zip(data, messages(topic, data), strict=True):
        decoded = decode(topic, message)
        assert decoded.name == [*JOINTS, "wrist_angle", "wrist_rotate"]
        assert decoded.header.frame_id == ""
        assert stamp_ns(decoded.header) == row["utc_ns"]
        for i, name in enumerate(decoded.name):
            if name in joints:
                k = joints.index(name)
                expected = [row["q_measured"][k], row["dq_measured"][k], row["tau_sent"][k]]
            else:
                expected = [LOCKED_RAD.get(name, 0.0), 0.0, np.nan]
            found = [decoded.position[i], decoded.velocity[i], decoded.effort[i]]
            assert np.array_equal(found, expected, equal_nan=True), name


def test_beside_a_true_pose_the_desired_one_is_that_of_all_arms() -> None:
    """What the first arm follows has the shift by which it sees the object elsewhere."""
    data, shift = rows(AGENT_STATE, 1), (5e-3, -1e-3, 2e-3, 0.02, -0.01, 0.03)
    there = Desired((0.3, 0.1, 0.2), (0.8, 0.0, 0.6, 0.0), (0.0,) * 6, (0.0,) * 6)
    data["p_object_des"], data["quat_object_des"], data["shift"] = *shifted(there, shift)[:2], shift
    for name in ("/object/pose_des", standard.TF_TOPIC):
        topic = arm(plant=True)[name]
        message = decode(topic, messages(topic, data)[0])
        if name == standard.TF_TOPIC:
            pose = next(t for t in message.transforms if t.child_frame_id == "object_des").transform
            p, o = pose.translation, pose.rotation
        else:
            p, o = message.pose.position, message.pose.orientation
        assert [p.x, p.y, p.z] == pytest.approx(there.p)
        assert [o.w, o.x, o.y, o.z] == pytest.approx(there.quat)


def test_poses_keep_their_order_and_the_scalar_goes_last() -> None:
    data = rows(AGENT_STATE, 2)
    topic = arm(plant=False)["/object/pose_des"]
    pose = decode(topic, messages(topic, data)[1]).pose
    assert [pose.position.x, pose.position.y, pose.position.z] == data["p_object_des"][1].tolist()
    o = pose.orientation
    assert [o.w, o.x, o.y, o.z] == data["quat_object_des"][1].tolist()


@pytest.mark.parametrize(
    ("first", "plant", "frames"),
    [
        (True, False, ["left/object", "object_des", "object"]),
        (True, True, ["left/object", "object_des"]),
        (False, True, ["left/object"]),
    ],
)
def test_each_frame_has_one_source(first: bool, plant: bool, frames: list[str]) -> None:
    topic = arm(first=first, plant=plant)[standard.TF_TOPIC]
    data = rows(AGENT_STATE, 1)
    data["shift"] = 0.0
    transforms = decode(topic, messages(topic, data)[0]).transforms
    links = ["left/shoulder_link", "left/upper_arm_link", "left/forearm_link"]
    assert [t.child_frame_id for t in transforms] == [*links, *frames]
    assert [t.header.frame_id for t in transforms[:3]] == ["left/base_link", *links[:2]]
    assert {t.header.frame_id for t in transforms[3:]} == {"world"}
    assert {stamp_ns(t.header) for t in transforms} == {int(data["utc_ns"][0])}
    assert transforms[3].transform.translation.y == data["p_object"][0, 1]
    assert (
        transforms[-1].transform.rotation.w
        == data["quat_object_des" if frames[-1] == "object_des" else "quat_object"][0, 0]
    )


def test_the_plant_gives_the_true_pose() -> None:
    data = rows(PLANT_STATE, 1)
    pose, tf = standard.plant_topics()
    assert decode(pose, messages(pose, data)[0]).pose.position.z == data["p_object"][0, 2]
    assert decode(tf, messages(tf, data)[0]).transforms[0].child_frame_id == "object"


def test_an_event_becomes_a_log_line() -> None:
    event = Event(1_800_000_000_000_000_005, "left", Level.WARN, "mode TRACK → HOLD", {"a": 1})
    line = STORE.deserialize_cdr(standard.log_message(event), "rcl_interfaces/msg/Log")
    assert (line.stamp.sec, line.stamp.nanosec) == (1_800_000_000, 5)
    assert (line.level, line.name, line.msg) == (30, "left", "mode TRACK → HOLD")


@pytest.mark.parametrize("text", ["", "a", "mode TRACK → HOLD"])
def test_a_text_becomes_a_string_message_and_comes_back(text: str) -> None:
    message = text_message(text.encode())
    assert STORE.deserialize_cdr(message, "std_msgs/msg/String").data == text
    assert text_of(message) == text.encode()


@pytest.mark.parametrize("wrong", [b"", b"\0\1\0\0", text_message(b"abc")[:-1], text_message(b"abc") + b"\0"])
def test_what_is_no_string_message_is_refused(wrong: bytes) -> None:
    with pytest.raises(ValueError, match="not a string message"):
        text_of(wrong)


def test_decimation_keeps_the_rate_whatever_the_batches() -> None:
    data = rows(AGENT_STATE, 400)  # 2 s at 200 Hz
    kept, slot = [], -1
    for batch in np.split(data, [1, 2, 7, 30, 200, 200]):
        some, slot = standard.decimated(batch, slot)
        kept += some["sequence"].tolist()
    assert len(kept) in (100, 101)
    assert set(np.diff(kept)[1:].tolist()) == {4}


@pytest.mark.parametrize("ros_name", sorted(ros_definitions._PARTS))
def test_definitions_are_complete_and_the_same_as_ros_has_them(ros_name: str) -> None:
    name = ros_definitions.schema_name(ros_name)
    text = ros_definitions.definition(ros_name)
    types = get_types_from_msg(text, name)
    for part in text.split("=" * 80)[1:]:
        inner = part.strip().splitlines()[0].removeprefix("MSG: ")
        assert types[ros_definitions.schema_name(inner)][1] == STORE.fielddefs[ros_definitions.schema_name(inner)][1]
    assert types[name][1] == STORE.fielddefs[name][1]


def test_a_message_has_the_same_bits_however_many_are_made_at_a_time() -> None:
    data = rows(AGENT_STATE, 23)
    for topic in arm().values():
        whole = messages(topic, data)
        for step in (1, 2, 5):
            parts = [m for i in range(0, 23, step) for m in messages(topic, data[i : i + step])]
            assert parts == whole, topic.topic
