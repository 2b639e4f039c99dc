"""A ROS 2 client that is not ours hears the whole cell through a router, with the values that are in the log."""

from __future__ import annotations

import json
import signal
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import pytest
import zenoh
import zenoh.ext
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from agent.ros import bridge
from agent.ros.wire import Topic
from agent.telemetry.link.endpoint import NetworkError
from agent.telemetry.link.publication import Pace
from agent.telemetry.link.session import Network, Role
from agent.telemetry.row.topics import PLANT
from tests.support.ports import free_port
from tests.support.ros import foreign, router
from tests.support.ros.plain import plain
from tests.support.stalls import Kernel, Stalled, despite_stalls
from tests.support.telemetry.one_arm import written
from tests.support.telemetry.scenes import scene
from tests.support.telemetry.telemetry_cell import ARMS, CELL, CONFIG_ID, Process, recorder, telemetry, writer

MEMBERS = (*ARMS, PLANT)
STORE = get_typestore(Stores.ROS2_JAZZY)
TIMEOUT_S = 30.0


class Bridge:
    """The bridge in a thread."""

    def __init__(self, telemetry_at: str, ros_at: str, config_id: int = CONFIG_ID) -> None:
        self.told: list[str] = []
        self._ended, ready = threading.Event(), threading.Event()
        self.report: bridge.BridgeReport | None = None
        options = bridge.BridgeOptions(
            scene(CELL, ARMS), config_id, True,
            Network(connect=(telemetry_at,), role=Role.VIEWER),
            Network(connect=(ros_at,), role=Role.VIEWER, timestamps=True),
            clock=True,
        )  # fmt: skip

        def work() -> None:
            self.report = bridge.run(options, self._ended.is_set, lambda _: ready.set(), self.told.append)

        self._thread = threading.Thread(target=work)
        self._thread.start()
        assert ready.wait(TIMEOUT_S)

    def end(self) -> bridge.BridgeReport:
        self._ended.set()
        self._thread.join(TIMEOUT_S)
        assert self.report is not None
        return self.report


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def late(session: zenoh.Session, topic: Topic) -> list[object]:
    """What a subscriber like rmw_zenoh's gets of a latched topic long after it was sent."""
    heard: list[object] = []
    name = topic.ros_name.replace("/", "/msg/")
    subscriber = zenoh.ext.declare_advanced_subscriber(
        session,
        topic.key(0),
        lambda sample: heard.append(plain(STORE.deserialize_cdr(sample.payload.to_bytes(), name))),
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
        recovery=zenoh.ext.RecoveryConfig(heartbeat=True),
        subscriber_detection=True,
    )
    wait_for(lambda: bool(heard))
    subscriber.undeclare()
    return heard


def stamp(message: object) -> object:
    """When a message was true; of a list of transforms the first."""
    assert isinstance(message, dict)
    header = message["header"] if "header" in message else message["transforms"][0]["header"]
    return header["stamp"]


@despite_stalls
def test_a_foreign_client_hears_the_cell_as_the_log_has_it(tmp_path: Path) -> None:
    port, kernel = free_port(), Kernel()
    with (
        router.router(port) as ros_at,
        recorder(tmp_path / "run.mcap", has_plant=True) as rec,
        Process(foreign.listen, foreign.Client(port, 13)) as client,
    ):
        endpoint = rec.ready()
        bridging = Bridge(endpoint, ros_at)
        found = dict(client.ready())
        rings = {member: tmp_path / f"{member}.ring" for member in MEMBERS}
        publishers = [telemetry(ring, m, endpoint, Pace.REAL_TIME) for m, ring in rings.items()]
        writers = [writer(ring, m, 400, 100.0, texts=m == "left") for m, ring in rings.items()]
        assert [w.result() for w in writers] == [400] * 3
        assert all(p.result().complete for p in publishers)
        with router.node(ros_at) as viewer:
            (frames,) = late(viewer, Topic("/tf_static", "tf2_msgs/TFMessage"))
            (robot,) = late(viewer, Topic("/left/robot_description", "std_msgs/String"))
        busy = kernel.accuses(client.process.pid)
        heard = client.stop()
        report = bridging.end()
        assert rec.stop().complete
    assert (report.dropped, report.refused) == (0, 0)

    logged = defaultdict(list)
    with AnyReader([tmp_path / "run.mcap"]) as reader:
        for c, _, raw in reader.messages():
            logged[c.topic].append(plain(reader.deserialize(raw, c.msgtype)))
        types = {c.topic: [c.msgtype] for c in reader.connections}
    assert found.items() <= (types | {"/clock": ["rosgraph_msgs/msg/Clock"]}).items()
    assert set(found) == {t for t in types if not t.startswith("/coop/")} | {"/clock"}
    by_topic = defaultdict(list)
    for topic, message in heard:
        by_topic[topic].append(message)
    clock = [(m["clock"]["sec"], m["clock"]["nanosec"]) for m in by_topic.pop("/clock")]
    assert clock == sorted(set(clock))
    assert len(clock) <= 101
    if busy and len(clock) < 50:  # on the way to a client that asks for no history
        raise Stalled(f"it lost {101 - len(clock)} of 101: {busy}")
    assert len(clock) >= 50
    for topic in set(by_topic) - {"/rosout"}:  # of each slot the first row heard, which need not be the first recorded
        stamps = [stamp(message) for message in logged[topic]]
        by_topic[topic] = [message for message in by_topic[topic] if stamp(message) in stamps]
    for topic, messages in by_topic.items():
        assert all(message in logged[topic] for message in messages), topic
        if topic != "/rosout":  # the first events may be older than the telemetry's way to the bridge
            if busy and len(messages) < 0.5 * len(logged[topic]):
                raise Stalled(f"{topic} had {len(messages)} of {len(logged[topic])}: {busy}")
            assert len(messages) >= 0.5 * len(logged[topic]), topic
    assert set(by_topic) == set(found) - {"/clock", "/tf_static", "/left/robot_description", "/right/robot_description"}
    assert robot == logged["/left/robot_description"][0]
    assert isinstance(frames, dict)
    assert [t["child_frame_id"] for t in frames["transforms"]] == [
        t["child_frame_id"] for t in logged["/tf_static"][0]["transforms"]
    ]


def test_rows_of_another_cell_file_are_told_of_once(tmp_path: Path) -> None:
    with router.router(free_port()) as ros_at, recorder(tmp_path / "run.mcap", {"left": ARMS["left"]}) as rec:
        endpoint = rec.ready()
        bridging = Bridge(endpoint, ros_at, CONFIG_ID + 1)
        ring = tmp_path / "left.ring"
        publisher = telemetry(ring, "left", endpoint, Pace.REAL_TIME)
        assert writer(ring, "left", 100, 100.0, texts=False).result() == 100
        assert publisher.result().complete
        wait_for(lambda: bool(bridging.told))
        report = bridging.end()
        assert rec.stop().complete
    assert report.refused > 1
    (told,) = bridging.told
    assert f"found those of another cell file ({CONFIG_ID:08x}), expected this one's ({CONFIG_ID + 1:08x})" in told


def test_a_bridge_that_is_stopped_holds_up_no_lockstep_run(tmp_path: Path) -> None:
    """It is told more than all buffers on the way hold, and whoever waited for it would close its link after 5 s."""
    port = free_port()
    with router.router(port) as ros_at, recorder(tmp_path / "run.mcap", {"left": ARMS["left"]}) as rec:
        endpoint = rec.ready()
        patient = tmp_path / "bridge.json5"  # its silence alone is no reason to close the link
        patient.write_text(json.dumps({"mode": "client", "connect": {"endpoints": [endpoint]}, **LEASE}))
        options = bridge.BridgeOptions(
            scene(CELL, {"left": ARMS["left"]}), CONFIG_ID, False, Network(config_file=patient),
            Network(connect=(ros_at,), role=Role.VIEWER, timestamps=True),
        )  # fmt: skip
        ring = tmp_path / "left.ring"
        with (
            router.node(ros_at) as viewer,
            Process(_run, options) as bridging,
            telemetry(ring, "left", endpoint, Pace.LOCKSTEP) as publisher,
        ):
            heard = threading.Event()
            subscriber = viewer.declare_subscriber("0/left/joint_states/**", lambda _: heard.set())
            bridging.ready()
            with writer(ring, "left", 100_000, None, slots=1024) as agent:
                agent.ready()
                assert heard.wait(TIMEOUT_S)
                bridging.signal(signal.SIGSTOP)
                before = written(ring)
                wait_for(lambda: written(ring) > before + 6000)
                assert linked(bridging.process.pid, int(endpoint.rpartition(":")[2]))
                agent.stop()
                assert publisher.result().complete
            bridging.signal(signal.SIGCONT)
            heard.clear()
            assert heard.wait(TIMEOUT_S)  # of what the buffers held
            subscriber.undeclare()
            assert bridging.stop().refused == 0
        assert rec.stop().complete


def _run(options: bridge.BridgeOptions, stop: Callable[[], bool], ready: Callable[[str], None]) -> bridge.BridgeReport:
    return bridge.run(options, stop, ready, str)


LEASE = {"transport": {"link": {"tx": {"lease": 300_000}}}, "scouting": {"multicast": {"enabled": False}}}


def linked(pid: int | None, port: int) -> bool:
    """Whether who listens at a port of this host still has a connection of a process open."""
    table = [line.split() for line in Path(f"/proc/{pid}/net/tcp").read_text().splitlines()[1:]]
    own = {link.readlink().name for link in Path(f"/proc/{pid}/fd").iterdir()}
    of_process = {words[1] for words in table if words[2].endswith(f":{port:04X}") and f"socket:[{words[9]}]" in own}
    established = {words[2] for words in table if words[1].endswith(f":{port:04X}") and words[3] == "01"}
    return bool(of_process & established)


def test_without_a_router_it_says_so_at_once() -> None:
    nowhere = Network(connect=(f"tcp/127.0.0.1:{free_port()}",), role=Role.VIEWER, timestamps=True)
    options = bridge.BridgeOptions(scene(CELL, ARMS), CONFIG_ID, False, nowhere, nowhere)
    with pytest.raises(
        NetworkError, match=r"expected somebody who listens there; start them first .*of ROS its router"
    ):
        bridge.run(options, lambda: True, lambda _: None, str)
