"""Every analytic derivative of the law against central differences, and the frames of the model (identity 5)."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.control import errors
from agent.control.errors import Gains
from agent.control.trajectory import Desired
from tests.support.control import oracle
from tests.support.control.strategies import Holder, RandomCell, cells, examples, quaternion_of, quaternion_step

SEEDS = st.integers(0, 2**32 - 1)


def desired_after(d: Desired, h: float) -> Desired:
    """The desired motion h later, exact to second order in h."""
    v, a = np.array(d.v), np.array(d.a)
    p = np.array(d.p) + h * v[:3] + 0.5 * h * h * a[:3]
    quat = quaternion_step(d.quat, h * v[3:] + 0.5 * h * h * a[3:])
    return Desired(tuple(p.tolist()), quat, tuple((v + h * a).tolist()), d.a)


def errors_after(cell: RandomCell, gains: Gains, v: np.ndarray, h: float) -> errors.Errors:
    """Errors h later when the object moves with the constant twist v and the desired motion goes on."""
    p = cell.T_world_object.translation + h * v[:3]
    quat = quaternion_step(quaternion_of(cell.T_world_object), h * v[3:])
    return errors.evaluate(tuple(p.tolist()), quat, tuple(v.tolist()), desired_after(cell.desired, h), gains)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 2.0, math.pi])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_angle_of_an_attitude_error_is_that_of_either_quaternion_of_the_rotation(angle: float, sign: float) -> None:
    sine = sign * math.sin(0.5 * angle)
    found = errors.attitude_angle(sign * math.cos(0.5 * angle), (0.0, 0.6 * sine, -0.8 * sine))
    assert found == pytest.approx(angle, rel=1e-12, abs=0.0)


@given(cells(), SEEDS)
@examples(60)
def test_reference_acceleration_is_the_derivative_of_the_reference_velocity(cell: RandomCell, seed: int) -> None:
    gains = cell.arms[0].offline.gains
    v = np.random.default_rng(seed).normal(size=6)
    rate = oracle.rate_of(lambda h: np.array(errors_after(cell, gains, v, h).v_ref))
    found = np.array(errors_after(cell, gains, v, 0.0).dv_ref)
    assert np.abs(found - rate).max() < 1e-9 * max(1.0, np.abs(rate).max())


def test_near_the_desired_pose_a_displacement_counts_whole_in_the_errors_and_a_turn_half() -> None:
    still, unit = (0.0,) * 6, (1.0, 1.0, 1.0)
    p, quat = (0.1, -0.2, 0.3), (0.5, 0.5, -0.5, 0.5)
    gains, small = Gains(unit, unit, unit, unit, (1.0,) * 6), 1e-6
    for axis, part in enumerate(errors.HALF_ANGLE):
        moved = small * np.eye(6)[axis]
        away = tuple((np.array(p) + moved[:3]).tolist())
        found = errors.evaluate(away, quaternion_step(quat, moved[3:]), still, Desired(p, quat, still, still), gains).e
        np.testing.assert_allclose(found, part * moved, atol=1e-6 * small)


@given(cells(), SEEDS)
@examples(60)
def test_error_rates_are_those_of_the_error_dynamics(cell: RandomCell, seed: int) -> None:
    """`eq:error_dynamics`, seen through a unit gain: then v̇_d − v̇_r is the derivative of e."""
    unit = (1.0, 1.0, 1.0)
    gains = Gains(unit, unit, unit, unit, (1.0,) * 6)
    v = np.random.default_rng(seed).normal(size=6)
    de = oracle.rate_of(lambda h: np.array(errors_after(cell, gains, v, h).e))
    found = np.array(cell.desired.a) - np.array(errors_after(cell, gains, v, 0.0).dv_ref)
    assert np.abs(found - de).max() < 1e-10


@given(cells(), SEEDS)
@examples(30)
def test_rate_gains_act_on_the_acceleration_only(cell: RandomCell, seed: int) -> None:
    gains = cell.arms[0].offline.gains
    slower = Gains(gains.k_p, gains.k_eps, (5.0, 2.0, 40.0), (40.0, 3.0, 1.0), gains.k_v)
    v = np.random.default_rng(seed).normal(size=6)
    one, two = errors_after(cell, gains, v, 0.0), errors_after(cell, slower, v, 0.0)
    assert one.v_ref == two.v_ref
    a = np.array(cell.desired.a)
    ratio = np.array([*slower.k_p_rate, *slower.k_eps_rate]) / np.array([*gains.k_p_rate, *gains.k_eps_rate])
    assert np.allclose(np.array(two.dv_ref) - a, ratio * (np.array(one.dv_ref) - a), rtol=1e-12, atol=1e-12)


@given(cells())
@examples(40)
def test_attitude_error_is_the_rotation_from_actual_to_desired(cell: RandomCell) -> None:
    """e_ξ = ξ_d ⊗ ξ*, so turning the object by e_ξ brings it to the desired attitude."""
    quat = quaternion_of(cell.T_world_object)
    e_eta, e_eps = errors.attitude_error(quat, cell.desired.quat)
    turned = oracle.quaternion_product(np.array([e_eta, *e_eps]), np.array(quat))
    assert np.abs(turned - np.array(cell.desired.quat)).max() < 1e-14


@given(cells())
@examples(40)
def test_object_jacobian_rate_is_the_derivative_of_the_object_jacobian(cell: RandomCell) -> None:
    for arm in cell.arms:
        k = arm.model.evaluate(arm.q, arm.dq)
        dJ = oracle.rate_of(lambda h, arm=arm: arm.model.evaluate(arm.q + h * arm.dq, arm.dq).J)
        assert np.abs(k.dJ - dJ).max() < 1e-9 * max(1.0, np.abs(dJ).max())
        assert np.array_equal(k.J, arm.model.jacobian(arm.q))


@given(cells())
@examples(40)
def test_grasp_jacobian_rate_of_the_oracle_is_its_derivative(cell: RandomCell) -> None:
    arm = cell.arms[0]
    dJ_O = oracle.rate_of(lambda h: oracle.task_space(arm, arm.q + h * arm.dq, arm.dq, cell.P).J_O)
    assert np.abs(oracle.task_space(arm, arm.q, arm.dq, cell.P).dJ_O - dJ_O).max() < 1e-10


@given(cells())
@examples(40)
def test_object_twist_is_in_world_axes_at_the_object_origin(cell: RandomCell) -> None:
    """LOCAL_WORLD_ALIGNED: the translation rate is that of the frame's origin, the rotation rate in world axes."""
    for arm in cell.arms:
        R = arm.model.object_pose(arm.q).rotation

        def pose(h: float, arm: Holder = arm, R: np.ndarray = R) -> np.ndarray:
            T = arm.model.object_pose(arm.q + h * arm.dq)
            return np.concatenate([T.translation, pin.log3(T.rotation @ R.T)])

        found = np.array(arm.model.evaluate(arm.q, arm.dq).v_object)
        assert np.abs(found - oracle.rate_of(pose)).max() < 1e-9


@given(cells())
@examples(40)
def test_all_arms_see_the_same_object(cell: RandomCell) -> None:
    for arm in cell.arms:
        k = arm.model.evaluate(arm.q, arm.dq)
        assert np.abs(np.array(k.p_object) - cell.T_world_object.translation).max() < 1e-12
        assert np.abs(np.array(k.v_object) - cell.v_object).max() < 1e-10
        R = pin.Quaternion(*k.quat_object).matrix()
        assert np.abs(R - cell.T_world_object.rotation).max() < 1e-12
        T_world_ee = cell.T_world_object * arm.T_object_ee
        assert np.abs(np.array(k.p_ee_object) - cell.T_world_object.translation + T_world_ee.translation).max() < 1e-12


@given(cells())
@examples(40)
def test_a_planar_arm_moves_the_object_only_in_its_task_space(cell: RandomCell) -> None:
    for arm in cell.arms:
        P, k = arm.model.task_basis, arm.model.evaluate(arm.q, arm.dq)
        assert np.abs(P @ P.T - np.eye(len(P))).max() < 1e-14
        assert np.abs(P.T @ P @ np.array(k.v_object) - np.array(k.v_object)).max() < 1e-12


@given(cells())
@examples(40)
def test_joint_dynamics_terms_are_those_of_inverse_dynamics(cell: RandomCell) -> None:
    """B a + C dq + g is pinocchio's recursive Newton–Euler, plus the reflected inertia that it includes."""
    for arm in cell.arms:
        k, model = arm.model.evaluate(arm.q, arm.dq), arm.model.model
        a = np.cos(np.arange(arm.model.n))
        torque = pin.rnea(model, model.createData(), arm.q, arm.dq, a)
        assert np.abs(k.B @ a + k.C @ arm.dq + k.g - torque).max() < 1e-10
        assert np.array_equal(np.diag(k.B), np.diag(arm.model.inertia(arm.q)))
        assert np.all(np.diag(k.B) > model.armature)
