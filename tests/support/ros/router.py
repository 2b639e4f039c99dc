"""A Zenoh router set up as `rmw_zenohd` is, and a session set up as a ROS node's is."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from typing import Any

import zenoh

ROUTER = {
    "mode": "router",
    "scouting/multicast/enabled": False,
    "routing/router/peers_failover_brokering": False,
    "timestamping/enabled": True,
}
NODE = {
    "mode": "peer",
    "listen/endpoints": ["tcp/127.0.0.1:0"],
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": True,
    "timestamping/enabled": True,
}


@contextlib.contextmanager
def session(table: dict[str, Any]) -> Iterator[zenoh.Session]:
    config = zenoh.Config()
    for key, value in table.items():
        config.insert_json5(key, json.dumps(value))
    opened = zenoh.open(config)
    try:
        yield opened
    finally:
        opened.close()


@contextlib.contextmanager
def router(port: int) -> Iterator[str]:
    endpoint = f"tcp/127.0.0.1:{port}"
    with session(ROUTER | {"listen/endpoints": [endpoint]}):
        yield endpoint


def node(endpoint: str) -> contextlib.AbstractContextManager[zenoh.Session]:
    return session(NODE | {"connect/endpoints": [endpoint]})
