"""What a strict run is told of bounds of its cell that were not shown to be kept."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from agent.report.bounds import BoundsMissed, require_bounds
from agent.report.metrics import summarise
from tests.support.telemetry.small_run import small_run
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


def test_a_run_that_lost_its_object_is_not_within_bounds_of_a_cell_that_states_none() -> None:
    log = small_run(bounds={})
    require_bounds(summarise(log))
    log.plant["p_object"][300:, 2] -= 0.5
    results = summarise(log)
    assert not results.within_bounds
    with pytest.raises(
        BoundsMissed, match=r"object lost from 1\.500 s.*expected the object held by all arms"
    ) as caught:
        require_bounds(results)
    assert "\n" not in str(caught.value)


def test_a_run_in_which_a_grasp_opened_is_not_within_bounds_though_its_object_is_held() -> None:
    log = small_run()
    log.plant["contact_error_m"][300:, 0] = math.nan
    results = summarise(log)
    assert not results.within_bounds
    with pytest.raises(BoundsMissed, match=r"found grasp open left from 1\.500 s, expected the object held") as caught:
        require_bounds(results)
    assert "let it run longer" not in str(caught.value)


def test_a_run_that_nobody_saw_the_truth_of_is_judged_by_its_bounds_alone() -> None:
    assert summarise(small_run(plant=False, bounds={})).within_bounds
