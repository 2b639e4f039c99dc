"""Rows of a plant are counted from the zero that the arms' rows have, whatever the plant's own is."""

from __future__ import annotations

import numpy as np
import pytest

from agent.log.columns import Table
from agent.log.when import by_one_clock, in_lockstep, on_time_of
from tests.support.telemetry.synthetic_run import agent_rows, plant_rows

TICKS, RATE_HZ, READY_S = 400, 20.0, 1.0
NOT_YET_S = -86_400.0


def rows() -> tuple[np.ndarray, np.ndarray]:
    """An arm that waits READY_S for the start, and its plant, which counts from where it began."""
    arm = agent_rows(TICKS, RATE_HZ)
    plant = plant_rows(arm)
    arm["t"] = (arm["stamp_ns"] - round(READY_S * 1e9)) * 1e-9
    return arm, plant


def counted(plant: np.ndarray, *arms: np.ndarray) -> np.ndarray:
    return on_time_of(Table.of(plant), map(Table.of, arms))["t"]


def test_rows_of_one_stamp_have_the_very_same_time() -> None:
    arm, plant = rows()
    assert counted(plant, arm).tobytes() == arm["t"].tobytes()
    assert plant["t"][0] == 0.0, "the rows in the file stay as they are"


def test_a_plant_runs_before_the_first_row_of_an_arm_and_after_the_last() -> None:
    arm, plant = rows()
    assert counted(plant, arm[:0], arm[150:160]) == pytest.approx(arm["t"], abs=1e-9)


def test_the_zero_is_that_of_its_own_moment() -> None:
    """An arm that nobody has started counts towards a day ahead, until somebody does."""
    arm, plant = rows()
    arm["t"][:100] += NOT_YET_S
    assert counted(plant, arm) == pytest.approx(arm["t"], abs=1e-9)


def test_stamps_of_another_clock_are_matched_by_utc() -> None:
    arm, plant = rows()
    utc_ns = arm["utc_ns"][0] + arm["stamp_ns"]
    arm["utc_ns"], plant["utc_ns"] = utc_ns, utc_ns
    for away_ns in (7 * 10**9, 10**14):  # stamps that seem to be of one time, and stamps that do not
        arm["stamp_ns"] = plant["stamp_ns"] + away_ns
        plant["utc_ns"] = utc_ns
        arm["utc_ns"] = utc_ns
        assert counted(plant, arm) == pytest.approx(arm["t"], abs=1e-9)


def test_stamps_count_where_the_two_were_there_together_and_utc_does_not() -> None:
    arm, plant = rows()
    plant["utc_ns"] += 10**13
    assert counted(plant, arm) == pytest.approx(arm["t"], abs=1e-9)


def test_a_time_that_nobody_can_tell_is_none() -> None:
    arm, plant = rows()
    plant["utc_ns"] += 10**13
    plant["stamp_ns"] += 10**14
    assert np.isnan(counted(plant, arm)).all()
    assert np.isnan(counted(plant)).all()


def in_step(skew_ns: int, *, whole_second: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """The same in lockstep, where the arm's clock is ahead of the plant's by what a reality says."""
    arm, plant = rows()
    arm["stamp_ns"] += skew_ns
    arm["t"] += skew_ns * 1e-9
    for one in (arm, plant):
        one["utc_ns"] = one["stamp_ns"] + 5_000_000_000 + (not whole_second)
    return arm, plant


@pytest.mark.parametrize("skew_ns", [0, 2_400_000, 3_537_705, -60_000_000])
def test_in_lockstep_a_tick_has_the_time_of_the_first_arm_however_its_clock_is_ahead(skew_ns: int) -> None:
    arm, plant = in_step(skew_ns)
    assert in_lockstep([Table.of(arm), Table.of(plant)])
    every_fourth = plant[::4]
    assert counted(every_fourth, arm[3:-7]) == pytest.approx(arm["t"][::4], abs=1e-9)


def test_arms_in_lockstep_are_brought_to_one_clock_by_their_ticks_and_others_are_left_alone() -> None:
    (left, _), (right, plant) = in_step(3_500_000), in_step(-1_000_000)
    both = by_one_clock({"left": Table.of(left), "right": Table.of(right[5:])})
    assert both["left"]["t"].tobytes() == left["t"].tobytes()
    assert both["right"]["t"] == pytest.approx(left["t"][5:], abs=1e-9)
    apart = [in_step(skew_ns, whole_second=False)[0] for skew_ns in (3_500_000, -1_000_000)]
    assert not in_lockstep([Table.of(plant), Table.of(apart[0])])
    alone = by_one_clock({"left": Table.of(apart[0]), "right": Table.of(apart[1])})
    assert alone["right"]["t"].tobytes() == apart[1]["t"].tobytes()
    assert not in_lockstep([Table.of(left), Table.of(left[:0])]), "nobody knows of who says nothing"
