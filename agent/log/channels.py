"""What goes on which channel of the log: rows as they came, standard messages beside them, texts.

Rows wait until there is a chunk of them: so many at a time cost half of what they do as they come.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Final

import numpy as np

from agent.log import diagnostics, ros_definitions, standard
from agent.log.cdr import text_message
from agent.log.chunk import Group, Message
from agent.log.diagnostics import Diagnostics
from agent.log.file import LogFile
from agent.log.scene import Scene
from agent.log.standard import StandardTopic
from agent.log.writer import CHUNK_BYTES, Records
from agent.telemetry.row.event import Event
from agent.telemetry.row.health import Health
from agent.telemetry.row.received import Rows, Text
from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE
from agent.telemetry.row.topics import PLANT, RECORDER, Address, Kind

_NO_SEQUENCE = np.zeros(1, np.uint64)
_FOREVER: Final = "{sec: 9223372036, nsec: 854775807}"
LATCHED_QOS: Final = (  # as rosbag2 of Jazzy and newer writes it: players then send these to whoever comes late
    "- history: keep_last\n  depth: 1\n  reliability: reliable\n  durability: transient_local\n"
    f"  deadline: {_FOREVER}\n  lifespan: {_FOREVER}\n  liveliness: automatic\n"
    f"  liveliness_lease_duration: {_FOREVER}\n  avoid_ros_namespace_conventions: false\n"
)


class _Standard:
    """The standard topics of one member, and where the decimation stands."""

    def __init__(self, channels: Sequence[tuple[StandardTopic, int]], told: Diagnostics | None) -> None:
        self.topics = [topic for topic, _ in channels]
        self.group = Group([Message(channel, topic.dtype, topic.template) for topic, channel in channels])
        self.diagnostics = told
        self.slot = -1


class LogChannels:
    """All channels of a log, registered before the first message."""

    def __init__(self, log: LogFile, scene: Scene, *, has_plant: bool) -> None:
        self._log = log
        self._scene = scene
        self._cell = scene.cell
        self._by_topic: dict[str, int] = {}
        self._rows: dict[str, Group] = {}
        self._standard: dict[str, _Standard] = {}
        self._texts: dict[tuple[str, Kind], int] = {}
        self._began = False
        self._waiting: dict[str, list[standard.Rows]] = {}  # by member
        self._waiting_bytes = 0
        self._scratch = np.empty(0, np.uint8)  # kept: a new one each time costs as much as what it is for
        log.before_flush = self._write_waiting
        for found in standard.latched(scene, 0):
            self._ros_channel(found.topic, found.ros_name, {"offered_qos_profiles": LATCHED_QOS})
        for i, arm in enumerate(scene.arms):
            self._add_rows(arm.name, {"member": arm.name, "joints": json.dumps(arm.joints)})
            topics = standard.arm_topics(arm, is_first=i == 0, has_plant=has_plant)
            self._add_standard(arm.name, topics, Diagnostics(arm.name))
        if has_plant:
            self._add_rows(PLANT, {"member": PLANT})
            self._add_standard(PLANT, standard.plant_topics(), None)
        for member in (*scene.joints, *([PLANT] if has_plant else []), RECORDER):
            for kind in (Kind.EVENT, Kind.HEALTH):
                topic = Address(self._cell, member, kind).topic
                self._texts[member, kind] = self._ros_channel(topic, "std_msgs/String")
        self._rosout = self._ros_channel(standard.LOG_TOPIC, "rcl_interfaces/Log")
        self._diagnostics = self._ros_channel(diagnostics.TOPIC, diagnostics.ROS_NAME)

    def write_rows(self, item: Rows) -> None:
        """Rows byte for byte as they came, and their standard messages, with the chunk that is written next."""
        rows = np.ascontiguousarray(item.rows)
        if not self._began:
            self._begin(int(rows["utc_ns"][0]))
        self._waiting.setdefault(item.address.member, []).append(rows)
        self._waiting_bytes += rows.nbytes
        if self._waiting_bytes >= CHUNK_BYTES:
            self._write_waiting()

    def _write_waiting(self) -> None:
        waiting, self._waiting, self._waiting_bytes = self._waiting, {}, 0
        for member, some in waiting.items():
            kind, count = some[0].dtype, sum(map(len, some))
            if count * kind.itemsize > len(self._scratch):
                self._scratch = np.empty(count * kind.itemsize, np.uint8)
            bare = np.dtype(f"V{kind.itemsize}")  # copied as bytes, not field by field
            messages: standard.Rows = np.ndarray(count, bare, self._scratch)
            np.concatenate([np.ndarray(len(each), bare, each) for each in some], out=messages)
            self._write_messages(member, messages, np.ndarray(count, kind, self._scratch))

    def _write_messages(self, member: str, messages: standard.Rows, rows: standard.Rows) -> None:
        """`messages`: the same as `rows`, as bytes."""

        def copy(records: Records, part: slice) -> None:
            records["message0"] = messages[part]

        self._log.write(self._rows[member], rows["sequence"], rows["utc_ns"], copy)
        beside = self._standard[member]
        some, beside.slot = standard.decimated(rows, beside.slot)
        if len(some):
            self._write_standard(beside, some)

    def _begin(self, utc_ns: int) -> None:
        """Before the first message: what a viewer must have before anything else, at that message's time."""
        if not self._began:
            self._began = True
            for found in standard.latched(self._scene, utc_ns):
                self._write_one(self._by_topic[found.topic], utc_ns, found.message)

    def _write_standard(self, beside: _Standard, rows: standard.Rows) -> None:
        stamp = standard.stamps(rows)

        def fill(records: Records, part: slice) -> None:
            own, at = rows[part], stamp[part]
            for topic, name in zip(beside.topics, beside.group.names, strict=True):
                topic.fill(records[name], own, at)

        self._log.write(beside.group, rows["sequence"], rows["utc_ns"], fill)
        if beside.diagnostics is not None:
            for utc_ns, message in beside.diagnostics.messages(rows):
                self._write_one(self._diagnostics, utc_ns, message)

    def write_text(self, item: Text) -> None:
        """An event, also as a line of the ROS log, or a health text."""
        self._begin(item.utc_ns)
        channel = self._texts[item.address.member, item.address.kind]
        if item.event is None:
            self._write_one(channel, item.utc_ns, text_message(item.payload))
            self._write_servos(item)
        else:
            self._write_event(channel, item.event, item.payload)

    def _write_servos(self, item: Text) -> None:
        with suppress(ValueError):  # a text of another kind is kept as it is
            message = diagnostics.servo_message(item.address.member, Health.from_json(item.payload))
            self._write_one(self._diagnostics, item.utc_ns, message)

    def write_own(self, event: Event) -> None:
        """An event of the recorder."""
        self._begin(event.utc_ns)
        self._write_event(self._texts[RECORDER, Kind.EVENT], event, event.to_json())

    def rows_lost(self) -> dict[str, int]:
        """Rows by member that came and are not in the file, because it failed."""
        self._write_waiting()
        return {member: self._log.lost[group.channels[0]] for member, group in self._rows.items()}

    def _write_event(self, channel: int, event: Event, payload: bytes) -> None:
        self._write_one(channel, event.utc_ns, text_message(payload))
        self._write_one(self._rosout, event.utc_ns, standard.log_message(event))

    def _write_one(self, channel: int, utc_ns: int, message: bytes) -> None:
        group = Group([Message(channel, np.dtype(f"V{len(message)}"), message)])
        self._log.write(group, _NO_SEQUENCE, np.array([utc_ns]), lambda *_: None)

    def _add_rows(self, member: str, described: Mapping[str, str]) -> None:
        layout = PLANT_STATE if member == PLANT else AGENT_STATE
        name = ros_definitions.schema_name(layout.ros_name)
        topic = Address(self._cell, member, Kind.STATE).topic
        channel = self._log.channel(topic, name, layout.definition, described)
        self._rows[member] = Group([Message(channel, np.dtype(f"V{layout.dtype.itemsize}"))])

    def _add_standard(self, member: str, topics: Sequence[StandardTopic], told: Diagnostics | None) -> None:
        self._standard[member] = _Standard([(t, self._ros_channel(t.topic, t.ros_name)) for t in topics], told)

    def _ros_channel(self, topic: str, ros_name: str, described: Mapping[str, str] | None = None) -> int:
        if topic not in self._by_topic:
            name, definition = ros_definitions.schema_name(ros_name), ros_definitions.definition(ros_name)
            self._by_topic[topic] = self._log.channel(topic, name, definition, described or {})
        return self._by_topic[topic]
