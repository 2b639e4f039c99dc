"""Two logs held against each other: rows that both have, arms that only one has, and by how much torques differ."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agent.log.columns import BLOCK_ROWS, Table
from agent.replay.comparison import ArmComparison
from agent.replay.same import same
from agent.replay.source import ReplayError
from agent.telemetry.row.sample import AGENT_STATE, PLANT_STATE
from agent.telemetry.row.topics import PLANT
from tests.support.telemetry.telemetry_cell import make_rows


def log(name: str, plant: np.ndarray | None = None, **arms: np.ndarray) -> Any:
    return SimpleNamespace(
        path=Path(name),
        agents={arm: Table.of(rows) for arm, rows in arms.items()},
        plant=None if plant is None else Table.of(plant),
        layouts=dict.fromkeys(arms, AGENT_STATE) | {PLANT: PLANT_STATE},
    )


def rows(count: int = 30) -> np.ndarray:
    return make_rows("left", count).copy()


def test_an_arm_that_only_one_log_has_is_named_and_its_rows_are_left_out() -> None:
    one, both = log("one.mcap", left=rows()), log("both.mcap", left=rows(), right=rows(20))
    for verdict in (same(one, both), same(both, one)):
        assert verdict.notes == ("right: only in both.mcap",)
        assert verdict.arms == (
            ArmComparison("left", 30, 0, 0, None, 0.0), ArmComparison("right", 0, 0, 20, None, 0.0)
        )  # fmt: skip
        assert not verdict.equal


def test_the_largest_difference_of_torque_is_told_with_the_first_row() -> None:
    a, b = rows(BLOCK_ROWS + 30), rows(BLOCK_ROWS + 30)
    b["tau_limited"][7, 1] += 0.25
    b["tau_cmd"][11, 0] -= 2.0
    b["tau_limited"][BLOCK_ROWS + 5, 2] += 0.5
    (arm,) = same(log("a.mcap", left=a), log("b.mcap", left=b)).arms
    assert (arm.rows, arm.different, arm.left_out) == (BLOCK_ROWS + 30, 3, 0)
    assert arm.torque_difference_Nm == pytest.approx(2.0)
    assert arm.first is not None
    assert (arm.first.row, arm.first.field, arm.first.index) == (int(a["sequence"][7]), "tau_limited", 1)


def test_a_field_that_is_one_number_has_no_index() -> None:
    b = rows()
    b["mode"][5] += 1
    (arm,) = same(log("a.mcap", left=rows()), log("b.mcap", left=b)).arms
    assert arm.first is not None
    assert (arm.first.field, arm.first.index, arm.first.fields) == ("mode", None, ("mode",))
    assert arm.first.replayed == arm.first.recorded + 1  # type: ignore[operator]


@pytest.mark.filterwarnings("error")
def test_torques_that_are_no_numbers_are_different_and_no_crash() -> None:
    a, b = rows(), rows()
    a["tau_limited"][3], b["tau_limited"][3] = np.inf, np.nan
    a["tau_limited"][4] = b["tau_limited"][4] = np.inf
    (arm,) = same(log("a.mcap", left=a), log("b.mcap", left=b)).arms
    assert (arm.different, arm.torque_difference_Nm) == (1, 0.0)


def test_rows_of_one_log_alone_are_left_out_and_a_plant_has_no_torque_limit() -> None:
    plant = np.zeros(10, PLANT_STATE.dtype)
    plant["sequence"] = np.arange(10)
    a, b = log("a.mcap", plant, left=rows()), log("b.mcap", plant[2:], left=rows()[:25])
    found = {arm.arm: (arm.rows, arm.different, arm.left_out, arm.torque_difference_Nm) for arm in same(a, b).arms}
    assert found == {"left": (25, 0, 5, 0.0), PLANT: (8, 0, 2, 0.0)}


def test_logs_without_a_row_in_common_are_refused() -> None:
    late = rows()
    late["sequence"] += 1000
    with pytest.raises(ReplayError, match="no row of the same arm and number"):
        same(log("a.mcap", left=rows()), log("b.mcap", left=late))
