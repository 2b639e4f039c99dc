"""What a strict run is told of bounds of its cell that were not shown to be kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from agent.report.bounds import BoundsMissed, require_bounds
from agent.report.metrics import summarise
from tests.support.telemetry.synthetic_run import paper_run


def test_a_run_that_ends_in_the_transient_has_shown_no_bound() -> None:
    log = paper_run(Path("run.mcap"), duration_s=25.0)
    assert log.plant is not None
    require_bounds(summarise(log))
    cut = replace(log, agents={name: rows[:1000] for name, rows in log.agents.items()}, plant=log.plant[:1000])
    with pytest.raises(BoundsMissed, match=r"found max_position_error_m not measured.*let it run longer") as caught:
        require_bounds(summarise(cut))
    assert caught.value.exit_code == 6
    assert "\n" not in str(caught.value)
