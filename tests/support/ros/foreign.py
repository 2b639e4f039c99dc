"""A ROS 2 client that is not ours (ROBOTIS' zenoh-ros2-sdk), in a process of its own; types are those of rosbags."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tests.support.ros.plain import plain


@dataclass(frozen=True)
class Client:
    """Where to look, and for how many topics to wait."""

    port: int
    topics: int
    domain: int = 0


def listen(client: Client, stop: Callable[[], bool], ready: Callable[[Any], None]) -> list[tuple[str, object]]:
    """Subscribe to every topic there is; ready gets their names and types; the messages come back at the stop."""
    from rosbags.typesys import Stores, get_typestore
    from zenoh_ros2_sdk import ROS2Subscriber, get_topic_names_and_types  # who finds the tests needs neither

    store = get_typestore(Stores.ROS2_KILTED)
    found: list[tuple[str, list[str]]] = []
    while len(found) < client.topics and not stop():
        found = get_topic_names_and_types(client.domain, "127.0.0.1", client.port, timeout=1.0)
    heard: list[tuple[str, object]] = []
    subscribers = []
    for topic, (ros_type,) in found:
        keep = lambda message, topic=topic: heard.append((topic, plain(message)))  # noqa: E731
        subscribers.append(
            ROS2Subscriber(
                topic, ros_type, keep, msg_definition=store.generate_msgdef(ros_type)[0], domain_id=client.domain,
                router_port=client.port, type_hash=store.hash_rihs01(ros_type),
            )
        )  # fmt: skip
    ready(found)
    while not stop():
        time.sleep(0.02)
    for subscriber in subscribers:
        subscriber.close()
    return heard
