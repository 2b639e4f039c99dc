"""A node of the ROS graph on a Zenoh session: publishers with their liveliness tokens; it subscribes to nothing."""

from __future__ import annotations

import time
from collections.abc import Iterable
from contextlib import ExitStack
from typing import Any, Final, Self

import zenoh
import zenoh.ext

from agent.ros.wire import Node, Topic, attachment, gid_of

_HEARTBEAT_S: Final = 0.5


class _Publisher:
    """One publisher: counts what it sends."""

    def __init__(self, session: zenoh.Session, topic: Topic, key: str, token: str, stack: ExitStack) -> None:
        self._publisher = stack.enter_context(_declare(session, topic, key))
        self._token = session.liveliness().declare_token(token)
        stack.callback(self._token.undeclare)
        self._gid = gid_of(token)
        self._sequence = 0

    def put(self, message: bytes) -> None:
        self._sequence += 1
        self._publisher.put(message, attachment=attachment(self._sequence, time.time_ns(), self._gid))


class RosNode:
    """The publishers of one node, by topic, for the time of a `with` block."""

    def __init__(self, session: zenoh.Session, domain: int, name: str, topics: Iterable[Topic]) -> None:
        """`topics`: all it will ever publish."""
        self._stack = ExitStack()
        node = Node(domain, str(session.info.zid()), name)
        with ExitStack() as stack:
            token = session.liveliness().declare_token(node.token)
            stack.callback(token.undeclare)
            self._publishers = {
                topic.name: _Publisher(session, topic, topic.key(domain), node.publisher_token(i, topic), stack)
                for i, topic in enumerate(topics, 1)
            }
            self._stack = stack.pop_all()

    def put(self, topic: str, message: bytes) -> None:
        """Publish a message on one of the topics; never waits for a receiver."""
        self._publishers[topic].put(message)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()


def _declare(session: zenoh.Session, topic: Topic, key: str) -> Any:  # the two kinds have no common type
    if not topic.latched:
        return session.declare_publisher(
            key, congestion_control=zenoh.CongestionControl.DROP, reliability=zenoh.Reliability.RELIABLE
        )
    return zenoh.ext.declare_advanced_publisher(
        session,
        key,
        congestion_control=zenoh.CongestionControl.DROP,
        cache=zenoh.ext.CacheConfig(max_samples=topic.depth),
        sample_miss_detection=zenoh.ext.MissDetectionConfig(sporadic_heartbeat=_HEARTBEAT_S),  # type: ignore[call-arg]
        publisher_detection=True,
    )
