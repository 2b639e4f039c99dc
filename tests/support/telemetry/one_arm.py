"""One arm on its way into a log, in real time: recorder, telemetry and a writer of its ring."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from agent.log.read import LogError, read_log
from agent.telemetry.link.publication import Pace
from agent.telemetry.link.session import Network, Role, open_session
from agent.telemetry.link.status import StatusQuery
from agent.telemetry.link.wire import seal_of
from agent.telemetry.ring.reader import RingReader
from agent.telemetry.row.sample import AGENT_STATE
from agent.telemetry.row.topics import RECORDER, Address, Kind
from tests.support.ports import free_port
from tests.support.telemetry.telemetry_cell import ARMS, CELL, Process, make_rows, recorder, telemetry, writer

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


def recorded(path: Path) -> int:
    """Rows that a reader finds by now."""
    try:
        return len(read_log(path).agents["left"])
    except LogError:
        return 0


def somewhere() -> Network:
    """Where a recorder can listen again after another one has."""
    return Network(listen=f"tcp/127.0.0.1:{free_port()}")


def wait_for_the_end(endpoint: str) -> None:
    """Return when the recorder there says that it has the end of the left arm's run, and all before it."""
    key = Address(CELL, "left", Kind.STATE).key
    with open_session(Network(connect=(endpoint,), role=Role.VIEWER)) as opened:
        query = StatusQuery(opened.session, CELL, seal_of(CELL, "", RECORDER), 0.0)

        def told() -> bool:
            status = query.poll(time.monotonic())
            left = None if status is None else status.streams.get(key)
            return left is not None and left.ended and len(left.have) == 1

        wait_for(told)


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
