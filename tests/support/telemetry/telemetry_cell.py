"""A cell without arms for telemetry tests: real processes, rings, sockets and files, and no control law."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Self

import numpy as np

from agent.log.file import Attachment
from agent.telemetry.link import publish, record
from agent.telemetry.link.endpoint import FREE_PORT
from agent.telemetry.link.publication import Pace, PublishOptions
from agent.telemetry.link.record import RecordOptions
from agent.telemetry.link.session import Network
from agent.telemetry.link.wire import Sent, seal_of
from agent.telemetry.ring.texts import TextWriter
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.event import Event, Level
from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE, Layout
from agent.telemetry.row.topics import PLANT
from drivers.interface import Refusal
from tests.support.forked import FORKED
from tests.support.telemetry.scenes import scene

CELL = "paper"
CONFIG_ID = 0xC0FFEE
ARMS = {"left": ("waist", "shoulder", "elbow"), "right": ("waist", "shoulder", "elbow")}
UTC_0_NS = 1_800_000_000_000_000_000
PERIOD_NS = 5_000_000
TIMEOUT_S = 60.0
AT_ONCE = 1000  # rows that a writer makes
SERVOS = {
    "servo_id": [1, 2, 3], "joint": ["waist", "shoulder", "shoulder"], "temperature_C": [30.0, 31.0, float("nan")],
    "voltage_V": [12.1, 12.0, 11.9], "error_bits": [0, 32, 0], "current_A": [0.25, -1.5, float("nan")],
    "load": [float("nan"), float("nan"), 0.125],
}  # fmt: skip


def layout_of(member: str) -> Layout:
    return PLANT_STATE if member == PLANT else AGENT_STATE


def sent_by(member: str, run: int = 0) -> Sent:
    """As telemetry of the member signs what it publishes."""
    return Sent(seal_of(CELL, "", member, layout_of(member)), run)


@cache
def _same_rows(member: str, count: int) -> np.ndarray:
    rows = _new_rows(member, range(count))
    rows.flags.writeable = False
    return rows


def make_rows(member: str, count: int) -> np.ndarray:
    """Rows whose every number follows from member and sequence, so that both ends can be compared."""
    return _same_rows(member, count).copy()


def _new_rows(member: str, numbers: range) -> np.ndarray:
    layout, count = layout_of(member), len(numbers)
    rows = np.zeros(count, layout.dtype)
    sequence = np.arange(numbers.start, numbers.stop)
    for k, f in enumerate(layout.fields):
        if f.ros_type == "float64":
            shape = (count,) + (1,) * (rows[f.name].ndim - 1)
            rows[f.name] = np.sin(0.01 * (k + 1) * sequence.reshape(shape) + len(member))
    rows["encapsulation"] = 0x100
    rows["sequence"] = sequence
    rows["t"] = sequence * PERIOD_NS * 1e-9
    rows["stamp_ns"] = sequence * PERIOD_NS
    rows["utc_ns"] = UTC_0_NS + rows["stamp_ns"]
    rows["config_id"] = CONFIG_ID
    if member == PLANT:
        rows["arm_count"] = len(ARMS)
    else:
        rows["joint_count"] = 3
        rows["mode"] = np.where(sequence < 10, 1, 2)
        rows["flags"] = 0
    return rows


@dataclass(frozen=True)
class Writer:
    """A process that writes a ring as an agent or the plant would."""

    ring: Path
    member: str
    rows: int
    rate_hz: float | None  # None: lockstep, as fast as the reader
    slots: int = 8192
    texts: bool = False
    start_sequence: int = 0


def write_ring(options: Writer, stop: Callable[[], bool], ready: Callable[[Any], None]) -> int:
    texts = TextWriter(options.ring, options.member) if options.texts else None
    with RingWriter(
        options.ring, layout_of(options.member), options.member, ARMS.get(options.member, ()), slots=options.slots
    ) as ring:
        ready(os.getpid())
        begin = time.monotonic()
        for i in range(options.rows):
            if stop():
                break
            if i % AT_ONCE == 0:  # a run without end would take half a GB
                rows = _new_rows(options.member, range(i, min(i + AT_ONCE, options.rows)))
                rows["sequence"] += options.start_sequence
            row = rows[i % AT_ONCE]
            ring.row[()] = row
            if options.rate_hz is None:
                ring.wait_for_space(TIMEOUT_S)
            ring.commit()
            if texts is not None and i % 100 == 0:
                texts.event(Event(int(row["utc_ns"]), options.member, Level.INFO, f"row {i}", {"i": i}))
                texts.health(int(row["utc_ns"]), SERVOS)
            if options.rate_hz is not None:
                time.sleep(max(0.0, begin + (i + 1) / options.rate_hz - time.monotonic()))
        ring.finish()
        if texts is not None:
            texts.finish()
            texts.close()
        return ring.written


class Process:
    """A child that runs `function(options, stop, ready)`, ends on SIGTERM, and hands back what the function returns."""

    def __init__(self, function: Callable[..., Any], options: Any) -> None:
        self._ready, ready = FORKED.Pipe(duplex=False)
        self._result, result = FORKED.Pipe(duplex=False)
        self.process = FORKED.Process(target=_child, args=(function, options, ready, result))
        self.process.start()
        ready.close()
        result.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()
        self._ready.close()
        self._result.close()

    def ready(self) -> Any:
        assert self._ready.poll(TIMEOUT_S), "not ready in time"
        return self._ready.recv()

    def signal(self, number: signal.Signals) -> None:
        os.kill(self.process.pid, number)

    def stop(self) -> Any:
        self.signal(signal.SIGTERM)
        return self.result()

    def result(self) -> Any:
        assert self._result.poll(TIMEOUT_S), "no end in time"
        try:
            outcome = self._result.recv()
        except EOFError:
            self.process.join(TIMEOUT_S)
            raise AssertionError(f"ended without a result, exit code {self.process.exitcode}") from None
        self.process.join(TIMEOUT_S)
        if isinstance(outcome, BaseException):
            raise outcome
        return outcome

    def kill(self) -> None:
        self.process.kill()
        self.process.join()


def _child(function: Callable[..., Any], options: Any, ready: Any, result: Any) -> None:
    stopped = []
    signal.signal(signal.SIGTERM, lambda *_: stopped.append(True))
    try:
        outcome = function(options, lambda: bool(stopped), ready.send)
    except Refusal as error:
        outcome = RuntimeError(f"{type(error).__name__}: {error}")
    result.send(outcome)
    result.close()


def recorder(path: Path, arms: Mapping[str, tuple[str, ...]] = ARMS, **changes: Any) -> Process:
    options = {
        "config_id": CONFIG_ID,
        "min_free_bytes": 1 << 20,
        "network": Network(listen=FREE_PORT),
        "attachments": (Attachment("run.json", "application/json", b'{"cell": "paper"}'),),
    } | changes
    return Process(record.run, RecordOptions(path, scene(CELL, arms), **options))


def telemetry(ring: Path, member: str, endpoint: str, pace: Pace, **changes: Any) -> Process:
    options = {"network": Network(connect=(endpoint,)), "layout": layout_of(member), "pace": pace} | changes
    return Process(publish.run, PublishOptions(CELL, member, ring, **options))


@dataclass(frozen=True)
class Recording:
    """A recorder, and telemetry of every member that waits for its ring to be written."""

    recorder: Process
    endpoint: str
    rings: dict[str, Path]
    told: dict[str, Process]


def recording(
    stack: ExitStack, folder: Path, pace: Pace, arms: Mapping[str, tuple[str, ...]] = ARMS, **changes: Any
) -> Recording:
    """Started and ready; they end with the stack."""
    kept = stack.enter_context(recorder(folder / "run.mcap", arms, **changes))
    endpoint = kept.ready()
    members = (*arms, PLANT) if changes.get("has_plant") else tuple(arms)
    rings = {member: folder / f"{member}.ring" for member in members}
    told = {member: stack.enter_context(telemetry(ring, member, endpoint, pace)) for member, ring in rings.items()}
    for process in told.values():
        process.ready()
    return Recording(kept, endpoint, rings, told)


def writer(ring: Path, member: str, rows: int, rate_hz: float | None, **changes: Any) -> Process:
    return Process(write_ring, Writer(ring, member, rows, rate_hz, **changes))
