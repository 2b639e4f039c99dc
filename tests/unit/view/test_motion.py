"""Where things were at some instants: which of them a time is at, which a stretch has, whose object is shown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agent.control.alignment import shifted
from agent.control.trajectory import Desired
from agent.report.prepared import Prepared, prepare
from agent.view.motion import ArmMotion, Motion, joined, motion_now, motion_of
from tests.support.telemetry.synthetic_run import SQUEEZE_N, agent_rows, as_log, run_file, true_rows

T = np.array([0.0, 0.05, 0.1, 0.15])
K = len(T)


def rows_at(t: Sequence[float]) -> np.ndarray:
    """Rows of an arm at these times."""
    rows: np.ndarray = agent_rows(len(t))
    rows["t"] = t
    return rows


def run_of(left: Sequence[float], right: Sequence[float], *, rate_hz: float = 200.0, plant: bool = False) -> Prepared:
    """A run whose arms have rows at these times."""
    arms = {"left": rows_at(left), "right": rows_at(right)}
    true = true_rows(arms["left"]) if plant else None
    return prepare(as_log(Path("run"), arms, true, run_file(1000.0, rate_hz)))


def motion(*, true: bool) -> Motion:
    rows = np.arange(7.0 * K).reshape(K, 7)
    three = np.zeros((K, 3))
    arms = {
        name: ArmMotion(three, rows + k, rows, three, three, np.zeros(K, np.int64), *np.ones((2, K), np.bool_))
        for k, name in enumerate(("left", "right"), 1)
    }
    return Motion(T, arms, rows + 100.0 if true else None)


def test_the_object_is_where_it_truly_is_or_where_the_first_arm_believes_it() -> None:
    for true, first in ((True, 100.0), (False, 1.0)):
        assert motion(true=true).object[0, 0] == first


def test_a_time_is_at_the_last_instant_that_is_not_a_microsecond_after_it() -> None:
    own = motion(true=True)
    assert [own.row_at(t) for t in (-1.0, 0.05 - 1.5e-6, 0.05 - 5e-7, 0.05, 0.09, 9.0)] == [0, 0, 1, 1, 1, 3]


def test_a_stretch_has_its_first_instant_and_not_its_end_but_for_rounding() -> None:
    own = motion(true=True)
    for begin, end, rows in (
        (0.05, 0.15, [1, 2]), (0.05 + 5e-10, 0.15 + 5e-10, [1, 2]), (0.05 + 1.5e-9, 0.15 + 1.5e-9, [2, 3]),
    ):  # fmt: skip
        part = own.within(begin, end)
        assert part.t.tolist() == T[rows].tolist()
        assert part.true is not None
        np.testing.assert_array_equal(part.true, own.object[rows])
        np.testing.assert_array_equal(part.arms["right"].belief, own.arms["right"].belief[rows])
    assert motion(true=False).within(0.0, 0.1).true is None


def test_a_run_begins_with_the_first_row_of_any_arm_and_ends_with_the_last() -> None:
    assert motion_of(run_of([0.1, 0.2], [0.2, 0.3])).t == pytest.approx([0.1, 0.15, 0.2, 0.25, 0.3])
    assert motion_of(run_of([0.2, 0.3], [0.1, 0.2])).t == pytest.approx([0.1, 0.15, 0.2, 0.25, 0.3])


def test_an_instant_that_rounding_puts_after_the_last_row_is_its_own() -> None:
    """0.3 − 0.1 is less than four twentieths of a second."""
    assert (0.3 - 0.1) * 20.0 < 4.0
    for last, count in ((0.3, 5), (0.3 - 0.5e-9 / 20.0, 5), (0.3 - 1.5e-9 / 20.0, 4)):
        assert len(motion_of(run_of([0.1, last], [0.1])).t) == count


def test_the_end_asked_for_is_no_instant_but_for_a_microsecond() -> None:
    run = run_of([0.0, 0.3], [0.0, 0.3])
    assert [len(motion_of(run, end_s=0.15 + late_s).t) for late_s in (0.0, 0.5e-6, 1.5e-6)] == [3, 3, 4]


def test_a_long_run_is_shown_whole_in_six_thousand_pictures() -> None:
    for last, count in ((299.9, 5999), (400.0, 6000)):
        t = motion_of(run_of([0.0, last], [0.0])).t
        assert (len(t), t[-1]) == (count, pytest.approx(last))
        assert np.ptp(np.diff(t)) < 1e-9


def test_a_row_is_fresh_for_three_quarters_of_a_tick() -> None:
    """A tick of 1/192 s: three quarters of it are 1/256 s, to the last bit."""
    own = motion_of(run_of([0.0, 4 / 256], [0.0, 4 / 256], rate_hz=192.0), pictures_hz=256.0)
    assert own.t.tolist() == [0.0, 1 / 256, 2 / 256, 3 / 256, 4 / 256]
    assert own.arms["left"].fresh.tolist() == [True, True, False, True, True]


def test_the_true_pose_is_the_last_that_is_not_a_nanosecond_after_the_instant() -> None:
    run = run_of([0.0, 0.05], [0.0, 0.05], plant=True)
    assert run.true is not None
    p = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    for late_s, x in ((0.5e-9, 1.0), (1.5e-9, 0.0)):
        true = motion_of(replace(run, true=replace(run.true, t=np.array([0.0, 0.05 + late_s]), p=p))).true
        assert true is not None
        assert true[1, 0] == x


def test_without_a_true_pose_or_without_the_grasps_forces_are_as_commanded() -> None:
    run = run_of([0.0, 0.05], [0.0, 0.05], plant=True)
    assert motion_of(run).arms["left"].internal[0, 0] == pytest.approx(SQUEEZE_N)
    for less in (replace(run, true=None), replace(run, grasps=None)):
        own = motion_of(less)
        assert own.true is None
        assert own.arms["left"].internal.tolist() == np.zeros((2, 3)).tolist()


@pytest.mark.parametrize("seen", [True, False], ids=["beside a true object", "alone"])
def test_what_is_desired_beside_a_true_object_is_what_all_steer_to(seen: bool) -> None:
    """An arm steers to a pose that is shifted by how it sees the object elsewhere."""
    shift = (5e-3, -1e-3, 2e-3, 0.02, -0.01, 0.03)
    there = Desired((0.3, 0.1, 0.2), (0.8, 0.0, 0.6, 0.0), (0.0,) * 6, (0.0,) * 6)
    own = shifted(there, shift)
    rows = rows_at([0.0, 0.05])
    rows["p_object_des"], rows["quat_object_des"], rows["shift"] = own.p, own.quat, shift
    plant = true_rows(rows) if seen else None
    recorded = motion_of(prepare(as_log(Path("run"), {"left": rows, "right": rows}, plant, run_file(1000.0, 200.0))))
    live = motion_now({"left": rows[1:]}, None if plant is None else plant[1:])
    assert live is not None
    wanted = there if seen else own
    for at in (recorded.arms["right"].desired[1], live.arms["left"].desired[0]):
        assert at.tolist() == pytest.approx([*wanted.p, *wanted.quat])


@pytest.mark.parametrize("less", [{"true": None}, {"grasps": None}])
def test_where_the_truth_is_not_whole_what_is_desired_is_what_each_arm_steers_to(less: dict[str, None]) -> None:
    left = rows_at([0.0, 0.05])
    left["shift"] = 5e-3
    run = prepare(as_log(Path("run"), {"left": left, "right": left}, true_rows(left), run_file(1000.0, 200.0)))
    shown = motion_of(replace(run, **less)).arms["left"].desired  # type: ignore[arg-type]
    assert shown[1, :3].tolist() == left["p_object_des"][1].tolist()


def test_now_is_the_newest_row_of_any_arm() -> None:
    for left, right in ((1.0, 2.0), (2.0, 1.0)):
        own = motion_now({"left": rows_at([left]), "right": rows_at([right])}, None)
        assert own is not None
        assert own.t.tolist() == [2.0]
        assert own.true is None
        assert own.object is own.arms["left"].belief


def test_forces_of_a_plant_with_more_arms_than_are_heard_are_as_commanded() -> None:
    left, right = rows_at([1.0]), rows_at([1.0])
    left["wrench_internal"][:, 0] = 0.25
    plant = true_rows(left)
    plant["p_object"] = [1.0, 2.0, 3.0]
    alone, both = motion_now({"left": left}, plant), motion_now({"left": left, "right": right}, plant)
    assert alone is not None
    assert both is not None
    assert alone.arms["left"].internal[0].tolist() == [0.25, 0.0, 0.0]
    assert both.arms["left"].internal[0, 0] > 1.0
    assert alone.object[0, :3].tolist() == both.object[0, :3].tolist() == [1.0, 2.0, 3.0]


def test_motions_are_joined_and_the_object_is_where_each_shows_it() -> None:
    seen, true = motion(true=False), motion(true=True)
    assert joined([seen]).true is None
    assert joined([seen, seen]).true is None
    for parts in ([true], [true, true], [seen, true], [true, seen]):
        own = joined(parts)
        np.testing.assert_array_equal(own.t, np.concatenate([T] * len(parts)))
        np.testing.assert_array_equal(own.object, np.concatenate([part.object for part in parts]))
        np.testing.assert_array_equal(
            own.arms["right"].belief, np.concatenate([seen.arms["right"].belief] * len(parts))
        )
