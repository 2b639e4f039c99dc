"""Joint angles for an object pose: exact where it can be reached, and a measured refusal where not."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from agent.control import ik
from agent.control.models import ArmModel
from drivers.interface import Vector
from tests.support.control.strategies import Holder, make_cell

SEEDS = range(12)


def holder(seed: int, planar: bool) -> Holder:
    return make_cell(seed, planar, 2, sigma_min=0.06).arms[0]


def pose_error(T: pin.SE3, wanted: pin.SE3) -> float:
    turn = pin.log3(wanted.rotation @ T.rotation.T)
    return float(max(np.linalg.norm(T.translation - wanted.translation), np.linalg.norm(turn)))


@pytest.mark.parametrize("planar", [True, False])
@pytest.mark.parametrize("seed", SEEDS)
def test_solution_puts_the_object_where_it_is_wanted(seed: int, planar: bool) -> None:
    """From a start nearby; the solution found is the one of that branch."""
    arm = holder(seed, planar)
    wanted = arm.model.object_pose(arm.q)
    near = arm.q + np.random.default_rng(seed).uniform(-0.15, 0.15, arm.model.n)
    q = ik.solve(arm.model, wanted, near)
    assert pose_error(arm.model.object_pose(q), wanted) < 1e-8
    assert np.abs(q - arm.q).max() < 1e-6
    assert np.abs(q).max() <= math.pi


def test_the_start_is_left_as_it_is() -> None:
    arm = holder(0, True)
    near = arm.q + 0.05
    kept = near.copy()
    ik.solve(arm.model, arm.model.object_pose(arm.q), near)
    assert np.array_equal(near, kept)


def test_no_joint_is_turned_by_more_than_a_third_of_a_radian_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """So that the solution found is the one of the side on which it was looked for."""
    arm, tried = holder(3, True), list[np.ndarray]()
    at = ArmModel.pose_and_jacobian

    def seen(model: ArmModel, q: Vector) -> Any:
        tried.append(q.copy())
        return at(model, q)

    wanted = arm.model.object_pose(arm.q)
    monkeypatch.setattr(ArmModel, "pose_and_jacobian", seen)
    ik.solve(arm.model, wanted, arm.q + 0.8)
    steps = np.abs(np.diff(tried, axis=0)).max(axis=1)
    assert steps.max() == pytest.approx(0.3), "where the goal is far"
    assert (steps[-2:] < 0.01).all()


def test_both_elbow_solutions_are_found_from_their_own_side() -> None:
    """Mirror image about the line from shoulder to wrist: two answers, one pose."""
    arm = holder(3, True)
    wanted = arm.model.object_pose(arm.q)
    found = set()
    for offset in np.linspace(-1.5, 1.5, 13):
        try:
            q = ik.solve(arm.model, wanted, arm.q + np.array([offset, -2 * offset, offset]))
        except ik.Unreachable:
            continue
        assert pose_error(arm.model.object_pose(q), wanted) < 1e-8
        found.add(tuple(np.round(q, 5).tolist()))
    assert len(found) == 2


@pytest.mark.parametrize("planar", [True, False])
def test_a_pose_out_of_reach_says_how_far_it_is(planar: bool) -> None:
    arm = holder(1, planar)
    wanted = arm.model.object_pose(arm.q)
    away = wanted.translation - arm.T_world_base.translation
    in_task = arm.model.task_basis[:, :3].T @ arm.model.task_basis[:, :3] @ away
    wanted.translation = wanted.translation + 3.0 * in_task / np.linalg.norm(in_task)
    with pytest.raises(ik.Unreachable, match=r"mm and .* mrad short") as caught:
        ik.solve(arm.model, wanted, arm.q)
    assert caught.value.distance_m > 1.5
    assert not caught.value.out_of_task


@pytest.mark.parametrize(
    ("shift", "turn", "distance_m", "angle_rad"), [(0.002, 0.0, 0.002, 0.0), (0.0, 0.03, 0.0, 0.03)]
)
def test_what_lies_outside_the_plane_is_told_apart(
    shift: float, turn: float, distance_m: float, angle_rad: float
) -> None:
    """The plane is reached exactly; what is left is the shift along the normal or the tilt."""
    arm = holder(2, True)
    normal = arm.model.plane_normal
    in_plane = arm.model.task_basis[0, :3]
    T = arm.model.object_pose(arm.q)
    tilt = pin.AngleAxis(turn, in_plane).matrix()
    with pytest.raises(ik.Unreachable) as caught:
        ik.solve(arm.model, pin.SE3(tilt @ T.rotation, T.translation + shift * normal), arm.q)
    assert caught.value.out_of_task
    assert caught.value.distance_m == pytest.approx(distance_m, abs=1e-8)
    assert caught.value.angle_rad == pytest.approx(angle_rad, abs=1e-8)


class FoldedArm:
    """Two joints that turn together at this pose, so that J Jᵀ has no inverse; where the object is, is given."""

    task_basis = np.eye(6)[:2]

    def pose_and_jacobian(self, _q: np.ndarray) -> tuple[pin.SE3, np.ndarray]:
        return pin.SE3(np.eye(3), np.zeros(3)), np.array([[1.0, 1.0], [1.0, 1.0]])


@pytest.mark.parametrize(("distance_m", "reached"), [(5e-9, True), (2e-8, False)])
def test_a_singular_pose_that_the_goal_is_next_to_ends_the_search_there(distance_m: float, reached: bool) -> None:
    wanted, q = pin.SE3(np.eye(3), np.array([distance_m, 0.0, 0.0])), np.array([0.1, -0.2])
    if reached:
        assert ik.solve(FoldedArm(), wanted, q).tolist() == pytest.approx(q.tolist())
    else:
        with pytest.raises(ik.Unreachable):
            ik.solve(FoldedArm(), wanted, q)
