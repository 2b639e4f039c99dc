"""What goes on which channel of the log: rows as they came, standard messages beside them, texts."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

import numpy as np

from agent.log import ros_definitions, standard
from agent.log.chunk import Group, Message
from agent.log.file import LogFile
from agent.log.standard import Stamp, StandardTopic
from agent.log.writer import Records
from agent.telemetry.row.event import Event
from agent.telemetry.row.received import Rows, Text
from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE
from agent.telemetry.row.topics import PLANT, RECORDER, Address, Kind

_NO_SEQUENCE = np.zeros(1, np.uint64)


class _Standard:
    """The standard topics of one member, and where the decimation stands."""

    def __init__(self, channels: Sequence[tuple[StandardTopic, int]]) -> None:
        self.topics = [topic for topic, _ in channels]
        self.group = Group([Message(channel, topic.dtype, topic.template) for topic, channel in channels])
        self.slot = -1


class LogChannels:
    """All channels of a log, registered before the first message."""

    def __init__(self, log: LogFile, cell: str, arms: Mapping[str, tuple[str, ...]], *, has_plant: bool) -> None:
        """`arms`: controlled joints by arm."""
        self._log = log
        self._by_topic: dict[str, int] = {}
        self._rows: dict[str, Group] = {}
        self._standard: dict[str, _Standard] = {}
        self._texts: dict[tuple[str, Kind], int] = {}
        for i, (arm, joints) in enumerate(arms.items()):
            described = {"member": arm, "joints": json.dumps(joints)}
            self._add_rows(cell, arm, described)
            self._add_standard(arm, standard.arm_topics(cell, arm, joints, is_first=i == 0, has_plant=has_plant))
        if has_plant:
            self._add_rows(cell, PLANT, {"member": PLANT})
            self._add_standard(PLANT, standard.plant_topics(cell))
        for member in (*arms, *([PLANT] if has_plant else []), RECORDER):
            for kind in (Kind.EVENT, Kind.HEALTH):
                self._texts[member, kind] = self._ros_channel(Address(cell, member, kind).topic, "std_msgs/String")
        self._rosout = self._ros_channel(standard.LOG_TOPIC, "rcl_interfaces/Log")

    def write_rows(self, item: Rows) -> None:
        """Rows byte for byte as they came, and their standard messages."""
        member, rows = item.address.member, np.ascontiguousarray(item.rows)
        messages = rows.view(f"V{rows.dtype.itemsize}")

        def copy(records: Records, part: slice) -> None:
            records["message0"] = messages[part]

        self._log.write(self._rows[member], rows["sequence"], rows["utc_ns"], copy)
        beside = self._standard[member]
        some, beside.slot = standard.decimated(rows, beside.slot)
        if len(some):
            self._write_standard(beside, some)

    def _write_standard(self, beside: _Standard, rows: standard.Rows) -> None:
        stamp = Stamp.of(rows)

        def fill(records: Records, part: slice) -> None:
            own, at = rows[part], Stamp(stamp.sec[part], stamp.nanosec[part])
            for topic, name in zip(beside.topics, beside.group.names, strict=True):
                topic.fill(records[name], own, at)

        self._log.write(beside.group, rows["sequence"], rows["utc_ns"], fill)

    def write_text(self, item: Text) -> None:
        """An event, also as a line of the ROS log, or a health text."""
        channel = self._texts[item.address.member, item.address.kind]
        if item.event is None:
            self._write_one(channel, item.utc_ns, standard.text_message(item.payload))
        else:
            self._write_event(channel, item.event, item.payload)

    def write_own(self, event: Event) -> None:
        """An event of the recorder."""
        self._write_event(self._texts[RECORDER, Kind.EVENT], event, event.to_json())

    def rows_lost(self) -> dict[str, int]:
        """Rows by member that came and are not in the file, because it failed."""
        return {member: self._log.lost[group.channels[0]] for member, group in self._rows.items()}

    def _write_event(self, channel: int, event: Event, payload: bytes) -> None:
        self._write_one(channel, event.utc_ns, standard.text_message(payload))
        self._write_one(self._rosout, event.utc_ns, standard.log_message(event))

    def _write_one(self, channel: int, utc_ns: int, message: bytes) -> None:
        group = Group([Message(channel, np.dtype(f"V{len(message)}"), message)])
        self._log.write(group, _NO_SEQUENCE, np.array([utc_ns]), lambda *_: None)

    def _add_rows(self, cell: str, member: str, described: Mapping[str, str]) -> None:
        layout = PLANT_STATE if member == PLANT else AGENT_STATE
        name = ros_definitions.schema_name(layout.ros_name)
        topic = Address(cell, member, Kind.STATE).topic
        channel = self._log.channel(topic, name, layout.definition, described)
        self._rows[member] = Group([Message(channel, np.dtype(f"V{layout.dtype.itemsize}"))])

    def _add_standard(self, member: str, described: Sequence[StandardTopic]) -> None:
        self._standard[member] = _Standard([(t, self._ros_channel(t.topic, t.ros_name)) for t in described])

    def _ros_channel(self, topic: str, ros_name: str) -> int:
        if topic not in self._by_topic:
            name, definition = ros_definitions.schema_name(ros_name), ros_definitions.definition(ros_name)
            self._by_topic[topic] = self._log.channel(topic, name, definition, {})
        return self._by_topic[topic]
