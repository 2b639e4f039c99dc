"""Cycles that a loop left out have no row: the time between its rows tells how many, and a report says so."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from agent.report.metrics import summarise
from agent.report.pace import Pace
from agent.report.tables import lines, tables
from agent.safety import Flag
from tests.support.telemetry.small_run import RATE_HZ, TICKS, keep, small_run

PERIOD_NS = round(1e9 / RATE_HZ)


def left_out(log: Any, arm: str, ran: Any) -> Any:
    """The log of a run in which the arm ran only these cycles, and numbered them through."""
    keep(log, arm, ran)
    log.agents[arm]["sequence"] = np.arange(len(log.agents[arm]))
    return log


def pace(log: Any, arm: str = "left") -> tuple[int, int]:
    found = summarise(log).arms[arm].pace
    return found.due_cycles, found.left_out_cycles


def test_a_loop_that_ran_every_cycle_has_left_out_none() -> None:
    results = summarise(small_run())
    assert [(a.pace.due_cycles, a.pace.left_out_cycles) for a in results.arms.values()] == [(TICKS, 0)] * 2
    assert next(line.figure for line in lines(results) if line.what == "cycles left out") == "none"
    assert not [text for text in results.missing if "rate" in text]


def test_cycles_that_were_left_out_are_told_with_the_arm_and_in_the_table_of_its_rows() -> None:
    results = summarise(left_out(small_run(), "left", np.arange(0, TICKS, 2)))
    (told,) = [text for text in results.missing if "rate" in text]
    assert told.startswith("the loop of left ran 200 of the 399 cycles that were due: the run was not at its rate; ")
    assert told.endswith("a real arm holds below 90 %")
    assert next(line.figure for line in lines(results) if line.what == "cycles left out") == "199 of 399 (left)"
    rows = next(table for table in tables(results) if table.title == "Rows and cycles")
    at = rows.header.index("left out of those due")
    assert [row[at] for row in rows.rows] == ["199 of 399", "0 of 400"]
    assert results.flat()["arms.left.pace.left_out_cycles"].value == 199.0
    assert results.to_json()["arms"]["left"]["pace"] == {"due_cycles": 399, "left_out_cycles": 199}


@pytest.mark.parametrize(("count", "kept"), [(40, True), (41, False)])
def test_a_tenth_may_be_left_out_without_a_word(count: int, kept: bool) -> None:
    ran = np.delete(np.arange(TICKS), np.arange(100, 100 + count))
    results = summarise(left_out(small_run(), "right", ran))
    assert results.arms["right"].pace.left_out_cycles == count
    assert any("the loop of right" in text for text in results.missing) is not kept


def test_rows_that_the_log_lost_were_cycles_that_ran() -> None:
    assert pace(keep(small_run(), "left", np.arange(0, TICKS, 3))) == (TICKS, 0)


def test_a_cycle_that_began_late_at_an_end_of_the_motion_has_left_out_none() -> None:
    log = small_run()
    rows = log.agents["left"]
    rows["stamp_ns"][-1] += round(0.8 * PERIOD_NS)
    rows["late_s"][-1] = 0.8 / RATE_HZ
    assert pace(log) == (TICKS, 0)


def test_a_row_without_a_state_is_stamped_with_its_deadline_however_late_it_was() -> None:
    log = small_run()
    rows = log.agents["left"]
    rows["flags"][0], rows["late_s"][0] = Flag.STALE, 0.8 / RATE_HZ
    assert pace(log) == (TICKS, 0)


def test_the_wait_for_a_start_is_no_part_of_the_motion() -> None:
    log = left_out(small_run(), "left", np.delete(np.arange(TICKS), np.arange(20, 60)))
    log.agents["left"]["t"] -= 100 / RATE_HZ
    assert pace(log) == (TICKS - 100, 0)


def test_an_arm_without_a_row_of_the_motion_was_due_no_cycle() -> None:
    log = small_run()
    log.agents["left"]["t"] -= 86_400.0
    assert pace(log) == (0, 0)
    assert Pace(0, 0).kept
