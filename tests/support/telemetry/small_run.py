"""A log of two arms for two seconds, without an error, for tests that change some of its rows."""

from __future__ import annotations

from pathlib import Path

from agent.log.read import RunLog
from tests.support.telemetry.synthetic_run import (
    OFFSETS,
    agent_rows,
    as_log,
    plant_rows,
    run_file,
)

TICKS, RATE_HZ = 400, 200.0


def small_run(*, plant: bool = True, transient_s: float = 0.5, **changes: object) -> RunLog:
    """Two arms, two seconds, no error at all."""
    content = run_file(TICKS / RATE_HZ, RATE_HZ, transient_s=transient_s, **changes)
    agents = {name: agent_rows(TICKS, RATE_HZ) for name in OFFSETS}
    rows = plant_rows(agents["left"]) if plant else None
    return as_log(Path("run.mcap"), agents, rows, content)


def keep(log: RunLog, arm: str, rows: object) -> RunLog:
    log.agents[arm] = log.agents[arm][rows]
    return log
