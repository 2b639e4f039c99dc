"""Structure of the dynamics (lemmas 1 and 2 of the paper) and of the grasp matrix (identities 1 and 2)."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from hypothesis import given

from agent.control.law import object_wrench, shift_to_ee
from tests.support.control import oracle
from tests.support.control.strategies import Holder, RandomCell, cells, examples


def skewness(A: np.ndarray, size: np.ndarray) -> float:
    """How far A is from A = −Aᵀ, against the largest number of `size` where that is above one."""
    return float(np.abs(A + A.T).max()) / max(1.0, float(np.abs(size).max()))


def rotated(R: np.ndarray, omega: np.ndarray, h: float) -> np.ndarray:
    """Attitude after turning with omega (world axes) for h."""
    return pin.exp3(omega * h) @ R


@given(cells())
@examples(40)
def test_object_inertia_rate_less_twice_coriolis_is_skew(cell: RandomCell) -> None:
    arm, R, omega = cell.arms[0], cell.T_world_object.rotation, cell.v_object[3:]
    now = oracle.object_dynamics(arm, R, omega)
    dM = oracle.rate_of(lambda h: oracle.object_dynamics(arm, rotated(R, omega, h), omega).M)
    assert skewness(dM - 2 * now.C, now.M) < 1e-10


@given(cells())
@examples(40)
def test_arm_inertia_rate_less_twice_coriolis_is_skew_in_joint_space(cell: RandomCell) -> None:
    """What the running law uses: B with reflected inertia, and the Christoffel C of pinocchio."""
    for arm in cell.arms:
        k = arm.model.evaluate(arm.q, arm.dq)
        dB = oracle.rate_of(lambda h, arm=arm: arm.model.inertia(arm.q + h * arm.dq))
        assert skewness(dB - 2 * k.C, dB) < 1e-8
        assert np.array_equal(k.B, k.B.T)


@given(cells())
@examples(40)
def test_arm_inertia_rate_less_twice_coriolis_is_skew_in_task_space(cell: RandomCell) -> None:
    for arm in cell.arms:

        def at(h: float, arm: Holder = arm) -> oracle.TaskSpace:
            return oracle.task_space(arm, arm.q + h * arm.dq, arm.dq, cell.P)

        dM = oracle.rate_of(lambda h: at(h).M)
        assert skewness(dM - 2 * at(0.0).C, dM) < 1e-7


@given(cells())
@examples(40)
def test_coupled_inertia_is_positive_definite_and_its_rate_less_twice_coriolis_is_skew(cell: RandomCell) -> None:
    R, omega = cell.T_world_object.rotation, cell.v_object[3:]
    dq = [a.dq for a in cell.arms]

    def at(h: float) -> oracle.Coupled:
        return oracle.coupled(cell, [a.q + h * a.dq for a in cell.arms], dq, rotated(R, omega, h), omega)

    now = at(0.0)
    assert np.abs(now.M - now.M.T).max() < 1e-12 * np.abs(now.M).max()
    assert np.linalg.eigvalsh(now.M)[0] > 0.0
    dM = oracle.rate_of(lambda h: at(h).M)
    assert skewness(dM - 2 * now.C, dM) < 1e-7


@given(cells())
@examples(40)
def test_grasp_matrix_identities(cell: RandomCell) -> None:
    """Gᵀ G̃ᵀ = [I … I] and Gᵀ G* = I (G* of the remark on internal forces)."""
    c = oracle.coupled(
        cell, [a.q for a in cell.arms], [a.dq for a in cell.arms], cell.T_world_object.rotation, cell.v_object[3:]
    )
    m, N = len(cell.P), len(cell.arms)
    inverses = [np.linalg.inv(s.J_O) for s in c.arms]
    G_tilde = np.zeros((m * N, m * N))
    for i, inverse in enumerate(inverses):
        G_tilde[m * i : m * (i + 1), m * i : m * (i + 1)] = inverse
    G_star = np.hstack(inverses).T / N
    assert np.abs(c.G.T @ G_tilde.T - np.hstack([np.eye(m)] * N)).max() < 1e-12
    assert np.abs(c.G.T @ G_star - np.eye(m)).max() < 1e-12


@given(cells())
@examples(40)
def test_shift_to_end_effector_is_the_inverse_transpose_of_the_grasp_jacobian(cell: RandomCell) -> None:
    wrench = np.array(cell.desired.a)
    for arm in cell.arms:
        k = arm.model.evaluate(arm.q, arm.dq)
        J_O = np.eye(6)
        J_O[:3, 3:] = oracle.skew(np.array(k.p_ee_object))
        found = np.array(shift_to_ee(k, tuple(wrench.tolist())))
        assert np.abs(found - np.linalg.inv(J_O).T @ wrench).max() < 1e-12


@given(cells())
@examples(40)
def test_object_wrench_is_the_object_dynamics_at_the_reference(cell: RandomCell) -> None:
    arm = cell.arms[0]
    k = arm.model.evaluate(arm.q, arm.dq)
    quat, v = np.array(k.quat_object), np.array(k.v_object)
    e = oracle.error_signals(arm, np.array(k.p_object), quat, v, cell.desired)
    o = oracle.object_dynamics(arm, cell.T_world_object.rotation, v[3:])
    found = object_wrench(arm.offline, k, e)
    expected = o.M @ e.dv_ref + o.C @ e.v_ref + o.g
    assert np.abs(np.array(found) - expected).max() < 1e-10 * max(1.0, np.abs(expected).max())
