"""The running law against the paper's printed form, and what follows from it (identities 3 and 7)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.control import errors, known
from agent.control.friction import Friction, JointFriction
from agent.control.inverse import SingularJacobian
from tests.support.control import oracle
from tests.support.control.strategies import (
    Holder,
    RandomCell,
    cells,
    examples,
    quaternion_of,
    random_joints,
    with_friction,
    with_internal_wrenches,
)

SEEDS = st.integers(0, 2**32 - 1)


def assert_close(found: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    """Largest difference, relative to the largest number where that is above one."""
    scale = max(1.0, float(np.abs(expected).max()))
    assert float(np.abs(np.asarray(found) - expected).max()) <= tolerance * scale


@given(cells(), SEEDS)
@examples(90)
def test_joint_space_law_is_the_printed_task_space_law(cell: RandomCell, seed: int) -> None:
    """About 1000 states, planar and six-dimensional: four for every arm of ninety cells."""
    rng = np.random.default_rng(seed)
    for arm in with_internal_wrenches(cell, seed).arms:
        for _ in range(4):
            q, dq = random_joints(rng, arm.model), rng.normal(scale=1.0, size=arm.model.n)
            u, s = oracle.task_wrench(arm, q, dq, cell.desired, cell.P)
            terms = known.torque(arm.model, arm.offline, q, dq, cell.desired)
            assert_close(terms.tau_cmd, s.J.T @ u, 1e-9)
            assert_close(cell.P @ np.array(terms.wrench_cmd), u, 1e-9)


@given(cells(), SEEDS)
@examples(60)
def test_errors_are_those_of_the_paper(cell: RandomCell, seed: int) -> None:
    arm, v = cell.arms[0], np.random.default_rng(seed).normal(size=6)
    quat = quaternion_of(cell.T_world_object)
    found = errors.evaluate(
        tuple(cell.T_world_object.translation.tolist()), quat, tuple(v.tolist()), cell.desired, arm.offline.gains
    )
    expected = oracle.error_signals(arm, cell.T_world_object.translation, np.array(quat), v, cell.desired)
    for name in ("e_p", "e_eta", "e_eps", "e", "v_ref", "dv_ref", "e_v"):
        assert_close(getattr(found, name), np.asarray(getattr(expected, name)), 1e-12)


@given(cells(), SEEDS)
@examples(40)
def test_sum_over_agents_is_the_coupled_law(cell: RandomCell, seed: int) -> None:
    """`eq:control_3`; internal forces must not appear in it."""
    cell = with_internal_wrenches(cell, seed)
    P, R = cell.P, cell.T_world_object.rotation
    c = oracle.coupled(cell, [a.q for a in cell.arms], [a.dq for a in cell.arms], R, cell.v_object[3:])
    terms = [known.torque(a.model, a.offline, a.q, a.dq, cell.desired) for a in cell.arms]
    u = np.concatenate([P @ np.array(t.wrench_cmd) for t in terms])
    k_v = np.sum([a.offline.gains.k_v for a in cell.arms], axis=0)
    e = terms[0].errors
    feedback = P @ (-k_v * np.array(e.e_v) - np.array(e.e))
    expected = c.M @ P @ np.array(e.dv_ref) + c.C @ P @ np.array(e.v_ref) + c.g + feedback
    assert_close(c.G.T @ u, expected, 1e-9)


@given(cells(), SEEDS)
@examples(40)
def test_lyapunov_shares_sum_to_the_lyapunov_function(cell: RandomCell, seed: int) -> None:
    R = cell.T_world_object.rotation
    c = oracle.coupled(cell, [a.q for a in cell.arms], [a.dq for a in cell.arms], R, cell.v_object[3:])
    e = oracle.error_signals(
        cell.arms[0],
        cell.T_world_object.translation,
        np.array(quaternion_of(cell.T_world_object)),
        cell.v_object,
        cell.desired,
    )
    shares = [known.torque(a.model, a.offline, a.q, a.dq, cell.desired).lyapunov for a in cell.arms]
    assert sum(shares) == pytest.approx(oracle.lyapunov(e, c.M, cell.P), rel=1e-9)
    assert min(shares) >= 0.0


@given(cells(), SEEDS)
@examples(40)
def test_torque_is_the_sum_of_its_named_terms(cell: RandomCell, seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm = with_friction(with_internal_wrenches(cell, seed).arms[0], rng)
    t = known.torque(arm.model, arm.offline, arm.q, arm.dq, cell.desired)
    assert not t.tau_adaptive.any()
    assert not t.tau_posture.any()
    total = t.tau_inertia + t.tau_coriolis + t.tau_gravity + t.tau_feedback + t.tau_object
    assert_close(total + t.tau_internal + t.tau_friction, t.tau_cmd, 1e-12)


@given(cells(), SEEDS)
@examples(40)
def test_friction_feedforward_never_enters_the_wrench(cell: RandomCell, seed: int) -> None:
    """Friction is spent inside the joints, on top of the law's torque."""
    plain = cell.arms[0]
    rubbed = with_friction(plain, np.random.default_rng(seed))
    before = known.torque(plain.model, plain.offline, plain.q, plain.dq, cell.desired)
    after = known.torque(rubbed.model, rubbed.offline, plain.q, plain.dq, cell.desired)
    assert after.wrench_cmd == before.wrench_cmd
    friction = rubbed.offline.friction
    sign = np.tanh(before.dq_ref / friction.smooth_rad_per_s)
    coulomb, viscous, breakaway, speed, exponent, load, breakaway_load = np.array(friction.joints).T
    left = np.exp(-((np.abs(plain.dq) / speed) ** exponent))
    bound = coulomb + breakaway * left + (load + breakaway_load * left) * np.abs(after.tau_cmd)
    assert_close(after.tau_cmd - before.tau_cmd, sign * bound + viscous * before.dq_ref, 1e-9)


@given(cells())
@examples(5)
def test_friction_of_joints_that_only_glide_is_that_of_the_reference(cell: RandomCell) -> None:
    arm = cell.arms[0]
    friction = Friction((JointFriction(0.08, 0.03),) * arm.model.n, 0.05)
    found = known.torque(arm.model, replace(arm.offline, friction=friction), arm.q, arm.dq, cell.desired)
    assert found.tau_friction.tolist() == friction.gliding(found.dq_ref.tolist())
    without = known.torque(arm.model, arm.offline, arm.q, arm.dq, cell.desired)
    assert_close(found.tau_cmd, without.tau_cmd + found.tau_friction, 1e-12)
    assert found.wrench_cmd == without.wrench_cmd


@given(cells(), SEEDS)
@examples(40)
def test_virtual_work_of_joints_and_end_effector_agree(cell: RandomCell, seed: int) -> None:
    """δqᵀ τ = δxᵀ u for every joint displacement, with the end-effector Jacobian."""
    rng = np.random.default_rng(seed)
    for arm in with_internal_wrenches(cell, seed).arms:
        terms = known.torque(arm.model, arm.offline, arm.q, arm.dq, cell.desired)
        dq = rng.normal(size=arm.model.n)
        model, data = arm.model.model, arm.model.model.createData()
        J = pin.computeFrameJacobian(model, data, arm.q, arm.model.ee_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        work = float(dq @ terms.tau_cmd)
        assert np.array(terms.wrench_cmd) @ J @ dq == pytest.approx(work, rel=1e-9, abs=1e-9)


@given(cells())
@examples(40)
def test_both_signs_of_the_desired_quaternion_give_the_same_torque(cell: RandomCell) -> None:
    """ξ and −ξ are one attitude: the law has no preference, so it cannot unwind."""
    quat = cell.desired.quat
    other = cell.desired._replace(quat=(-quat[0], -quat[1], -quat[2], -quat[3]))
    for arm in cell.arms:
        one = known.torque(arm.model, arm.offline, arm.q, arm.dq, cell.desired)
        two = known.torque(arm.model, arm.offline, arm.q, arm.dq, other)
        assert one.errors.e_eta == -two.errors.e_eta
        assert np.array_equal(one.tau_cmd, two.tau_cmd)
        assert one.lyapunov == two.lyapunov


@given(cells())
@examples(40)
def test_sigma_min_is_a_lower_bound_of_the_smallest_singular_value(cell: RandomCell) -> None:
    for arm in cell.arms:
        found = known.torque(arm.model, arm.offline, arm.q, arm.dq, cell.desired).sigma_min
        true = np.linalg.svd(arm.model.jacobian(arm.q), compute_uv=False)[-1]
        assert true / np.sqrt(arm.model.n) <= found * (1 + 1e-12)
        assert found <= true * (1 + 1e-12)


@given(cells(planar=True))
@examples(20)
def test_a_stretched_arm_is_reported_as_singular(cell: RandomCell) -> None:
    arm = cell.arms[0]
    data = arm.model.model.createData()
    pin.framesForwardKinematics(arm.model.model, data, np.zeros(3))
    shoulder, elbow, wrist = (data.oMi[j].translation for j in (1, 2, 3))
    axis = data.oMi[2].rotation @ np.array([0.0, 1.0, 0.0])
    bend = math.atan2(axis @ np.cross(elbow - shoulder, wrist - elbow), (elbow - shoulder) @ (wrist - elbow))
    assert _reported_sigma(arm, np.array([0.3, -bend, 0.2]), cell) < 1e-9
    assert _reported_sigma(arm, np.array([0.3, 0.8 - bend, 0.2]), cell) > 1e-3


def _reported_sigma(arm: Holder, q: np.ndarray, cell: RandomCell) -> float:
    try:
        return known.torque(arm.model, arm.offline, q, np.zeros(3), cell.desired).sigma_min
    except SingularJacobian:
        return 0.0
