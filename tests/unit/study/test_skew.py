"""What clocks that differ do to a cell: little, for arms give way to each other, until they differ by too much."""

from __future__ import annotations

from pathlib import Path

import pytest

from agent.config.cell import load_cell
from agent.config.reality import reality_of
from agent.study.lab import Laboratory
from agent.study.measure import RunResult, measure


def ahead(ms: float, duration_s: float = 3.5) -> RunResult:
    """A short run of a cell whose right arm is ahead by so much."""
    settings = [
        f"duration_s={duration_s}",
        "report.transient_s=2.0",
        "simulation.ready_s=1.0",
        f"simulation.reality.arms.right.skew_s={ms * 1e-3}",
    ]
    cell = load_cell(Path("two_wx200"), settings)
    return measure(Laboratory(cell), reality_of(cell))


@pytest.mark.fault("C2")
def test_clocks_that_differ_cost_force_in_proportion_and_a_hold_where_that_is_too_much() -> None:
    slight, much, far = ahead(5.0), ahead(100.0), ahead(500.0, duration_s=2.1)
    assert [run.tripped for run in (slight, much, far)] == [False, False, True]
    assert slight.internal_force_mean_N < 0.25
    more_N = much.internal_force_mean_N - slight.internal_force_mean_N
    assert 0.3 < more_N < 1.0, "as 2 mm between the arms, most of which the alignment takes up"
    assert much.position_error_m < 1e-3
    assert "UNEXPECTED" in far.why
