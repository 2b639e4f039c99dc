"""The recorder under load: four arms at 500 Hz without a gap on two cores, and memory that stays flat for hours."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from agent.log.parts import Limits
from agent.log.read import open_log
from agent.telemetry.link.publication import Pace, PublishReport
from agent.telemetry.link.record import RecordReport
from agent.telemetry.ring.texts import TextWriter
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.event import Event, Level
from agent.telemetry.row.sample import AGENT_STATE
from drivers.clock import MonotonicClock
from tests.soak.watch import Series, grown, say
from tests.support.telemetry.telemetry_cell import SERVOS, TIMEOUT_S, UTC_0_NS, Process, make_rows, recording

ARMS = dict.fromkeys(("first", "second", "third", "fourth"), ("waist", "shoulder", "elbow"))
RATE_HZ = 500
CORES = 2
PERIOD_NS = 1_000_000_000 // RATE_HZ
SOME_ROWS = 1000  # are written again and again, under new numbers and times
LOG_BYTES = 64 << 20  # the index of a log grows until it ends: a MB at this size
FOLDER_BYTES = 512 << 20
EVENT_EVERY_S = 60
LOOK_EVERY_S = 0.25


@dataclass(frozen=True)
class Load:
    """What one arm writes."""

    ring: Path
    member: str
    rows: int
    real_time: bool  # at RATE_HZ, and otherwise as fast as the recorder takes them


def write_arm(load: Load, stop: Callable[[], bool], ready: Callable[[Any], None]) -> tuple[int, float]:
    """Rows as an agent writes them, health a second, an event a minute; how many, and the worst delay of one, s."""
    some, clock, late_ns = make_rows(load.member, SOME_ROWS), MonotonicClock(), 0
    some["mode"] = some["mode"][-1]  # a change is an event: two every thousand rows would be 29 000 in two hours
    texts = TextWriter(load.ring, load.member)
    with RingWriter(load.ring, AGENT_STATE, load.member, ARMS[load.member]) as ring:
        ready(os.getpid())
        begin_ns = clock.now_ns()
        for i in range(load.rows):
            if stop():
                break
            row, stamp_ns = ring.row, i * PERIOD_NS
            row[()] = some[i % SOME_ROWS]
            row["sequence"], row["stamp_ns"], row["utc_ns"], row["t"] = (
                i,
                stamp_ns,
                UTC_0_NS + stamp_ns,
                stamp_ns * 1e-9,
            )
            if load.real_time:
                clock.sleep_until(begin_ns + stamp_ns)
                late_ns = max(late_ns, clock.now_ns() - begin_ns - stamp_ns)
            else:
                ring.wait_for_space(TIMEOUT_S)
            ring.commit()
            if i % RATE_HZ == 0:
                texts.health(UTC_0_NS + stamp_ns, SERVOS)
            if i % (EVENT_EVERY_S * RATE_HZ) == 0:
                texts.event(Event(UTC_0_NS + stamp_ns, load.member, Level.INFO, f"second {i // RATE_HZ}"))
        ring.finish()
        texts.finish()
        texts.close()
        return ring.written, late_ns * 1e-9


@dataclass(frozen=True)
class Outcome:
    """What became of a load."""

    report: RecordReport
    published: dict[str, PublishReport]
    worst_late_s: float  # of a row at its writer
    took_s: float
    cpu_s: dict[str, float]  # by process, as far as it was looked at
    processes: dict[str, Series]


def loaded(folder: Path, seconds: float, *, real_time: bool, limits: Limits) -> Outcome:
    """Four arms for so many seconds of their time, each with its telemetry, and one recorder."""
    pace, rows = Pace.REAL_TIME if real_time else Pace.LOCKSTEP, round(seconds * RATE_HZ)
    cores, begin_s = os.sched_getaffinity(0), time.monotonic()
    os.sched_setaffinity(0, set(sorted(cores)[:CORES]))  # children have the same
    try:
        with ExitStack() as stack:
            cell = recording(stack, folder, pace, ARMS, limits=limits)
            kept, told = cell.recorder, cell.told
            loads = [Load(ring, arm, rows, real_time) for arm, ring in cell.rings.items()]
            writers = [stack.enter_context(Process(write_arm, load)) for load in loads]
            watched = {"recorder": kept} | {f"telemetry {arm}": process for arm, process in told.items()}
            series, cpu_s = _watch({name: each.process.pid or 0 for name, each in watched.items()}, list(told.values()))
            written = [each.result() for each in writers]
            published = {arm: process.result() for arm, process in told.items()}
            return Outcome(
                kept.stop(), published, max(late_s for _, late_s in written), time.monotonic() - begin_s, cpu_s, series
            )
    finally:
        os.sched_setaffinity(0, cores)


def _watch(pids: dict[str, int], until: list[Process]) -> tuple[dict[str, Series], dict[str, float]]:
    """Samples of processes until all telemetry has ended."""
    looked = {name: psutil.Process(pid) for name, pid in pids.items()}
    series, cpu_s = {name: Series() for name in looked}, dict.fromkeys(looked, 0.0)
    while any(each.process.is_alive() and not each._result.poll() for each in until):
        for name, process in looked.items():
            try:
                series[name].look(process)
                cpu_s[name] = sum(process.cpu_times()[:2])
            except psutil.Error:  # it has just ended
                continue
        time.sleep(LOOK_EVERY_S)
    return series, cpu_s


def complete(folder: Path, seconds: float) -> list[str]:
    """Four arms at 500 Hz in real time on two cores: every row is in the log."""
    outcome = loaded(folder, seconds, real_time=True, limits=Limits())
    rows = round(seconds * RATE_HZ)
    complaints = [f"{arm}: {p.rows_lost} rows lost in the ring" for arm, p in outcome.published.items() if p.rows_lost]
    with open_log(outcome.report.path) as log:
        for arm in ARMS:
            sequence = log.agents[arm]["sequence"]
            if not np.array_equal(sequence, np.arange(rows)) or log.gaps[arm]:
                complaints.append(f"{arm}: {len(sequence)} rows of {rows}, {len(log.gaps[arm])} gaps")
            if len(log.servos[arm]) != -(-rows // RATE_HZ):
                complaints.append(f"{arm}: {len(log.servos[arm])} health texts of {-(-rows // RATE_HZ)}")
        if not (log.complete and outcome.report.complete):
            complaints.append(f"not complete: {outcome.report.completeness}")
    say(
        f"{len(ARMS)} arms x {RATE_HZ} Hz x {seconds:g} s on {CORES} cores in {outcome.took_s:.0f} s; "
        f"CPU {_shares(outcome, seconds)}; a row came up to {1e3 * outcome.worst_late_s:.0f} ms late to its ring"
    )
    return complaints


def flat(folder: Path, seconds: float) -> list[str]:
    """Hours of four arms as fast as the recorder takes them, logs split and old ones removed: memory stays flat."""
    limits = Limits(part_bytes=LOG_BYTES, folder_bytes=FOLDER_BYTES)
    outcome = loaded(folder, seconds, real_time=False, limits=limits)
    rows = len(ARMS) * round(seconds * RATE_HZ)
    say(
        f"{seconds / 3600:.2f} h of {len(ARMS)} arms in {outcome.took_s:.0f} s: {rows / outcome.took_s:.0f} rows/s, "
        f"{len(outcome.report.logs)} logs"
    )
    complaints = [] if outcome.report.complete else [f"not complete: {outcome.report.completeness}"]
    return complaints + grown(outcome.processes)


def _shares(outcome: Outcome, seconds: float) -> str:
    return ", ".join(f"{name} {cpu_s / seconds:.0%} of a core" for name, cpu_s in outcome.cpu_s.items())
