"""Poses are taken where every arm holds the object and moves slowly, at one time, and each once."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.calibrate.chain import CalibrateError
from agent.calibrate.poses import LEAST, MOST, WINDOW_S, Poses, _apart, _readings, _windows, held_out, poses_of
from agent.config.cell import load_cell
from agent.log.columns import Table
from agent.modes import Mode
from agent.safety import Flag
from agent.telemetry.row.sample import AGENT_STATE

CELL = load_cell(Path("two_wx200"))
RATE_HZ = 200.0


def rows(duration_s: float = 20.0, late_s: float = 0.0, rate_rad_per_s: float = 0.1) -> NDArray[np.void]:
    """An arm that has held and moved all its joints back and forth from late_s on."""
    made = np.zeros(round(duration_s * RATE_HZ), AGENT_STATE.dtype)
    t = late_s + np.arange(len(made)) / RATE_HZ
    made["utc_ns"] = np.rint(1e9 * (1000.0 + t)).astype(np.int64)
    made["mode"] = Mode.TRACK
    made["q_measured"][:, :3] = (rate_rad_per_s * 3.0 * np.sin(t / 3.0))[:, None] * [1.0, -0.5, 0.2]
    return made


def poses(left: NDArray[np.void], right: NDArray[np.void]) -> Poses:
    return poses_of([{"left": Table.of(left), "right": Table.of(right)}], CELL)


def test_angles_of_all_arms_are_of_one_time_though_their_rows_begin_apart() -> None:
    found = poses(rows(), rows(late_s=1.37))
    np.testing.assert_allclose(found.q[0], found.q[1], atol=0.1 / RATE_HZ)
    assert found.q[0].shape == (len(found.t), 3)
    np.testing.assert_array_equal(found.some(~found.held_out), [q[~found.held_out] for q in found.q])
    middle = 1.37 + found.t + 0.5 * WINDOW_S - 0.5 / RATE_HZ
    np.testing.assert_allclose(found.q[0][:, 0], 0.3 * np.sin(middle / 3.0), atol=2e-4)
    assert np.abs(np.diff(found.q[0][:, 0])).min() >= 0.01 - 1e-9


def test_stale_rows_and_modes_without_torque_give_no_pose() -> None:
    whole = poses(rows(), rows())
    left, right = rows(), rows()
    left["mode"][: len(left) // 4] = Mode.OFF
    right["flags"][-len(right) // 4 :] = Flag.STALE
    fewer = poses(left, right)
    assert len(fewer.t) < 0.6 * len(whole.t)


@pytest.mark.parametrize("mode", list(Mode))
def test_an_arm_holds_the_object_in_these_modes_alone(mode: Mode) -> None:
    holds = mode in (Mode.READY, Mode.TRACK, Mode.HOLD, Mode.FLOAT, Mode.STAND)
    one = rows(6.0)
    one["mode"] = mode
    times, _ = _readings([Table.of(one)], 3)
    assert len(times) == (len(one) if holds else 0)


def test_an_arm_that_never_held_the_object_gives_no_pose() -> None:
    idle = rows()
    idle["mode"] = Mode.OFF
    for arms in ((idle, rows()), (rows(), idle), (idle, idle)):
        with pytest.raises(CalibrateError, match="found 0, in which all arms hold"):
            poses(*arms)


def test_a_window_counts_from_three_readings_on_in_which_no_joint_turns_by_more_than_a_twentieth() -> None:
    ms, turned = 1_000_000, {0: [0.0] * 3, 1: [0.0] * 2, 2: [0.0, 0.02, 0.05], 3: [0.0, 0.02, 0.051]}
    since = [(100 * window + 20 * k) * ms for window, q in turned.items() for k in range(len(q))]
    q = np.array([[0.0, x] for of in turned.values() for x in of])
    numbers, means = _windows(np.array(since), q)
    assert numbers.tolist() == [0, 2]
    np.testing.assert_allclose(means, [[0.0, 0.0], [0.0, 0.07 / 3]])


def test_poses_lie_a_hundredth_apart_and_are_four_hundred_at_most() -> None:
    assert _apart(np.array([[0.0], [0.009], [0.01], [0.0199], [0.021], [0.0]])).tolist() == [0, 2, 4, 5]
    assert [len(_apart(np.arange(float(count))[:, None])) for count in (400, 401, 800, 801)] == [400, 201, 400, 267]


def test_fast_motion_gives_no_pose() -> None:
    with pytest.raises(CalibrateError, match="slowly"):
        poses(rows(rate_rad_per_s=5.0)[:1000], rows(rate_rad_per_s=5.0)[:1000])


def test_an_arm_that_stands_is_no_motion() -> None:
    with pytest.raises(CalibrateError, match=r"at least 24, 0\.01 rad apart"):
        poses(rows(rate_rad_per_s=0.0), rows(rate_rad_per_s=0.0))


def test_a_missing_arm_is_named() -> None:
    with pytest.raises(CalibrateError, match="no rows of right"):
        poses_of([{"left": Table.of(rows())}], CELL)


def test_arms_of_two_hosts_and_of_two_days_are_put_together() -> None:
    left, right = Table.of(rows()), Table.of(rows(late_s=1.37))
    whole = poses_of([{"left": left, "right": right}], CELL)
    apart = poses_of([{"right": right}, {"left": left}], CELL)
    for one, other in zip((*whole.q, whole.t), (*apart.q, apart.t), strict=True):
        np.testing.assert_array_equal(one, other)
    later = rows()
    later["utc_ns"] += 86_400 * 10**9
    more = poses_of([{"left": left, "right": right}, {"left": Table.of(later), "right": Table.of(later)}], CELL)
    np.testing.assert_array_equal(more.q[0][: len(whole.t)], whole.q[0])
    assert more.t[len(whole.t)] == pytest.approx(86_400.0 - 1.37, abs=2 * WINDOW_S), "nothing between the days"
    assert len(more.t) == pytest.approx(len(whole.t) + len(poses(later, later).t), abs=2)
    with pytest.raises(CalibrateError, match="found 0, in which all arms hold"):
        poses_of([{"left": left}, {"right": Table.of(later)}], CELL)


def test_as_few_as_can_be_fitted_are_enough() -> None:
    def steps(count: int) -> NDArray[np.void]:
        made = rows(count * WINDOW_S)
        made["q_measured"][:, 0] = 0.02 * (np.arange(len(made)) // round(RATE_HZ * WINDOW_S))
        made["q_measured"][:, 1:] = 0.0
        return made

    assert len(poses(steps(LEAST), steps(LEAST)).t) == LEAST
    with pytest.raises(CalibrateError, match=f"found {LEAST - 1}"):
        poses(steps(LEAST - 1), steps(LEAST - 1))


def test_a_long_log_gives_no_more_than_can_be_fitted() -> None:
    assert LEAST <= len(poses(rows(120.0), rows(120.0)).t) <= MOST


def test_a_quarter_of_the_poses_is_held_out_in_blocks() -> None:
    held = held_out(160)
    assert held.mean() == pytest.approx(0.25)
    assert (np.diff(held.astype(int)) != 0).sum() == 8
    assert np.flatnonzero(held_out(16)).tolist() == [2, 6, 10, 14]
    assert math.isclose(held_out(24).mean(), 0.25, abs_tol=0.1)
