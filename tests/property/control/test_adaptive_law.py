"""The adaptive law against the paper's printed task-space form, and what an estimate may and may not change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.control import adaptive, known
from agent.control.adaptation import Estimate
from agent.control.quaternion import from_axis_angle, multiply
from tests.support.control import oracle
from tests.support.control.adaptive_cells import adaptation, holder_of, nominal_of, random_estimate
from tests.support.control.strategies import (
    RandomCell,
    cells,
    examples,
    random_joints,
    with_friction,
    with_internal_wrenches,
)

SEEDS = st.integers(0, 2**32 - 1)


def assert_close(found: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    scale = max(1.0, float(np.abs(expected).max()))
    assert float(np.abs(np.asarray(found) - expected).max()) <= tolerance * scale


def centred(estimate: Estimate) -> Estimate:
    """The same with the object's centre of mass at its frame's origin, which is all the printed form knows."""
    body = estimate.object.copy()
    body[1:4] = 0.0
    return Estimate(estimate.arm, body)


@given(cells(), SEEDS)
@examples(90)
def test_joint_space_law_is_the_printed_task_space_law(cell: RandomCell, seed: int) -> None:
    """About 1000 states: Y_i θ̂_i + c_i Y_O θ̂_O is the printed law of an arm and an object with those parameters."""
    rng = np.random.default_rng(seed)
    for arm in with_internal_wrenches(cell, seed).arms:
        nominal = nominal_of(arm)
        for _ in range(4):
            q, dq = random_joints(rng, arm.model), rng.normal(size=arm.model.n)
            estimate = centred(random_estimate(rng, nominal))
            u, s = oracle.task_wrench(holder_of(arm, estimate), q, dq, cell.desired, cell.P)
            terms, _ = adaptive.torque(arm.model, arm.offline, adaptation(nominal), estimate, q, dq, cell.desired)
            assert_close(terms.tau_cmd, s.J.T @ u, 1e-9)
            assert_close(cell.P @ np.array(terms.wrench_cmd), u, 1e-9)


@given(cells(), SEEDS)
@examples(40)
def test_with_the_true_parameters_it_is_the_non_adaptive_law(cell: RandomCell, seed: int) -> None:
    for holder in with_internal_wrenches(cell, seed).arms:
        arm = with_friction(holder, np.random.default_rng(seed))
        friction = arm.offline.friction
        assert friction is not None
        truth = nominal_of(arm, friction.joints)
        same = adaptation(truth, friction=True, sticking=friction.joints)
        found, _ = adaptive.torque(arm.model, arm.offline, same, truth, arm.q, arm.dq, cell.desired)
        expected = known.torque(arm.model, arm.offline, arm.q, arm.dq, cell.desired)
        assert_close(found.tau_cmd, expected.tau_cmd, 1e-11)
        assert_close(found.tau_friction, expected.tau_friction, 1e-12)
        assert_close(np.array(found.wrench_cmd), np.array(expected.wrench_cmd), 1e-11)
        assert found.lyapunov == pytest.approx(expected.lyapunov, rel=1e-12)


@given(cells(), SEEDS)
@examples(30)
def test_the_lyapunov_share_grows_by_what_the_estimate_is_off(cell: RandomCell, seed: int) -> None:
    arm = cell.arms[0]
    truth = nominal_of(arm)
    data, off = adaptation(truth), random_estimate(np.random.default_rng(seed), truth)
    args = (arm.q, arm.dq, cell.desired)
    (at_truth, _), (found, _) = (adaptive.torque(arm.model, arm.offline, data, e, *args) for e in (truth, off))
    error = data.parameter_error(off)
    assert error > 0.0 == data.parameter_error(truth)
    assert found.lyapunov == pytest.approx(at_truth.lyapunov + error, rel=1e-12)


@given(cells(), SEEDS)
@examples(40)
def test_gradients_are_those_of_the_printed_adaptation_laws(cell: RandomCell, seed: int) -> None:
    """Y_iᵀ e_v and c_i Y_Oᵀ e_v: a change of the estimates does as much work on e_v as it has along the gradient.

    The work is taken in the task space, so what a planar arm's errors have out of its plane teaches it nothing.
    """
    rng = np.random.default_rng(seed)
    desired = cell.desired._replace(quat=multiply(from_axis_angle((0.6, 0.0, 0.8), 0.1), cell.desired.quat))
    for arm in cell.arms:
        nominal = nominal_of(arm)
        data, first, second = adaptation(nominal, friction=True), *(random_estimate(rng, nominal) for _ in range(2))
        before, gradient = adaptive.torque(arm.model, arm.offline, data, first, arm.q, arm.dq, desired)
        after, same = adaptive.torque(arm.model, arm.offline, data, second, arm.q, arm.dq, desired)
        wrench = np.linalg.solve(arm.model.jacobian(arm.q).T, after.tau_cmd - before.tau_cmd)
        work = arm.model.task_basis @ np.array(before.errors.e_v) @ wrench
        along = gradient.arm @ (second.arm - first.arm) + gradient.object @ (second.object - first.object)
        assert work == pytest.approx(along, rel=1e-9, abs=1e-9)
        assert np.array_equal(gradient.arm, same.arm)  # the laws do not depend on what is believed
        assert np.array_equal(gradient.object, same.object)


@given(cells(), SEEDS)
@examples(30)
def test_what_friction_estimates_lack_is_linear_in_their_error_under_the_torque_that_is_sent(
    cell: RandomCell, seed: int
) -> None:
    """Friction of the true joints, sign(dq_r) Γ + F_v dq_r at the sent torque, less what the law gives for it."""
    rng = np.random.default_rng(seed)
    arm = with_friction(cell.arms[0], rng)
    joints = arm.offline.friction.joints
    n, truth = arm.model.n, nominal_of(arm, joints)
    believed = truth.arm.copy()
    believed[11 * n :] *= rng.uniform(0.0, 1.3, 5 * n)
    data = replace(adaptation(truth, friction=True, sticking=joints), smooth_rad_per_s=1e-9)
    terms, gradient = adaptive.torque(
        arm.model, arm.offline, data, Estimate(believed, truth.object), arm.q, arm.dq, cell.desired
    )
    columns = gradient.arm[11 * n :].reshape(5, n) / (arm.dq - terms.dq_ref)
    lacking = (columns * (truth.arm - believed)[11 * n :].reshape(5, n)).sum(axis=0)
    size = np.abs(terms.tau_cmd)
    left = np.array([j.breakaway_left(v) for j, v in zip(joints, arm.dq.tolist(), strict=True)])
    coulomb, viscous, breakaway, _, _, load, breakaway_load = np.array(joints).T
    bound = coulomb + load * size + (breakaway + breakaway_load * size) * left
    taken = np.sign(terms.dq_ref) * bound + viscous * terms.dq_ref
    assert_close(taken - terms.tau_friction, lacking, 1e-9)


@given(cells(), SEEDS)
@examples(30)
def test_friction_columns_are_spent_in_the_joints_and_never_on_the_object(cell: RandomCell, seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm = cell.arms[0]
    nominal = nominal_of(arm)
    n, estimate = arm.model.n, random_estimate(rng, nominal)
    frictionless = estimate.arm.copy()
    frictionless[11 * n :] = 0.0
    args = (arm.q, arm.dq, cell.desired)
    rough, _ = adaptive.torque(arm.model, arm.offline, adaptation(nominal, friction=True), estimate, *args)
    smooth, _ = adaptive.torque(
        arm.model, arm.offline, adaptation(nominal, friction=True), Estimate(frictionless, estimate.object), *args
    )
    viscous, coulomb = estimate.arm[11 * n : 13 * n].reshape(2, n)
    expected = viscous * rough.dq_ref + coulomb * np.tanh(rough.dq_ref / 0.05)
    assert_close(rough.tau_friction, expected, 1e-14)
    assert_close(rough.tau_cmd - smooth.tau_cmd, expected, 1e-12)
    assert np.array_equal(rough.wrench_cmd, smooth.wrench_cmd)
