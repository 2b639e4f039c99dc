"""What each arm of a log sees and carries, to the last digit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from agent.log.columns import Table
from agent.log.read import ColumnLog, open_log
from agent.modes import Mode
from agent.replay.grasps import NO_POSE, grasps
from agent.replay.source import ReplayError
from agent.safety import Flag
from tests.support.runner_rig import paper, run
from tests.support.telemetry.run_log import write_run
from tests.support.telemetry.synthetic_run import agent_rows, plant_rows

TURN = 0.6  # rad, of what one arm sees against the other


def two_arms() -> tuple[np.ndarray, np.ndarray]:
    """The same ticks; the second arm sees the object 2 mm aside and turned, as the opposite quaternion."""
    left = run(ticks=20).rows.copy()
    left["wrench_cmd"] = 0.0
    left["quat_object"] = [1.0, 0.0, 0.0, 0.0]
    right = left.copy()
    right["p_object"][:, 0] += 2e-3
    right["quat_object"] = [-np.cos(TURN / 2), -0.6 * np.sin(TURN / 2), -0.8 * np.sin(TURN / 2), 0.0]
    track = np.flatnonzero(left["mode"] == Mode.TRACK)
    left["wrench_cmd"][track[3], :6] = [3.0, 4.0, 12.0, 99.0, 0.0, 0.0]
    left["wrench_cmd"][track[5], 0] = 77.0
    left["flags"][track[5]] |= Flag.STALE.value
    right["wrench_cmd"][track[4], 0] = 0.25
    return left, right


def test_arms_differ_from_their_mean_by_half_of_what_they_differ_by(tmp_path: Path) -> None:
    left, right = two_arms()
    with open_log(write_run(tmp_path / "run.mcap", paper(), {"left": left, "right": right})) as log:
        found = grasps(log, paper())
    assert not found.truth
    assert [arm.arm for arm in found.arms] == ["left", "right"]
    assert [arm.rows for arm in found.arms] == [19, 19], "without the tick that one of them did not see"
    for arm in found.arms:
        assert arm.offset_m == pytest.approx(1e-3)
        assert arm.offset_rad == pytest.approx(TURN / 2, rel=1e-9)
    assert [arm.force_max_N for arm in found.arms] == [13.0, 0.25]


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e300])
@pytest.mark.parametrize("whose", ["an arm", "the truth"])
def test_a_row_without_a_pose_or_a_force_that_are_numbers_counts_as_none(wrong: float, whose: str) -> None:
    left, right = rows(40), rows(40)
    plant = plant_rows(left)
    sound = grasps(log_of(left.copy(), right.copy(), plant.copy()), paper())
    struck = {"an arm": left, "the truth": plant}[whose]
    struck["p_object"][20, 0] = wrong
    plant["grasp_wrench"][21, [0, 6]] = wrong
    found = grasps(log_of(left, right, plant), paper())
    assert [arm.rows for arm in found.arms] == [arm.rows - 1 for arm in sound.arms]
    for arm, before in zip(found.arms, sound.arms, strict=True):
        assert arm.offset_m == pytest.approx(before.offset_m, rel=0.2, abs=1e-4)
        assert arm.force_max_N == before.force_max_N
    struck["p_object"][:, 1] = wrong
    with pytest.raises(ReplayError, match="no tick in which every arm follows with a pose that is a number"):
        grasps(log_of(left, right, plant), paper())


@pytest.mark.parametrize("whose", ["an arm", "the truth"])
def test_a_quaternion_of_zeros_is_no_attitude(whose: str) -> None:
    left, right = rows(40), rows(40)
    plant = plant_rows(left)
    sound = grasps(log_of(left.copy(), right.copy(), plant.copy()), paper())
    {"an arm": left, "the truth": plant}[whose]["quat_object"][20] = 0.0
    found = grasps(log_of(left, right, plant), paper())
    assert [arm.rows for arm in found.arms] == [arm.rows - 1 for arm in sound.arms]
    assert all(np.isfinite(arm.offset_rad) for arm in found.arms)


@pytest.mark.parametrize(
    ("field", "size", "counts"),
    [
        ("p_object", 0.9 * NO_POSE, True), ("p_object", -NO_POSE, False), ("p_object", 1.5 * NO_POSE, False),
        ("quat_object", 0.11, True), ("quat_object", 0.1, False), ("quat_object", 0.09, False),
        ("quat_object", 0.9 * NO_POSE, True), ("quat_object", NO_POSE, False), ("quat_object", -1.5e6, False),
    ],
)  # fmt: skip
def test_what_is_too_far_away_or_too_small_is_of_a_damaged_row(field: str, size: float, counts: bool) -> None:
    left, right = rows(40), rows(40)
    left[field][20] = 0.0
    left[field][20, 0] = size
    assert [arm.rows for arm in grasps(log_of(left, right), paper()).arms] == [39 + counts] * 2
    assert NO_POSE == 1e6


PERIOD_NS = 5_000_000  # of the paper's cell


def log_of(left: np.ndarray, right: np.ndarray, plant: np.ndarray | None = None) -> ColumnLog:
    agents = {"left": Table.of(left), "right": Table.of(right)}
    return ColumnLog(Path("run"), "paper", agents, None if plant is None else Table.of(plant), [], {}, {}, True, {})


def rows(count: int, first: int = 0) -> np.ndarray:
    own: np.ndarray = agent_rows(count, first=first)
    own["utc_ns"] = 1_800_000_000_000_000_000 + PERIOD_NS * own["sequence"].astype(np.int64)
    return own


def test_with_a_simulation_arms_are_held_against_the_truth_of_the_same_ticks_and_its_forces_count() -> None:
    left, right, plant = rows(10, 6), rows(10, 5), plant_rows(rows(20))
    plant["p_object"][:, 0] = np.arange(20.0)  # another place at each tick
    left["p_object"][:, 0] = np.arange(6.0, 16.0) + 1e-3
    right["p_object"][:, 0] = np.arange(5.0, 15.0) - 3e-3
    plant["grasp_wrench"][2, :9] = [3.0, 0.0, 4.0, 99.0, 99.0, 99.0, 0.0, 6.0, 8.0]
    left["wrench_cmd"][:, 0] = 77.0
    found = grasps(log_of(left, right, plant), paper())
    assert found.truth
    assert [arm.rows for arm in found.arms] == [9, 9]
    assert [arm.offset_m for arm in found.arms] == pytest.approx([1e-3, 3e-3])
    assert [arm.offset_rad for arm in found.arms] == [0.0, 0.0]
    assert [arm.force_max_N for arm in found.arms] == [5.0, 10.0]


def test_a_simulation_that_left_no_row_is_no_truth() -> None:
    left, right = rows(10), rows(10)
    right["p_object"][:, 2] = 4e-3
    found = grasps(log_of(left, right, plant_rows(rows(0))), paper())
    assert not found.truth
    assert [arm.offset_m for arm in found.arms] == pytest.approx([2e-3, 2e-3])


def test_ticks_are_the_same_up_to_half_a_period_apart() -> None:
    left, right = rows(10), rows(10)
    right["t"][:3] += 1e-9 * (PERIOD_NS // 2)
    right["t"][6] += 1e-9 * (PERIOD_NS // 2 + 1)
    assert [arm.rows for arm in grasps(log_of(left, right), paper()).arms] == [9, 9]


@pytest.mark.parametrize("truth", [True, False])
def test_a_utc_that_is_off_makes_no_other_pairs(truth: bool) -> None:
    """One arm's clock of the day jumps in the run; the trajectory's time says what belongs together."""
    left, right, plant = rows(40), rows(40), plant_rows(rows(40))
    for own in (left, right, plant):
        own["p_object"][:, 0] = np.arange(40.0)
    right["utc_ns"][10:] -= 7 * PERIOD_NS
    left["utc_ns"] += 3 * PERIOD_NS
    plant["t"] += 4.0  # it began before the trajectory
    right["stamp_ns"] += 10**14  # of another host
    found = grasps(log_of(left, right, plant if truth else None), paper())
    assert [(arm.rows, arm.offset_m) for arm in found.arms] == [(40, 0.0), (40, 0.0)]


def test_a_log_of_two_motions_is_paired_by_utc() -> None:
    left, right, plant = rows(40), rows(40), plant_rows(rows(40))
    for own in (left, right, plant):
        own["t"][20:] -= 20 * 1e-9 * PERIOD_NS
        own["p_object"][:, 0] = np.arange(40.0)
    found = grasps(log_of(left, right, plant), paper())
    assert [(arm.rows, arm.offset_m) for arm in found.arms] == [(40, 0.0), (40, 0.0)]


def test_where_the_times_of_one_arm_alone_come_again_utc_pairs_them() -> None:
    left, right = rows(40), rows(40)[:20]
    left["t"][20:] -= 20 * 1e-9 * PERIOD_NS
    for own in (left, right):
        own["p_object"][:, 0] = np.arange(float(len(own)))
    assert [(arm.rows, arm.offset_m) for arm in grasps(log_of(left, right), paper()).arms] == [(20, 0.0), (20, 0.0)]


@pytest.mark.parametrize("unknown", [np.nan, -np.inf, np.inf, 1e300, -1e10])
def test_rows_of_one_time_and_one_whose_time_is_unknown_are_no_second_motion(unknown: float) -> None:
    left, right = rows(40), rows(40)
    for own in (left, right):
        own["t"][5] = own["t"][4]
        own["p_object"][:, 0] = np.arange(40.0)
    left["t"][0] = unknown
    right["utc_ns"] -= 7 * PERIOD_NS
    assert [(arm.rows, arm.offset_m) for arm in grasps(log_of(left, right), paper()).arms] == [(39, 0.0), (39, 0.0)]
