"""Whatever a run met, its rows from any one on are those that `step` gives from that one, bit for bit."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.config.cell import Cell, load_cell
from agent.log.read import open_log
from agent.modes import Event
from agent.replay.rows import Window
from agent.replay.source import recorded_cell
from agent.replay.verify import verify
from drivers.interface import Vector
from tests.support.runner_rig import lost_at, q_start, run
from tests.support.study import PAPER
from tests.support.telemetry.run_log import write_run

ROWS = 60
LAWS = ((), ('controller.kind="adaptive"',), ('controller.velocity="servo"',), ("controller.alignment.max_m=0.02",))


@cache
def cell_of(law: tuple[str, ...]) -> Cell:
    return load_cell(PAPER, law)


@st.composite
def told(draw: st.DrawFn) -> dict[str, Any]:
    """What a run meets: joints that move anyhow, cycles without a state, writes that fail, late cycles, a stop."""
    reads = st.integers(4, ROWS)
    seed, size = draw(st.integers(0, 2**31)), draw(st.floats(0.0, 0.02))
    noise = np.random.default_rng(seed).uniform(-size, size, (4 * ROWS, 3)).cumsum(axis=0) * 0.3
    silent = draw(st.sets(reads, max_size=6).filter(lambda s: all(b - a > 1 for a, b in pairwise(sorted(s)))))
    stop = draw(reads)

    def q(read: int) -> Vector:
        pose: Vector = q_start() + noise[min(read, len(noise) - 1)]
        return pose

    def operator(read: int) -> Event:
        return {stop: Event.STOP, ROWS + 10: Event.RELEASED}.get(read, Event.NONE)

    return {
        "operator": operator,
        "failures": lost_at(*silent),
        "q": q,
        "refused": frozenset(draw(st.sets(reads, max_size=2))),
        "oversleeps_ns": draw(st.dictionaries(reads, st.integers(0, 300_000_000), max_size=2)),
    }


@given(st.sampled_from(LAWS), told(), st.integers(0, ROWS - 1))
@settings(max_examples=25)
def test_the_rows_of_any_run_from_any_row_on_are_computed_again_bit_for_bit(
    law: tuple[str, ...], met: dict[str, Any], begin: int
) -> None:
    cell = cell_of(law)
    rows = run(cell=cell, ticks=ROWS, hold_at_end=True, **met).rows[:ROWS]
    with TemporaryDirectory() as folder:
        path = write_run(Path(folder) / "run.mcap", cell, {cell.arms[0].name: rows})
        with open_log(path) as log:
            found = verify(log, recorded_cell(log), Window(from_row=begin))
    assert (found.rows, found.first, found.equal) == (len(rows) - begin, None, True)
