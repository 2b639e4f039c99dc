"""Telemetry of a cell into standard ROS messages, live: what is new and newer than all before, nothing twice.

A function of the messages alone, without network or clock.  The log has the same messages under the same topics.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from agent.log import diagnostics, standard
from agent.log.cdr import CdrTemplate, stamp_of
from agent.log.diagnostics import Diagnostics
from agent.log.scene import Scene
from agent.log.standard import StandardTopic
from agent.ros.wire import Topic
from agent.telemetry.link.wire import BatchHeader
from agent.telemetry.row.event import UTC_END_NS, Event
from agent.telemetry.row.health import Health
from agent.telemetry.row.sample import AGENT_STATE, CDR_LITTLE_ENDIAN, PLANT_STATE
from agent.telemetry.row.topics import PLANT, PUBLISHED, Address, Kind

CLOCK: Final = Topic("/clock", "rosgraph_msgs/Clock")
ROSOUT: Final = Topic(standard.LOG_TOPIC, "rcl_interfaces/Log", latched=True, depth=100)
DIAGNOSTICS: Final = Topic(diagnostics.TOPIC, diagnostics.ROS_NAME)
_TEXTS_MAX: Final = 10_000

Message = tuple[str, bytes]  # topic and encoded message


class _Member:
    """One source of rows: what it gives, and how far it has come."""

    def __init__(self, topics: list[StandardTopic], told: Diagnostics | None, joints: int | None) -> None:
        self.topics = topics
        self.diagnostics = told
        self.joints = joints
        self.dtype = (PLANT_STATE if joints is None else AGENT_STATE).dtype
        self.utc_ns = -1  # of the newest row
        self.slot = -1
        self.health_ns = -1  # of the newest health text


class Translator:
    """Messages of a cell's telemetry for ROS."""

    def __init__(self, scene: Scene, config_id: int, *, has_plant: bool, clock: bool) -> None:
        """`clock`: publish /clock, for time that is not the wall's."""
        self._scene = scene
        self._config_id = config_id
        self._clock = clock
        self._time_ns = -1
        self._members = {
            arm.name: _Member(
                standard.arm_topics(arm, is_first=i == 0, has_plant=has_plant), Diagnostics(arm.name), len(arm.joints)
            )
            for i, arm in enumerate(scene.arms)
        }
        if has_plant:
            self._members[PLANT] = _Member(standard.plant_topics(), None, None)
        names = [(member, kind) for member in self._members for kind in PUBLISHED]
        self._addresses = {Address(scene.cell, *name).key: name for name in names}
        self._told: set[bytes] = set()
        self.refused = 0  # messages that are not of this cell
        self.other_config = 0  # that rows of this cell's name came with; 0: none did

    @property
    def topics(self) -> list[Topic]:
        """All topics there will be."""
        found = [Topic(each.topic, each.ros_name, latched=True, depth=1) for each in standard.latched(self._scene, 0)]
        for member in self._members.values():
            found += [Topic(each.topic, each.ros_name) for each in member.topics]
        found += [ROSOUT, DIAGNOSTICS, *([CLOCK] if self._clock else [])]
        return list({topic.name: topic for topic in found}.values())

    def take(self, key: str, payload: bytes, attachment: bytes) -> Iterator[Message]:
        """What a message of the cell's telemetry is worth to ROS, in order; other keys are worth nothing."""
        address = self._addresses.get(key)
        if address is None:
            return iter(())
        try:
            BatchHeader.unpack(attachment)
            member, kind = address
            if kind is Kind.EVENT:
                return self._event(payload) if payload else iter(())
            if kind is Kind.HEALTH:
                return self._health(member, payload) if payload else iter(())
            return self._rows(self._members[member], payload)
        except ValueError:
            self.refused += 1
            return iter(())

    def _event(self, payload: bytes) -> Iterator[Message]:
        event = Event.from_json(payload)
        if payload in self._told:
            return iter(())
        if len(self._told) >= _TEXTS_MAX:
            self._told.clear()
        self._told.add(payload)
        return iter([(ROSOUT.name, standard.log_message(event))])

    def _health(self, name: str, payload: bytes) -> Iterator[Message]:
        told, member = Health.from_json(payload), self._members[name]
        if told.utc_ns <= member.health_ns:
            return iter(())
        member.health_ns = told.utc_ns
        return iter([(DIAGNOSTICS.name, diagnostics.servo_message(name, told))])

    def _rows(self, member: _Member, payload: bytes) -> Iterator[Message]:
        rows: standard.Rows = np.frombuffer(payload, member.dtype)  # raises ValueError at a wrong length
        if (rows["encapsulation"] != CDR_LITTLE_ENDIAN).any():
            raise ValueError("no rows")
        others = rows["config_id"][rows["config_id"] != self._config_id]
        if len(others):
            self.other_config = int(others[0])
            raise ValueError("rows of another cell file")
        if member.joints is not None and (rows["joint_count"] != member.joints).any():
            raise ValueError("rows of another arm")
        if (rows["utc_ns"] >= UTC_END_NS).any():  # and it would be newer than all that follows
            raise ValueError("rows of a time that no stamp can have")
        newer = rows["utc_ns"] > member.utc_ns
        if not newer.all():
            rows = rows[newer]  # sent again, or of a run before this one
        if not len(rows):
            return iter(())
        member.utc_ns = int(rows["utc_ns"].max())
        some, member.slot = standard.decimated(np.ascontiguousarray(rows), member.slot)
        return self._messages(member, some)

    def _messages(self, member: _Member, rows: standard.Rows) -> Iterator[Message]:
        stamps = standard.stamps(rows)
        columns = []
        for topic in member.topics:
            out = np.frombuffer(bytearray(topic.template * len(rows)), topic.dtype)
            topic.fill(out, rows, stamps)
            columns.append((topic.topic, out))
        for i, utc_ns in enumerate(rows["utc_ns"].tolist()):
            if self._clock and utc_ns > self._time_ns:
                self._time_ns = utc_ns
                yield CLOCK.name, CdrTemplate().given("<u4", stamp_of(utc_ns)).message
            for name, out in columns:
                yield name, out[i].tobytes()
        if member.diagnostics is not None:
            for _, message in member.diagnostics.messages(rows):
                yield DIAGNOSTICS.name, message
