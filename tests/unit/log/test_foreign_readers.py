"""What ROS tools look for in a log is there, by readers that are not ours, with nothing but what is in the file."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability

from tests.support.ros.plain import plain
from tests.support.telemetry.log_maker import make_log
from tests.support.telemetry.scenes import scene
from tests.support.telemetry.telemetry_cell import ARMS, CELL

LATCHED = ["/tf_static", "/left/robot_description", "/right/robot_description"]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    make_log(path, 300)
    return path


def test_frames_and_robots_come_first_in_the_file_and_once(log: Path) -> None:
    with log.open("rb") as file:
        topics = [channel.topic for _, channel, _ in make_reader(file).iter_messages(log_time_order=False)]
    assert topics[:3] == LATCHED
    assert not set(topics[3:]) & set(LATCHED)


def test_players_know_that_latecomers_need_them(log: Path) -> None:
    with AnyReader([log]) as reader:
        for connection in reader.connections:
            profiles = connection.ext.offered_qos_profiles
            if connection.topic in LATCHED:
                assert [p.durability for p in profiles] == [QosDurability.TRANSIENT_LOCAL]
                assert profiles[0].depth == 1
            else:
                assert not profiles


def test_rosbags_and_mcap_read_every_topic_alike(log: Path) -> None:
    with AnyReader([log]) as reader:
        by_rosbags = [(c.topic, t, reader.deserialize(raw, c.msgtype)) for c, t, raw in reader.messages()]
    with log.open("rb") as file:
        decoded = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        by_mcap = [(c.topic, m.log_time, message) for _, c, m, message in decoded]
    assert sorted((topic, t) for topic, t, _ in by_rosbags) == sorted((topic, t) for topic, t, _ in by_mcap)
    for topic in ("/tf", "/left/joint_states", "/right/wrench", "/object/pose", "/diagnostics", *LATCHED):
        one, other = ([m for name, _, m in found if name == topic] for found in (by_rosbags, by_mcap))
        assert len(one) == len(other) > 0, topic
        for a, b in zip(one, other, strict=True):
            assert plain(a) == plain(b), topic
    text = next(m.data for topic, _, m in by_rosbags if topic == "/left/robot_description")
    assert text == scene(CELL, ARMS).arms[0].urdf_xml
