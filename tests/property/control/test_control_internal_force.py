"""Internal forces: in the null space of Gᵀ, equal to the paper's time-varying form, and without effect on motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.control import internal_force, known
from tests.support.control import oracle
from tests.support.control.strategies import RandomCell, cells, examples, with_internal_wrenches

SEEDS = st.integers(0, 2**32 - 1)


def random_wrenches(seed: int, count: int) -> list[tuple[float, ...]]:
    return [tuple(w) for w in np.random.default_rng(seed).normal(scale=5.0, size=(count, 6)).tolist()]


def grasp_jacobians(cell: RandomCell) -> list[np.ndarray]:
    """J_O (6, 6) of every arm in world axes at the cell's present attitude."""
    R, jacobians = cell.T_world_object.rotation, []
    for arm in cell.arms:
        J_O = np.eye(6)
        J_O[:3, 3:] = oracle.skew(-R @ arm.T_object_ee.translation)  # p_O − p_E
        jacobians.append(J_O)
    return jacobians


def in_world(R: np.ndarray, wrench: tuple[float, ...]) -> np.ndarray:
    return np.concatenate([R @ wrench[:3], R @ wrench[3:]])


@given(cells(), SEEDS)
@examples(60)
def test_internal_force_has_no_net_wrench(cell: RandomCell, seed: int) -> None:
    """Gᵀ f_int = 0."""
    wrenches = internal_force.internal_wrenches(cell.grasps, random_wrenches(seed, len(cell.arms)))
    R = cell.T_world_object.rotation
    net = sum(J_O.T @ in_world(R, f) for J_O, f in zip(grasp_jacobians(cell), wrenches, strict=True))
    assert np.abs(net).max() < 1e-12


@given(cells(), SEEDS)
@examples(60)
def test_constant_wrenches_in_object_axes_are_the_papers_projection(cell: RandomCell, seed: int) -> None:
    """(I − G* Gᵀ) f̂ with today's G in world axes is the offline result turned by R_O."""
    desired, R, N = random_wrenches(seed, len(cell.arms)), cell.T_world_object.rotation, len(cell.arms)
    jacobians = grasp_jacobians(cell)
    G = np.vstack(jacobians)
    G_star = np.hstack([np.linalg.inv(J) for J in jacobians]).T / N
    f_hat = np.concatenate([in_world(R, f) for f in desired])
    expected = (np.eye(6 * N) - G_star @ G.T) @ f_hat
    found = [in_world(R, f) for f in internal_force.internal_wrenches(cell.grasps, desired)]
    assert np.abs(np.concatenate(found) - expected).max() < 1e-12


@given(cells(), SEEDS)
@examples(40)
def test_projection_changes_an_internal_force_no_more(cell: RandomCell, seed: int) -> None:
    once = internal_force.internal_wrenches(cell.grasps, random_wrenches(seed, len(cell.arms)))
    twice = internal_force.internal_wrenches(cell.grasps, once)
    assert np.abs(np.array(twice) - np.array(once)).max() < 1e-12


@given(cells(), SEEDS)
@examples(40)
def test_agents_own_wrench_is_its_row_about_the_object_centre(cell: RandomCell, seed: int) -> None:
    desired = random_wrenches(seed, len(cell.arms))
    rows = internal_force.internal_wrenches(cell.grasps, desired)
    for i, (p, row) in enumerate(zip(cell.grasps, rows, strict=True)):
        expected = internal_force.about_object_centre(p, row)
        assert internal_force.agent_wrench(i, cell.grasps, desired) == pytest.approx(expected, abs=1e-12)


@given(cells(), SEEDS)
@examples(40)
def test_internal_term_of_the_law_is_the_row_through_the_end_effector_jacobian(cell: RandomCell, seed: int) -> None:
    """J_Eᵀ f_int,i in world axes, and the wrench reported beside it."""
    desired = random_wrenches(seed, len(cell.arms))
    rows = internal_force.internal_wrenches(cell.grasps, desired)
    R = cell.T_world_object.rotation
    for i, (arm, row) in enumerate(zip(cell.arms, rows, strict=True)):
        offline = replace(arm.offline, internal_wrench=internal_force.agent_wrench(i, cell.grasps, desired))
        terms = known.torque(arm.model, offline, arm.q, arm.dq, cell.desired)
        data = arm.model.model.createData()
        J_E = pin.computeFrameJacobian(
            arm.model.model, data, arm.q, arm.model.ee_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        assert np.abs(terms.tau_internal - J_E.T @ in_world(R, row)).max() < 1e-11
        assert np.abs(np.array(terms.wrench_internal) - in_world(R, row)).max() < 1e-11


@given(cells(), SEEDS)
@examples(40)
def test_internal_force_adds_no_acceleration_and_only_its_own_term(cell: RandomCell, seed: int) -> None:
    pressed = with_internal_wrenches(cell, seed)
    net = np.zeros(len(cell.P))
    for plain, arm in zip(cell.arms, pressed.arms, strict=True):
        before = known.torque(plain.model, plain.offline, arm.q, arm.dq, cell.desired)
        after = known.torque(arm.model, arm.offline, arm.q, arm.dq, cell.desired)
        assert np.abs(after.tau_cmd - before.tau_cmd - after.tau_internal).max() < 1e-9
        assert not before.tau_internal.any()
        s = oracle.task_space(arm, arm.q, arm.dq, cell.P)
        net += s.J_O.T @ s.J_inv.T @ after.tau_internal
    assert np.abs(net).max() < 1e-10


def test_two_opposite_pushes_are_internal_as_they_are() -> None:
    """A squeeze along the line between two grasps needs no correction; a push of one arm is halved."""
    grasps = [(-0.04, 0.0, 0.0), (0.04, 0.0, 0.0)]
    squeeze = [(3.0, 0.0, 0.0, 0.0, 0.0, 0.0), (-3.0, 0.0, 0.0, 0.0, 0.0, 0.0)]
    assert internal_force.internal_wrenches(grasps, squeeze) == squeeze
    push = [(3.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0,) * 6]
    halved = [(1.5, 0.0, 0.0, 0.0, 0.0, 0.0), (-1.5, 0.0, 0.0, 0.0, 0.0, 0.0)]
    assert internal_force.internal_wrenches(grasps, push) == halved


def test_as_many_desired_wrenches_as_grasps_are_needed() -> None:
    with pytest.raises(ValueError, match="shorter"):
        internal_force.internal_wrenches([(0.0, 0.0, 0.0)] * 2, [(0.0,) * 6])
