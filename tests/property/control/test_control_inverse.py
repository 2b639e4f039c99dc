"""Inverse of the task-space Jacobian, square and redundant, and the law on an arm with seven joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.control import known
from agent.control.inverse import SingularJacobian, invert_jacobian, pseudo_inverse
from agent.control.models import ArmModel
from tests.support.control import oracle
from tests.support.control.strategies import RandomCell, cells, examples, urdf_on_rail

SEEDS = st.integers(0, 2**32 - 1)


def random_inertia_matrix(rng: np.random.Generator, n: int) -> np.ndarray:
    A = rng.normal(size=(n, n))
    return A @ A.T + 0.1 * np.eye(n)


@given(SEEDS, st.sampled_from([(3, 3), (6, 6), (6, 7), (6, 9)]))
@examples(100)
def test_inverse_is_a_right_inverse(seed: int, shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(seed)
    J, B = rng.normal(size=shape), random_inertia_matrix(rng, shape[1])
    J_bar, sigma = invert_jacobian(J, B)
    scale = max(1.0, np.abs(J_bar).max() * np.abs(J).max())
    assert np.abs(J @ J_bar - np.eye(shape[0])).max() < 1e-12 * scale
    assert sigma == pytest.approx(1.0 / np.linalg.norm(J_bar), rel=1e-12)
    assert sigma <= np.linalg.svd(J, compute_uv=False)[-1] * (1 + 1e-9)


@given(SEEDS)
@examples(60)
def test_redundant_inverse_is_dynamically_consistent(seed: int) -> None:
    """Torques (I − Jᵀ J̄ᵀ) τ₀ do not accelerate the object: J B⁻¹ (I − Jᵀ J̄ᵀ) = 0."""
    rng = np.random.default_rng(seed)
    J, B = rng.normal(size=(6, 7)), random_inertia_matrix(rng, 7)
    J_bar, _ = invert_jacobian(J, B)
    leak = J @ np.linalg.solve(B, np.eye(7) - J.T @ J_bar.T)
    scale = np.abs(J).max() * np.abs(J_bar).max() * np.abs(np.linalg.inv(B)).max()
    assert np.abs(leak).max() < 1e-11 * max(1.0, scale)


@given(cells(planar=False), SEEDS)
@examples(30)
def test_an_arm_on_a_rail_applies_the_printed_wrench(cell: RandomCell, seed: int) -> None:
    """Seven joints: what reaches the object is u_i of the printed law with the redundant arm's M_i, C_i, g_i."""
    six = cell.arms[0]
    xml = urdf_on_rail(six.name)
    joints = ("rail", *six.model.joints)
    rotor = np.array([2.0, *six.model.model.armature])
    model = ArmModel(
        xml, joints, {}, six.T_world_base, "ee", six.T_object_ee, rotor, six.model.model.gravity.linear
    )  # fmt: skip
    assert model.n == 7
    rng = np.random.default_rng(seed)
    arm = replace(six, model=model, q=np.array([rng.uniform(-0.5, 0.5), *six.q]), dq=rng.normal(scale=0.5, size=7))
    u, s = oracle.task_wrench(arm, arm.q, arm.dq, cell.desired, cell.P)
    terms = known.torque(model, arm.offline, arm.q, arm.dq, cell.desired)
    scale = max(1.0, np.abs(u).max())
    assert np.abs(s.J_inv.T @ terms.tau_cmd - u).max() < 1e-9 * scale
    assert np.abs(np.array(terms.wrench_cmd) - u).max() < 1e-9 * scale


@pytest.mark.parametrize("n", [3, 6])
def test_a_singular_jacobian_is_refused(n: int) -> None:
    J = np.eye(n)
    J[n - 1, n - 1] = 0.0
    with pytest.raises(SingularJacobian):
        invert_jacobian(J, np.eye(n))


@pytest.mark.parametrize("n", [3, 6])
def test_a_jacobian_with_one_entry_that_is_no_number_is_refused(n: int) -> None:
    for place in range(n * n):
        J = np.random.default_rng(place).normal(size=(n, n))
        J.flat[place] = np.nan
        with pytest.raises(SingularJacobian):
            invert_jacobian(J, np.eye(n))


def test_the_inverse_of_a_square_jacobian_is_no_matter_of_inertia() -> None:
    J = np.random.default_rng(1).normal(size=(3, 3))
    assert np.allclose(invert_jacobian(J, np.full((3, 3), np.nan))[0] @ J, np.eye(3), atol=1e-12)


def test_a_redundant_jacobian_without_full_rank_is_refused() -> None:
    J = np.eye(6, 7)
    J[5, 5] = 0.0
    with pytest.raises(SingularJacobian):
        invert_jacobian(J, np.eye(7))


@examples(60)
@given(st.integers(0, 2**32 - 1), st.sampled_from(((3, 3), (6, 6), (3, 4), (6, 7))), st.booleans())
def test_the_pseudo_inverse_is_that_of_numpy_to_the_bit(seed: int, shape: tuple[int, int], singular: bool) -> None:
    J = np.random.default_rng(seed).normal(size=shape)
    if singular:
        J[-1] = 0.0  # a direction in which the arm cannot move at all
    assert pseudo_inverse(J).tobytes() == np.ascontiguousarray(np.linalg.pinv(J)).tobytes()
    assert np.isfinite(pseudo_inverse(J)).all()


@pytest.mark.parametrize(
    "sizes", [(1.0, 1.5e-15), (1e3, 1.5e-12), (1e3, 1e-14), (1.0, 1e-10, 1e-20), (1.0, 1e-15), (0.0, 0.0)], ids=str
)
def test_the_pseudo_inverse_takes_for_rounding_what_numpy_does(sizes: tuple[float, ...]) -> None:
    J = np.zeros((len(sizes), len(sizes) + 1))
    np.fill_diagonal(J, sizes)
    assert pseudo_inverse(J).tobytes() == np.ascontiguousarray(np.linalg.pinv(J)).tobytes()
