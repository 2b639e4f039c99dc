"""A page beside a run: how far behind the rows its pictures are, in the browser, and what serving it costs.

Two arms at 200 Hz in real time, without a law, through telemetry and a recorder.  Their object goes along a line at a
steady speed and stops: where a frame has it tells how old the row of the frame was.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agent.telemetry.link.publication import Pace
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.sample import AGENT_STATE
from drivers.clock import MonotonicClock
from tests.bench.browser import DRAWS, first, served
from tests.bench.common import Figure
from tests.support.coop import COOP
from tests.support.drawn import Frame, drawn
from tests.support.telemetry.telemetry_cell import ARMS, Process, make_rows, recording

NAMES = ("live_behind", "live_behind_99", "live_cpu")
BEHIND_MS, CPU_PERCENT = 150.0, 15.0  # what must hold
RATE_HZ, RUN_S, WATCHED_S = 200, 30.0, 12.0
SPEED_M_PER_S = 0.01
PERIOD_NS = 1_000_000_000 // RATE_HZ


@dataclass(frozen=True)
class Load:
    """What one arm writes."""

    ring: Path
    member: str


def write(load: Load, stop: Callable[[], bool], ready: Callable[[Any], None]) -> int:
    """Rows with the wall's time; the time of the last one, ns since 1970."""
    row, clock, utc_ns = make_rows(load.member, 1)[0], MonotonicClock(), 0
    for name in ("wrench_cmd", "wrench_internal"):
        row[name] = 0.0  # an arrow that comes and goes would move the others in the list of what is drawn
    for name in ("quat_object", "quat_object_des"):
        row[name] = [1.0, 0.0, 0.0, 0.0]
    row["q"], row["p_object_des"] = 0.0, [0.0, 0.3, 0.0]
    with RingWriter(load.ring, AGENT_STATE, load.member, ARMS[load.member]) as ring:
        ready(os.getpid())
        begin_ns = clock.now_ns()
        for i in range(round(RUN_S * RATE_HZ)):
            clock.sleep_until(begin_ns + i * PERIOD_NS)
            if stop():
                break
            utc_ns, t = time.time_ns(), i / RATE_HZ
            row["sequence"], row["t"], row["stamp_ns"], row["utc_ns"] = i, t, i * PERIOD_NS, utc_ns
            row["p_object"] = [SPEED_M_PER_S * t, 0.3, 0.0]
            ring.row[()] = row
            ring.commit()
        ring.finish()
    return utc_ns


def bench() -> dict[str, Figure]:
    with tempfile.TemporaryDirectory(dir="/var/tmp") as name, ExitStack() as stack:
        folder = Path(name)
        cell = recording(stack, folder, Pace.REAL_TIME)
        view = [*COOP, "view", "paper", "--live", "--connect", cell.endpoint, "--no-browser", "--port"]
        browser = stack.enter_context(drawn(folder / "browser"))
        page = stack.enter_context(served(view))
        browser.page.open(page.address)
        first(browser, DRAWS)
        writers = [stack.enter_context(Process(write, Load(ring, arm))) for arm, ring in cell.rings.items()]
        time.sleep(RUN_S - WATCHED_S)
        cpu_s, begin, _ = page.cpu_s(), time.monotonic(), browser.frames()
        time.sleep(WATCHED_S - 2.0)
        percent = 100.0 * (page.cpu_s() - cpu_s) / (time.monotonic() - begin)
        last_ms = 1e-6 * next(process.result() for process in writers)  # the object is where the first arm believes it
        time.sleep(2.0)
        behind_ms = lags_ms(browser.frames(), last_ms)
    half, most = np.percentile(behind_ms, [50.0, 99.0])
    return {
        "live_behind": Figure(float(half), "ms", BEHIND_MS),
        "live_behind_99": Figure(float(most), "ms", BEHIND_MS),
        "live_cpu": Figure(percent, "%", CPU_PERCENT),
    }


def lags_ms(frames: list[Frame], last_ms: float) -> np.ndarray:
    """How old the row was that each frame showed, of those before the object stood still, ms.

    A frame tells what has moved: the last that tells as much as the others has the last row.
    """
    moving = Counter(len(frame.places) for frame in frames).most_common(1)[0][0]
    alike = [frame for frame in frames if len(frame.places) == moving]
    places = np.stack([frame.places for frame in alike])
    way = np.linalg.norm(places - places[-1], axis=2)
    way = way[:, int(np.argmax(way[0]))]
    row_ms = last_ms - 1e3 * way / SPEED_M_PER_S
    utc_ms = np.array([frame.utc_ms for frame in alike])
    return np.asarray((utc_ms - row_ms)[way > 0.0])
