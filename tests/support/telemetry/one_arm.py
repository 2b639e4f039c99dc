"""One arm on its way into a log, in real time: recorder, telemetry and a writer of its ring."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from agent.log.read import read_log
from agent.telemetry.link.publish import Pace
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.row.sample import AGENT_STATE
from tests.support.telemetry.telemetry_cell import ARMS, Process, make_rows, recorder, telemetry, writer

LEFT = {"left": ARMS["left"]}
RATE_HZ = 500.0


def wait_for(condition: Callable[[], bool], timeout_s: float = 60.0) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "did not happen in time"
        time.sleep(0.01)


def written(ring: Path) -> int:
    if not ring.exists():
        return 0
    with RingReader(ring, AGENT_STATE) as reader:
        return reader.written


def rows_in(path: Path) -> bytes:
    return read_log(path).agents["left"].tobytes()


def prefix(count: int, total: int) -> bytes:
    return make_rows("left", total)[:count].tobytes()


@contextlib.contextmanager
def one_arm(folder: Path, rows: int, **changes: Any) -> Iterator[tuple[Process, Process, Process, str]]:
    """Recorder, telemetry and a writer in real time."""
    ring = folder / "left.ring"
    with recorder(folder / "run.mcap", arms=LEFT, **changes) as rec:
        endpoint = rec.ready()
        with telemetry(ring, "left", endpoint, Pace.REAL_TIME) as tel, writer(ring, "left", rows, RATE_HZ) as agent:
            yield rec, tel, agent, endpoint
