"""Unit quaternions, scalar first, against matrices and against pinocchio."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

from agent.control.quaternion import (
    Quat,
    angle_between,
    conjugate,
    cross,
    from_axis_angle,
    multiply,
    rotate,
    rotate_back,
    to_matrix,
)

SEEDS = range(25)


def random_quat(rng: np.random.Generator) -> Quat:
    v = rng.normal(size=4)
    return tuple((v / np.linalg.norm(v)).tolist())


def matrix(q: Quat) -> np.ndarray:
    return np.array(to_matrix(q)).reshape(3, 3)


@pytest.mark.parametrize("seed", SEEDS)
def test_product_is_composition_of_rotations(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b, c = (random_quat(rng) for _ in range(3))
    assert np.allclose(matrix(multiply(a, b)), matrix(a) @ matrix(b), atol=1e-14)
    assert multiply(multiply(a, b), c) == pytest.approx(multiply(a, multiply(b, c)), abs=1e-15)
    assert math.hypot(*multiply(a, b)) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("seed", SEEDS)
def test_conjugate_is_the_inverse(seed: int) -> None:
    a = random_quat(np.random.default_rng(seed))
    assert multiply(a, conjugate(a)) == pytest.approx((1.0, 0.0, 0.0, 0.0), abs=1e-15)
    assert np.allclose(matrix(conjugate(a)), matrix(a).T, atol=1e-15)


@pytest.mark.parametrize("seed", SEEDS)
def test_matrix_is_that_of_pinocchio_and_the_same_for_both_signs(seed: int) -> None:
    a = random_quat(np.random.default_rng(seed))
    assert np.allclose(matrix(a), pin.Quaternion(*a).matrix(), atol=1e-15)
    assert to_matrix(a) == to_matrix(tuple(-x for x in a))
    assert np.linalg.det(matrix(a)) == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize("seed", SEEDS)
def test_rotate_and_rotate_back_are_the_matrix_and_its_transpose(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, v = random_quat(rng), tuple(rng.normal(size=3).tolist())
    assert rotate(to_matrix(a), v) == pytest.approx(matrix(a) @ v, abs=1e-14)
    assert rotate_back(to_matrix(a), v) == pytest.approx(matrix(a).T @ v, abs=1e-14)


@pytest.mark.parametrize("seed", SEEDS)
def test_cross_is_the_vector_product(seed: int) -> None:
    a, b = np.random.default_rng(seed).normal(size=(2, 3))
    assert cross(tuple(a), tuple(b)) == pytest.approx(np.cross(a, b), abs=1e-15)


@pytest.mark.parametrize("angle", [-3.0, -0.5, 0.0, 1e-9, 0.3, math.pi])
def test_axis_and_angle(angle: float) -> None:
    axis = (0.36, 0.48, 0.8)
    assert np.allclose(matrix(from_axis_angle(axis, angle)), pin.AngleAxis(angle, np.array(axis)).matrix(), atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-10, 0.1, 1.5, 3.1, math.pi])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_angle_between_is_the_rotation_angle_for_both_signs(angle: float, sign: float) -> None:
    a = random_quat(np.random.default_rng(3))
    b = tuple(sign * x for x in multiply(from_axis_angle((0.0, 0.6, 0.8), angle), a))
    assert angle_between(a, b) == pytest.approx(angle, abs=1e-14)
    assert angle_between(b, a) == pytest.approx(angle, abs=1e-14)


def test_rate_of_a_quaternion_follows_the_propagation_rule() -> None:
    """dξ/dt = ½ E(ξ) ω with ω in world axes (`eq:propagation rule_1`), and ω = 2 Eᵀ dξ/dt."""
    rng = np.random.default_rng(7)
    quat, omega = random_quat(rng), rng.normal(size=3)
    speed, h = float(np.linalg.norm(omega)), 1e-6
    axis = tuple((omega / speed).tolist())
    after, before = (np.array(multiply(from_axis_angle(axis, s * speed * h), quat)) for s in (1.0, -1.0))
    eta, (x, y, z) = quat[0], quat[1:]
    E = np.array([[-x, -y, -z], [eta, z, -y], [-z, eta, x], [y, -x, eta]])
    rate = (after - before) / (2 * h)
    assert rate == pytest.approx(0.5 * E @ omega, abs=1e-9)
    assert 2 * E.T @ rate == pytest.approx(omega, abs=1e-8)
    assert np.allclose(E.T @ E, np.eye(3), atol=1e-15)
