"""Telemetry: what a row costs the control thread, the recorder and the reader; rows are those of a run of two arms."""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer

import configs
from agent.config.cell import load_cell
from agent.log.read import read_log
from agent.loop import initial_memory, step
from agent.modes import Mode
from agent.process.build import build_agent
from agent.telemetry.link.intake import Intake
from agent.telemetry.link.publication import Pace
from agent.telemetry.link.wire import BatchHeader
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.fill import AgentRow
from agent.telemetry.row.received import Rows
from agent.telemetry.row.sample import AGENT_STATE
from agent.telemetry.row.topics import Address, Kind
from drivers.interface import BusCounters, JointState
from tests.bench.common import Figure, median_us
from tests.support.telemetry.log_maker import LogMaker
from tests.support.telemetry.telemetry_cell import (
    ARMS,
    CELL,
    CONFIG_ID,
    make_rows,
    recorder,
    sent_by,
    telemetry,
    writer,
)

NAMES = ("ring_commit", "row_fill", "recorder_cpu_per_row", "log_100s", "read_100s", "recorder_rows_per_s")
TICKS = 20_000  # 100 s at 200 Hz
BATCH = 20
NEEDED_ROWS_PER_S = 2 * 200 * 25  # two arms at 200 Hz, 25 times real time
ZERO_WITHOUT_ADAPTATION = ("theta_arm", "theta_object", "tau_posture", "tau_adaptive", "memory")


def bench() -> dict[str, Figure]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        return (
            {"ring_commit": commit(folder), "row_fill": fill()}
            | log(folder)
            | {"recorder_rows_per_s": lockstep(folder)}
        )


def noisy_rows(arm: str, count: int) -> np.ndarray:
    """Three-joint rows of the non-adaptive law with noise in every number, so that compression has real work."""
    rows = make_rows(arm, count)
    random = np.random.default_rng(len(arm))
    for f in AGENT_STATE.fields:
        if f.ros_type == "float64" and f.length:
            used = 0 if f.name in ZERO_WITHOUT_ADAPTATION else 3 if f.length == 7 else f.length
            rows[f.name][:, :used] += 1e-4 * random.standard_normal((count, used))
            rows[f.name][:, used:] = 0.0
    return rows


def commit(folder: Path) -> Figure:
    with RingWriter(folder / "left.ring", AGENT_STATE, "left") as ring:
        return Figure(median_us(ring.commit, 5_000, 9), "us")


def fill() -> Figure:
    """The row of one tick of the paper's left arm; baseline: as many numbers through the views of a numpy record."""
    cell = load_cell(configs.CELLS_DIR / "paper.toml")
    arm = build_agent(cell, cell.arms[0])
    q = np.array(cell.arms[0].entry.q_near_rad)
    state, memory, bus = JointState(5_000_000, q, 0.1 * q, 0.0 * q), initial_memory(arm), BusCounters()
    outcome = step(arm, state, 0.005, Mode.TRACK, memory)
    message = np.zeros(1, AGENT_STATE.dtype)
    row, whole = AgentRow(message, arm.model.n, 0), message[0]
    views = [whole[f.name] for f in AGENT_STATE.fields if f.length]
    values = [view.copy() for view in views]

    def packed() -> None:
        row.fill(1, 0.005, 1, Mode.TRACK, state, memory, outcome, outcome.tau)
        row.fill_timing(0.0, 0.0, 0.0, 0.0, bus)

    def by_view() -> None:
        for view, value in zip(views, values, strict=True):
            view[:] = value

    rounds = [(median_us(packed, 2000, 1), median_us(by_view, 2000, 1)) for _ in range(9)]
    ours, plain = (statistics.median(each) for each in zip(*rounds, strict=True))
    return Figure(ours, "us", baseline=plain)


def log(folder: Path) -> dict[str, Figure]:
    """Everything behind the network: check, standard messages, compress, write; then read back."""
    rows = {arm: noisy_rows(arm, TICKS) for arm in ARMS}
    path = folder / "run.mcap"
    batches = [
        (Address(CELL, arm, Kind.STATE).key, some.tobytes(), BatchHeader(1, first, TICKS, 0).pack(sent_by(arm)))
        for first in range(0, TICKS, BATCH)
        for arm, all_rows in rows.items()
        for some in (all_rows[first : first + BATCH],)
    ]
    rounds = []
    for _ in range(3):  # in turn, so that a busy machine slows both alike
        path.unlink(missing_ok=True)
        rounds.append((record(path, batches), plain_record(folder / "plain.mcap", batches)))
    cpu_s, plain_cpu_s = (statistics.median(each) for each in zip(*rounds, strict=True))
    each_us = 1e6 / (len(ARMS) * TICKS)
    raw_MB = len(ARMS) * TICKS * AGENT_STATE.dtype.itemsize / 1e6
    read_s, plain_s = median_s(lambda: read_log(path)), median_s(lambda: plain_read(path))
    return {
        "recorder_cpu_per_row": Figure(cpu_s * each_us, "us", baseline=plain_cpu_s * each_us),
        "log_100s": Figure(path.stat().st_size / 1e6, "MB", baseline=raw_MB),
        "read_100s": Figure(read_s, "s", baseline=plain_s),
    }


Batch = tuple[str, bytes, bytes]


def record(path: Path, batches: list[Batch]) -> float:
    """CPU seconds of everything behind the network."""
    maker = LogMaker(path, has_plant=False)
    door = Intake(CELL, {arm: len(joints) for arm, joints in ARMS.items()}, has_plant=False, config_id=CONFIG_ID)
    begin = time.process_time()
    for batch in batches:
        for item in door.take(*batch):
            assert isinstance(item, Rows)
            maker.channels.write_rows(item)
    maker.finish()
    return time.process_time() - begin


def plain_record(path: Path, batches: list[Batch]) -> float:
    """The same rows into the MCAP library's own writer: nothing checked, no standard messages."""
    size = AGENT_STATE.dtype.itemsize
    with path.open("wb") as file:
        begin = time.process_time()
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("coop_msgs/msg/AgentState", "ros2msg", AGENT_STATE.definition.encode())
        channels = {key: writer.register_channel(key, "cdr", schema) for key in {key for key, _, _ in batches}}
        for key, data, _ in batches:
            rows, channel = np.frombuffer(data, AGENT_STATE.dtype), channels[key]
            times = zip(rows["sequence"].tolist(), rows["utc_ns"].tolist(), strict=True)
            for i, (sequence, utc_ns) in enumerate(times):
                writer.add_message(channel, utc_ns, data[i * size : (i + 1) * size], utc_ns, sequence)
        writer.finish()
        return time.process_time() - begin


def plain_read(path: Path) -> int:
    """The same bytes by the MCAP library's own reader, not even put into arrays."""
    with path.open("rb") as file:
        return sum(len(message.data) for _, _, message in make_reader(file).iter_messages())


def median_s(work: object) -> float:
    assert callable(work)
    times = []
    for _ in range(3):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return statistics.median(times)


def lockstep(folder: Path, count: int = 20_000) -> Figure:
    """Rows per second from two rings through Zenoh into a log that is complete."""
    with recorder(folder / "lockstep.mcap") as rec:
        endpoint = rec.ready()
        rings = {arm: folder / f"{arm}.lockstep" for arm in ARMS}
        publishers = [telemetry(ring, arm, endpoint, Pace.LOCKSTEP) for arm, ring in rings.items()]
        writers = [writer(ring, arm, count, None) for arm, ring in rings.items()]
        try:
            for process in writers:
                process.ready()
            begin = time.perf_counter()
            complete = all(p.result().complete for p in publishers)
            elapsed = time.perf_counter() - begin
        finally:
            for process in (*publishers, *writers):
                process.kill()
        if not (complete and rec.stop().complete):
            raise RuntimeError("a benchmark that loses rows measures nothing")
    return Figure(len(ARMS) * count / elapsed, "1/s", baseline=NEEDED_ROWS_PER_S)
