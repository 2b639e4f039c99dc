"""Ring -> Zenoh -> MCAP -> reader, with real processes, sockets and files: nothing is lost, and others can read it."""

from __future__ import annotations

import contextlib
import math
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from agent.log.read import LogError, RunLog, read_log
from agent.telemetry.link import play
from agent.telemetry.link.play import PlayOptions
from agent.telemetry.link.playhead import Order
from agent.telemetry.link.publication import Pace
from agent.telemetry.link.session import Network, Role, open_session
from agent.telemetry.link.wire import BatchHeader
from agent.telemetry.row.topics import PLANT
from tests.support.telemetry.one_arm import wait_for
from tests.support.telemetry.scenes import LOCKED_RAD
from tests.support.telemetry.telemetry_cell import (
    ARMS,
    UTC_0_NS,
    Process,
    make_rows,
    recorder,
    recording,
    telemetry,
    writer,
)

MEMBERS = (*ARMS, PLANT)
ROWS, SLOTS = 2500, 512  # of each member's run, and of its ring


def record_cell(folder: Path, rows: int, rate_hz: float | None, **changes: Any) -> RunLog:
    """A whole run of two arms and a plant; everything ends by itself but the recorder."""
    pace = Pace.LOCKSTEP if rate_hz is None else Pace.REAL_TIME
    with contextlib.ExitStack() as stack:
        cell = recording(stack, folder, pace, has_plant=True, **changes)
        each = cell.rings.items()
        writers = [
            stack.enter_context(writer(ring, m, rows, rate_hz, texts=m == "left", slots=SLOTS)) for m, ring in each
        ]
        assert [w.result() for w in writers] == [rows] * 3
        assert all(p.result().complete for p in cell.told.values())
        report = cell.recorder.stop()
    assert report.complete, report
    assert report.failure is None
    return read_log(folder / "run.mcap")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunLog:
    """A lockstep run, several rings long, recorded as fast as it goes."""
    return record_cell(tmp_path_factory.mktemp("run"), ROWS, None)


def test_lockstep_loses_nothing_however_fast_it_is(run: RunLog) -> None:
    assert run.complete
    assert run.gaps == dict.fromkeys(MEMBERS, ())
    for arm in ARMS:
        assert run.agents[arm].tobytes() == make_rows(arm, ROWS).tobytes()
    assert run.plant is not None
    assert run.plant.tobytes() == make_rows(PLANT, ROWS).tobytes()


def test_events_of_the_agent_and_of_its_rows_are_there_once(run: RunLog) -> None:
    told = [e.text for e in run.events if e.source == "left"]
    assert sorted(told) == sorted([f"row {i}" for i in range(0, ROWS, 100)] + ["mode READY → TRACK"])
    assert [e.text for e in run.events if e.source == "right"] == ["mode READY → TRACK"]


def test_the_log_says_who_made_it_and_that_it_is_whole(run: RunLog) -> None:
    assert run.run_info() == {"cell": "paper"}
    assert run.metadata["recorder"]["cell"] == "paper"
    assert run.metadata["completeness"]["left.rows_recorded"] == str(ROWS)
    assert run.metadata["completeness"]["complete"] == "true"


def test_real_time_loses_nothing_either(tmp_path: Path) -> None:
    log = record_cell(tmp_path, 300, 200.0)
    assert log.complete
    assert log.agents["right"].tobytes() == make_rows("right", 300).tobytes()


def test_mcap_tools_decode_every_message(run: RunLog) -> None:
    rows = make_rows("left", ROWS)
    count: dict[str, int] = {}
    with run.path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        cdr = {c.topic for c in reader.get_summary().channels.values() if c.message_encoding == "cdr"}
        for _, channel, message, decoded in reader.iter_decoded_messages(topics=cdr):
            i = count[channel.topic] = count.get(channel.topic, -1) + 1
            if channel.topic == "/coop/paper/left/state" and i % 500 == 0:
                assert (message.sequence, message.log_time) == (i, UTC_0_NS + i * 5_000_000)
                for name in ("sequence", "utc_ns", "t", "q_measured", "theta_arm", "bus_retries"):
                    assert np.array_equal(getattr(decoded, name), rows[i][name]), name
            if channel.topic == "/left/joint_states" and i % 100 == 0:
                row = rows[message.sequence]
                assert list(decoded.name) == [*ARMS["left"], *LOCKED_RAD]
                assert np.array_equal(decoded.position, [*row["q_measured"][:3], *LOCKED_RAD.values()])
    assert count["/coop/paper/left/state"] == ROWS - 1
    expected = ROWS / 4  # 50 Hz of 200 Hz
    for topic in ("left/joint_states", "right/wrench", "object/pose", "object/pose_des"):
        assert count[f"/{topic}"] + 1 == expected, topic
    for topic in ("tf_static", "left/robot_description", "right/robot_description"):
        assert count[f"/{topic}"] == 0, "once"
    assert count["/tf"] + 1 == 3 * expected
    assert count["/rosout"] + 1 == len(run.events)


def test_rosbags_reads_it_with_nothing_but_what_is_in_the_file(run: RunLog) -> None:
    rows = make_rows("right", ROWS)
    with AnyReader([run.path]) as reader:
        found = [c for c in reader.connections if c.topic == "/coop/paper/right/state"]
        for i, (connection, time_ns, raw) in enumerate(reader.messages(found)):
            if i % 1000 == 0:
                message = reader.deserialize(raw, connection.msgtype)
                assert (time_ns, message.sequence) == (rows[i]["utc_ns"], i)
                assert np.array_equal(message.tau_sent, rows[i]["tau_sent"])
        assert i == ROWS - 1


@contextlib.contextmanager
def listening(endpoint: str, keys: str) -> Iterator[list[tuple[str, bytes, BatchHeader]]]:
    heard: list[tuple[str, bytes, BatchHeader]] = []

    def keep(sample: zenoh.Sample) -> None:
        heard.append((str(sample.key_expr), bytes(sample.payload), BatchHeader.unpack(bytes(sample.attachment))))

    with open_session(Network(connect=(endpoint,))) as opened:
        subscriber = opened.session.declare_subscriber(keys, keep)
        yield heard
        subscriber.undeclare()


def test_play_gives_the_recorded_bytes_back_under_a_prefix_of_its_own(run: RunLog) -> None:
    heard: list[tuple[str, bytes, BatchHeader]]
    with Process(play.run, PlayOptions(run.path, speed=4.0, start_s=1.0, stop_s=3.0, loop=True)) as player:
        with listening(player.ready(), "**") as heard:
            wait_for(lambda: sum(not payload and "state" in key for key, payload, _ in heard) >= 6)
        player.stop()
    assert all(key.startswith("replay/coop/paper/") for key, _, _ in heard)
    assert not [key for key, _, _ in heard if not key.endswith(("state", "event"))]
    key = "replay/coop/paper/left/state"
    whole = [source for source in sources(heard, key) if is_whole(heard, key, source)]
    assert whole, "no loop was heard from its begin to its end"
    played = b"".join(p for k, p, h in heard if k == key and h.source == whole[0])
    assert played == make_rows("left", ROWS)[200:601].tobytes()


def sources(heard: list[tuple[str, bytes, BatchHeader]], key: str) -> list[int]:
    return list(dict.fromkeys(h.source for k, _, h in heard if k == key))


def is_whole(heard: list[tuple[str, bytes, BatchHeader]], key: str, source: int) -> bool:
    parts = [(p, h) for k, p, h in heard if k == key and h.source == source]
    return parts[0][1].first == 0 and not parts[-1][0]


def test_play_keeps_the_pace_and_its_factor(run: RunLog) -> None:
    begin = time.monotonic()
    report = play.run(PlayOptions(run.path, speed=20.0, stop_s=10.0), stop=lambda: False)
    assert time.monotonic() - begin >= 10.0 / 20.0
    assert (report.rows, report.loops) == (3 * 2001, 1)


class At:
    """Orders by the number of the question; a class, because another process may play.

    once: a file, from which on the questions count.
    """

    def __init__(self, orders: dict[int, list[Order]], once: Path | None = None) -> None:
        self._orders, self._once, self._asked = orders, once, 0

    def __call__(self) -> list[Order]:
        if self._once is not None and not self._once.exists():
            return []
        self._asked += 1
        return self._orders.get(self._asked, [])


def test_play_can_be_paused(run: RunLog) -> None:
    seen: list[tuple[float, bool]] = []
    options = PlayOptions(
        run.path, speed=1e-3, stop_s=10.0,  # the end is far until it goes on
        orders=At({2: [Order.PAUSE], 12: [Order.PAUSE, *[Order.FASTER] * 20]}),
        show=lambda head: seen.append((head.at_s, head.paused)),
    )  # fmt: skip
    report = play.run(options, stop=lambda: False)
    assert (report.rows, report.loops) == (3 * 2001, 1)
    waits = [at_s for at_s, paused in seen if paused]
    assert len(waits) == 10
    assert len(set(waits)) == 1, "it stays where it is"


def test_a_step_plays_the_messages_of_one_instant(run: RunLog) -> None:
    orders = At({2: [Order.STEP], 3: [Order.STEP, Order.STEP], 5: [Order.QUIT]})
    seen: list[float] = []
    options = PlayOptions(run.path, speed=1e-3, orders=orders, show=lambda head: seen.append(head.at_s))
    report = play.run(options, stop=lambda: False)
    assert (report.rows, report.loops) == (3 * 4, 0), "the first row, and three more, of two arms and the plant"
    assert seen[-1] == pytest.approx(0.015)


def test_a_seek_goes_on_elsewhere_with_the_same_bytes_as_a_run_of_its_own(run: RunLog, tmp_path: Path) -> None:
    heard: list[tuple[str, bytes, BatchHeader]]
    key, ahead = "replay/coop/paper/left/state", [Order.AHEAD]
    with Process(
        play.run,
        PlayOptions(
            run.path,
            speed=0.05,  # so that it is hardly elsewhere before, however long the machine stalls
            stop_s=20.0,
            orders=At({3: ahead, 6: ahead, 9: ahead, 12: [Order.FASTER] * 9}, tmp_path / "heard"),
        ),
    ) as player:
        with listening(player.ready(), "**") as heard:
            wait_for(lambda: any(key == k for k, *_ in heard))
            (tmp_path / "heard").touch()
            wait_for(lambda: any(not payload and key == k for k, payload, _ in heard))
        player.result()
    *_, last = sources(heard, key)
    parts = [(p, h) for k, p, h in heard if k == key and h.source == last]
    played = b"".join(p for p, _ in parts)
    rows = make_rows("left", ROWS)
    first = parts[0][1].first
    assert first == pytest.approx(3000, abs=600), "fifteen seconds in, and what it had played before"
    assert played == rows[first:4001].tobytes()


@pytest.mark.parametrize(
    "wrong",
    [
        {"speed": 0.0},
        {"speed": math.inf},
        {"speed": math.nan},
        {"start_s": 99.0},
        {"start_s": math.inf},
        {"start_s": math.nan},
        {"stop_s": math.nan},
        {"start_s": 3.0, "stop_s": 2.0},
        {"start_s": -1.0},
        {"start_s": 3.0, "stop_s": 3.0, "loop": True},
    ],
)
def test_play_refuses_what_cannot_be_played(run: RunLog, wrong: dict[str, Any]) -> None:
    with pytest.raises(LogError, match="nothing to play"):
        play.run(PlayOptions(run.path, **wrong), stop=lambda: False)


@pytest.mark.parametrize(("speed", "stop_s"), [(1e6, math.inf), (1e308, 1e308)])
def test_play_to_no_end_is_to_that_of_the_log(run: RunLog, speed: float, stop_s: float) -> None:
    assert play.run(PlayOptions(run.path, speed=speed, stop_s=stop_s), stop=lambda: False).loops == 1


def test_info_is_answered_and_telemetry_opens_no_port(tmp_path: Path) -> None:
    with recorder(tmp_path / "run.mcap") as rec:
        endpoint = rec.ready()
        ring = tmp_path / "left.ring"
        with (
            writer(ring, "left", 100_000, 200.0) as agent,
            telemetry(ring, "left", endpoint, Pace.REAL_TIME, info={"fingerprint": "5f"}) as publisher,
        ):
            agent.ready()
            publisher.ready()
            with open_session(Network(connect=(endpoint,), role=Role.VIEWER)) as opened:
                answers: list[bytes] = []
                wait_for(lambda: any(b'"sequence"' in answer for answer in ask(opened.session, answers)))
            assert b'"fingerprint": "5f"' in answers[-1]
            assert listening_ports(publisher.process.pid) == set()
            assert len(listening_ports(rec.process.pid)) == 1
            publisher.stop()
            agent.signal(signal.SIGTERM)
        rec.stop()


def ask(session: zenoh.Session, answers: list[bytes]) -> list[bytes]:
    for reply in session.get("coop/paper/left/info", timeout=1.0):
        if reply.ok is not None:
            answers.append(bytes(reply.ok.payload))
    return answers


def listening_ports(pid: int) -> set[str]:
    """Local addresses on which a process accepts TCP or receives UDP."""
    inodes = set()
    for fd in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):
            inodes.add(str(fd.readlink()).removeprefix("socket:[").removesuffix("]"))
    ports = set()
    for name, states in (("tcp", {"0A"}), ("tcp6", {"0A"}), ("udp", {"07"}), ("udp6", {"07"})):
        for line in Path(f"/proc/{pid}/net/{name}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] in states and fields[9] in inodes:
                ports.add(fields[1])
    return ports
