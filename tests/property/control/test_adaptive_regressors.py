"""The regressors: torque and wrench are linear in the parameters, with the right matrices (identity 4)."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from hypothesis import given
from hypothesis import strategies as st

from agent.control.regressor import joint_regressor, object_regressor
from tests.support.control import oracle
from tests.support.control.adaptive_cells import nominal_of, random_body, random_estimate
from tests.support.control.strategies import RandomCell, cells, examples, random_joints, random_unit_quaternion

SEEDS = st.integers(0, 2**32 - 1)
S = oracle.skew


@given(cells(), SEEDS)
@examples(60)
def test_joint_regressor_times_parameters_is_the_slotine_li_torque(cell: RandomCell, seed: int) -> None:
    """Y_q θ = B ddq_r + C(q, dq) dq_r + g; the reflected rotor inertia belongs to its own column."""
    rng = np.random.default_rng(seed)
    for arm in cell.arms:
        n = arm.model.n
        q, (dq, dq_ref, ddq_ref) = random_joints(rng, arm.model), rng.normal(scale=3.0, size=(3, n))
        theta, model = nominal_of(arm).arm, arm.model.model
        data = model.createData()
        B = pin.crba(model, data, q).copy()
        expected = B @ ddq_ref + pin.computeCoriolisMatrix(model, data, q, dq) @ dq_ref
        expected = expected + pin.rnea(model, data, q, np.zeros(n), np.zeros(n))
        found = joint_regressor(arm.model, q, dq, dq_ref, ddq_ref) @ theta[: 10 * n] + theta[10 * n : 11 * n] * ddq_ref
        assert np.abs(found - expected).max() < 1e-11


@given(SEEDS)
@examples(100)
def test_object_regressor_is_newton_and_euler_when_the_reference_is_the_motion(seed: int) -> None:
    """Any parameters, any centre of mass; pinocchio's spatial algebra in the object's axes is the other side."""
    rng = np.random.default_rng(seed)
    theta, v, w, dv, dw = random_body(rng, 1.0), *rng.normal(size=(4, 3))
    found = regressor(v, w, v, w, dv, dw) @ theta
    body, twist = pin.Inertia.FromDynamicParameters(theta), pin.Motion(v, w)
    # the derivative of the twist's components in the world, seen from the body: dv is that of ṗ, not spatial
    spatial = pin.Motion(dv - np.cross(w, v), dw)
    expected = (body * spatial + twist.cross(body * twist)).vector
    assert np.abs(found - expected).max() < 1e-12


@given(cells(), SEEDS)
@examples(60)
def test_object_regressor_is_the_papers_object_dynamics_about_the_centre_of_mass(cell: RandomCell, seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm, (v, v_ref, dv_ref) = cell.arms[0], rng.normal(size=(3, 6))
    R = pin.Quaternion(random_unit_quaternion(rng)).matrix()
    o = oracle.object_dynamics(arm, R, v[3:])
    a = dv_ref[:3] - np.array(arm.offline.gravity)
    turned = (R.T @ x for x in (v[:3], v[3:], v_ref[:3], v_ref[3:], a, dv_ref[3:]))
    found = np.kron(np.eye(2), R) @ regressor(*turned) @ nominal_of(arm).object
    assert np.abs(found - (o.M @ dv_ref + o.C @ v_ref + o.g)).max() < 1e-12


@given(SEEDS)
@examples(60)
def test_object_inertia_rate_less_twice_coriolis_is_skew_symmetric_for_any_centre_of_mass(seed: int) -> None:
    """What the proof of theorem 2 needs of Y_O beside its value."""
    rng = np.random.default_rng(seed)
    theta, v, w = random_body(rng, 1.0), *rng.normal(size=(2, 3))
    zero = np.zeros(3)
    columns_C = [regressor(v, w, r[:3], r[3:], zero, zero) @ theta for r in np.eye(6)]
    columns_M = [regressor(zero, zero, zero, zero, r[:3], r[3:]) @ theta for r in np.eye(6)]
    C, M = np.stack(columns_C, axis=1), np.stack(columns_M, axis=1)
    W = np.kron(np.eye(2), S(w))
    dM = W @ M - M @ W  # M in world axes, momentarily those of the object
    N = dM - 2.0 * C
    assert np.abs(M - M.T).max() < 1e-15
    assert np.abs(N + N.T).max() < 1e-12


@given(cells(), SEEDS)
@examples(30)
def test_joint_regressor_does_not_depend_on_the_models_own_parameters(cell: RandomCell, seed: int) -> None:
    """An agent with a wrong model adapts along the same directions."""
    rng = np.random.default_rng(seed)
    arm = cell.arms[0]
    n = arm.model.n
    q, (dq, dq_ref, ddq_ref) = random_joints(rng, arm.model), rng.normal(size=(3, n))
    before = joint_regressor(arm.model, q, dq, dq_ref, ddq_ref)
    other = random_estimate(rng, nominal_of(arm)).arm
    for j in range(n):
        arm.model.model.inertias[j + 1] = pin.Inertia.FromDynamicParameters(other[10 * j : 10 * j + 10])
    assert np.array_equal(before, joint_regressor(arm.model, q, dq, dq_ref, ddq_ref))


def regressor(*vectors: np.ndarray) -> np.ndarray:
    return object_regressor(*(tuple(v.tolist()) for v in vectors))
