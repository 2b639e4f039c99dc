"""Names and bytes are those of rmw_zenoh: by rosbags (type hashes), pamoja (keys) and the written-down format."""

from __future__ import annotations

import struct

import pytest
from pamoja import ros2 as pamoja
from rosbags.typesys import Stores, get_typestore

from agent.log.ros_definitions import schema_name
from agent.ros.wire import TYPE_HASHES, Node, Topic, attachment, gid_of

DISTRIBUTIONS = (Stores.ROS2_JAZZY, Stores.ROS2_KILTED)


@pytest.mark.parametrize("distribution", DISTRIBUTIONS, ids=lambda d: d.value)
@pytest.mark.parametrize("ros_name", sorted(TYPE_HASHES))
def test_a_type_hash_is_the_one_of_its_definition(distribution: Stores, ros_name: str) -> None:
    assert Topic("/a", ros_name).type_hash == get_typestore(distribution).hash_rihs01(schema_name(ros_name))


@pytest.mark.parametrize("domain", [0, 42])
@pytest.mark.parametrize("name", ["/tf", "/left/joint_states", "/object/pose_des"])
def test_a_key_is_the_one_an_independent_gateway_makes(domain: int, name: str) -> None:
    topic = Topic(name, "sensor_msgs/JointState")
    assert topic.key(domain) == pamoja.entity_key(domain, name, "sensor_msgs/msg/JointState", topic.type_hash)


def test_tokens_name_node_and_publisher_as_the_graph_wants_them() -> None:
    node, topic = Node(3, "a1b2", "coop_paper"), Topic("/left/wrench", "geometry_msgs/WrenchStamped")
    assert node.token == "@ros2_lv/3/a1b2/0/0/NN/%/%/coop_paper"
    assert node.publisher_token(7, topic) == (
        f"@ros2_lv/3/a1b2/0/7/MP/%/%/coop_paper/{pamoja.percent_mangle('/left/wrench')}"
        f"/geometry_msgs::msg::dds_::WrenchStamped_/{topic.type_hash}/1:2:1,10:,:,:,,"
    )


def test_a_latched_topic_says_so() -> None:
    assert Topic("/tf_static", "tf2_msgs/TFMessage", latched=True, depth=1).qos == "1:1:1,1:,:,:,,"


def test_an_attachment_has_33_bytes_in_their_order() -> None:
    gid = gid_of("token")
    packed = attachment(5, 1_800_000_000_000_000_001, gid)
    assert struct.unpack("<qqB16s", packed) == (5, 1_800_000_000_000_000_001, 16, gid)
    assert len(packed) == 33
    assert gid_of("another") != gid == gid_of("token")
