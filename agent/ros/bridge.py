"""The bridge: one session to the cell's telemetry, one to a ROS router; what it hears on the first goes to the second.

It opens no port, publishes no key of the cell, and a slow or missing ROS costs the cell nothing: what does not fit is
dropped here and counted.
"""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Final

import zenoh

from agent.log import standard
from agent.log.scene import Scene
from agent.ros.node import RosNode
from agent.ros.translate import Translator
from agent.telemetry.link.session import Network, open_session
from agent.telemetry.row import topics

WAITING_MAX: Final = 2000  # messages of telemetry, 60 kB each at most
_WAIT_S: Final = 0.1


@dataclass(frozen=True)
class BridgeOptions:
    """One cell, one ROS domain."""

    scene: Scene
    config_id: int
    has_plant: bool
    telemetry: Network
    ros: Network
    domain: int = 0
    clock: bool = False  # the cell's time is not the wall's


@dataclass(frozen=True, slots=True)
class BridgeReport:
    """What went through."""

    published: int
    dropped: int  # messages of telemetry that came faster than they were translated
    refused: int  # messages of telemetry that are not of this cell


def run(
    options: BridgeOptions, stop: Callable[[], bool], ready: Callable[[str], None], tell: Callable[[str], None]
) -> BridgeReport:
    """Bridge until `stop`; `ready` gets the node's name, `tell` once that rows are refused.

    Raises NetworkError, BadName.
    """
    name = f"coop_{topics.check_name(options.scene.cell, 'cell')}"
    translator = Translator(options.scene, options.config_id, has_plant=options.has_plant, clock=options.clock)
    heard = _Heard()
    published, told = 0, False
    with ExitStack() as stack:
        cell = stack.enter_context(open_session(options.telemetry)).session
        ros = stack.enter_context(open_session(options.ros)).session
        node = stack.enter_context(RosNode(ros, options.domain, name, translator.topics))
        for message in standard.latched(options.scene, time.time_ns()):
            node.put(message.topic, message.message)
        subscriber = cell.declare_subscriber(topics.cell_keys(options.scene.cell), heard.put)
        stack.callback(subscriber.undeclare)
        ready(name)
        while not stop():
            sample = heard.get(_WAIT_S)
            if sample is not None:
                for topic, encoded in translator.take(*sample):
                    node.put(topic, encoded)
                    published += 1
                if translator.other_config and not told:
                    tell(_of_another_file(options, translator.other_config))
                    told = True
    return BridgeReport(published, heard.dropped, translator.refused)


def _of_another_file(options: BridgeOptions, config_id: int) -> str:
    return (
        f"rows of cell {options.scene.cell}: found those of another cell file ({config_id:08x}), expected this one's "
        f"({options.config_id:08x}); none goes to ROS: bridge the file that runs, with the same --set"
    )


class _Heard:
    """Between Zenoh's threads and the bridge's: bounded, and putting in never waits."""

    def __init__(self) -> None:
        self._queue: queue.Queue[tuple[str, bytes, bytes]] = queue.Queue(WAITING_MAX)
        self.dropped = 0

    def put(self, sample: zenoh.Sample) -> None:
        attachment = sample.attachment
        if attachment is None:
            return
        try:
            self._queue.put_nowait((str(sample.key_expr), sample.payload.to_bytes(), attachment.to_bytes()))
        except queue.Full:
            self.dropped += 1

    def get(self, timeout_s: float) -> tuple[str, bytes, bytes] | None:
        try:
            return self._queue.get(timeout=timeout_s)
        except queue.Empty:
            return None
