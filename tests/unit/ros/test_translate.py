"""What ROS hears of a cell's telemetry: everything new once, in order, nothing of another cell."""

from __future__ import annotations

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from agent.ros.translate import Translator
from agent.telemetry.link.wire import BatchHeader
from agent.telemetry.row.event import UTC_END_NS, Event, Level, encode
from agent.telemetry.row.topics import PLANT, Address, Kind
from tests.support.telemetry.scenes import scene
from tests.support.telemetry.telemetry_cell import ARMS, CELL, CONFIG_ID, SERVOS, UTC_0_NS, make_rows

STORE = get_typestore(Stores.ROS2_JAZZY)
TOPICS = {
    "/tf", "/tf_static", "/rosout", "/diagnostics", "/object/pose", "/object/pose_des",
    *(f"/{arm}/{name}" for arm in ARMS for name in ("robot_description", "joint_states", "wrench")),
}  # fmt: skip


def translator(*, clock: bool = False) -> Translator:
    return Translator(scene(CELL, ARMS), CONFIG_ID, has_plant=True, clock=clock)


def send(to: Translator, member: str, rows: np.ndarray, first: int = 0) -> list[tuple[str, bytes]]:
    header = BatchHeader(7, first, first + len(rows), 0)
    return list(to.take(Address(CELL, member, Kind.STATE).key, rows.tobytes(), header.pack()))


def clock_ns(message: bytes) -> int:
    time = STORE.deserialize_cdr(message, "rosgraph_msgs/msg/Clock").clock
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)


@pytest.mark.parametrize("clock", [False, True])
def test_the_topics_are_those_of_the_log(clock: bool) -> None:
    topics = {topic.name: topic for topic in translator(clock=clock).topics}
    assert set(topics) == TOPICS | ({"/clock"} if clock else set())
    assert {name for name, topic in topics.items() if topic.latched} == {
        "/tf_static", "/left/robot_description", "/right/robot_description", "/rosout",
    }  # fmt: skip


def test_rows_become_messages_at_the_rate_of_the_log() -> None:
    heard = send(translator(), "left", make_rows("left", 40))  # 0.2 s at 200 Hz
    assert [topic for topic, _ in heard].count("/left/joint_states") == 10
    assert [topic for topic, _ in heard].count("/tf") == 10
    stamps = [STORE.deserialize_cdr(m, "sensor_msgs/msg/JointState").header.stamp.nanosec for t, m in heard if
              t == "/left/joint_states"]  # fmt: skip
    assert stamps == [i * 20_000_000 for i in range(10)]


def test_what_is_sent_again_or_came_before_is_not_told_again() -> None:
    to, rows = translator(), make_rows("left", 40)
    assert send(to, "left", rows[20:], 20)
    assert send(to, "left", rows[20:], 20) == []
    assert send(to, "left", rows[:20]) == [], "a gap that is filled later is for the log"
    assert send(to, "right", make_rows("right", 4))


def test_a_new_run_of_the_arm_is_told_too() -> None:
    to, rows = translator(), make_rows("left", 40)
    send(to, "left", rows)
    rows["utc_ns"] += 60_000_000_000
    assert len(send(to, "left", rows)) > 10


def test_the_clock_is_the_newest_row_and_never_goes_back() -> None:
    to = translator(clock=True)
    heard = send(to, "left", make_rows("left", 40)) + send(to, "right", make_rows("right", 48))
    clocks = [clock_ns(m) - UTC_0_NS for topic, m in heard if topic == "/clock"]
    assert clocks == [i * 20_000_000 for i in range(12)]


def test_what_is_not_of_this_cell_is_counted_and_told_nobody() -> None:
    to, rows = translator(), make_rows("left", 4)
    other = rows.copy()
    other["config_id"] += 1
    more_joints = rows.copy()
    more_joints["joint_count"] = 4
    assert to.other_config == 0
    assert send(to, "left", other) == send(to, "left", more_joints) == send(to, "left", rows[:0]) == []
    assert (to.refused, to.other_config) == (2, other["config_id"][0])
    key = Address(CELL, "left", Kind.STATE).key
    assert list(to.take(key, rows.tobytes()[:-1], BatchHeader(7, 0, 4, 0).pack())) == []
    assert list(to.take(key, rows.tobytes(), b"no header")) == []
    assert list(to.take(f"coop/{CELL}/stranger/state", rows.tobytes(), b"")) == []
    assert to.refused == 4
    far_away = rows.copy()
    far_away["utc_ns"][1] = UTC_END_NS
    assert send(to, "left", far_away) == []
    assert to.refused == 5
    assert send(to, "left", rows) != [], "what was refused is not newer than what follows"


def test_an_event_is_told_once() -> None:
    to = translator()
    event = Event(UTC_0_NS, "left", Level.WARN, "mode TRACK → HOLD")
    key = Address(CELL, "left", Kind.EVENT).key
    ((topic, message),) = to.take(key, event.to_json(), BatchHeader(7, 0, 1, 0).pack())
    assert topic == "/rosout"
    assert STORE.deserialize_cdr(message, "rcl_interfaces/msg/Log").msg == "mode TRACK → HOLD"
    assert list(to.take(key, event.to_json(), BatchHeader(8, 0, 1, 0).pack())) == []


def test_the_plant_gives_the_object() -> None:
    heard = send(translator(), PLANT, make_rows(PLANT, 4))
    assert [topic for topic, _ in heard] == ["/object/pose", "/tf"]


def test_health_of_servos_becomes_a_diagnosis_once_and_never_an_older_one() -> None:
    to = translator()

    def tell(utc_ns: int) -> list[tuple[str, bytes]]:
        payload = encode({"utc_ns": utc_ns, **SERVOS})
        return list(to.take(Address(CELL, "left", Kind.HEALTH).key, payload, BatchHeader(7, 0, 1, 0).pack()))

    ((topic, message),) = tell(UTC_0_NS)
    assert topic == "/diagnostics"
    names = [status.name for status in STORE.deserialize_cdr(message, "diagnostic_msgs/msg/DiagnosticArray").status]
    assert names == ["arm left: servo 1 waist", "arm left: servo 2 shoulder", "arm left: servo 3 shoulder"]
    assert (tell(UTC_0_NS), tell(UTC_0_NS - 1), len(tell(UTC_0_NS + 1))) == ([], [], 1)
    header = BatchHeader(7, 0, 1, 0).pack()
    assert list(to.take(Address(CELL, "left", Kind.HEALTH).key, b'{"utc_ns":1}', header)) == []
    assert to.refused == 1
