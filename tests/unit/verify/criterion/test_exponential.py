"""Exponentials of a stack, and what held inputs add, against those of each matrix and of numbers, at every size."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm

from agent.control.models import Matrix
from agent.verify.criterion.exponential import exponential


def of_numbers(x: Matrix) -> tuple[list[float], list[float]]:
    """e^x and the integral of e^(sx) over s from 0 to 1 of numbers (K,)."""
    A = np.array(x)[:, None, None]
    F, G = exponential(A, np.ones_like(A))
    return F.ravel().tolist(), G.ravel().tolist()


@pytest.mark.parametrize("scale", [1e-8, 1e-3, 1.0, 30.0, 1e3])
def test_exponentials_of_a_stack_are_those_of_each(scale: float) -> None:
    random = np.random.default_rng(1)
    stack = scale * random.normal(size=(3, 9, 9)) / 9.0 - scale * np.eye(9)
    inputs = scale * random.normal(size=(3, 9, 4))
    for F, G, A, B in zip(*exponential(stack, inputs), stack, inputs, strict=True):
        with_inputs = expm(np.block([[A, B], [np.zeros((4, 13))]]))[:9, 9:]
        np.testing.assert_allclose(F, expm(A), rtol=1e-9, atol=1e-12 * np.abs(expm(A)).max())
        np.testing.assert_allclose(G, with_inputs, rtol=1e-9, atol=1e-12 * np.abs(with_inputs).max())


@pytest.mark.parametrize("sizes", [(0.1, 5.3, 10.7, 21.0, 43.0), (43.0, 0.1), (10.7,), (5.3, 5.3)])
def test_large_and_small_ones_of_a_stack_are_each_squared_as_often_as_they_need(sizes: tuple[float, ...]) -> None:
    for sign in (1.0, -1.0):
        x = sign * np.array(sizes)
        exponentials, integrals = of_numbers(x)
        assert exponentials == pytest.approx(np.exp(x).tolist(), rel=1e-13, abs=0.0)
        assert integrals == pytest.approx((np.expm1(x) / x).tolist(), rel=1e-13, abs=0.0)


def test_numbers_are_exact_to_rounding_up_to_where_they_are_squared_and_beyond() -> None:
    for x in (0.3, 0.999, 1.0, 1.001, 1.99, 2.0, -1.0, -1.99):
        (e,), (integral,) = of_numbers(np.array([x]))
        assert e == pytest.approx(math.exp(x), rel=2e-15, abs=0.0)
        assert integral == pytest.approx(math.expm1(x) / x, rel=2e-15, abs=0.0)


def test_what_a_column_adds_up_to_says_how_often_one_is_squared() -> None:
    """A column of norm 40, rows of norm 4: e^A of a nilpotent A is one and A."""
    A = np.zeros((11, 11))
    A[1:, 0] = 4.0
    F, G = exponential(A, np.eye(11))
    np.testing.assert_allclose(F, np.eye(11) + A, rtol=1e-14)
    np.testing.assert_allclose(G, np.eye(11) + 0.5 * A, rtol=1e-14)


def test_stacks_of_stacks_are_taken_too() -> None:
    random = np.random.default_rng(2)
    stack = random.normal(size=(3, 5, 2, 2)) * np.array([0.1, 1.0, 30.0])[:, None, None, None]
    inputs = random.normal(size=(3, 5, 2, 3))
    for F, G, A, B in zip(*exponential(stack, inputs), stack, inputs, strict=True):
        of_it = exponential(A, B)
        np.testing.assert_array_equal(F, of_it[0])
        np.testing.assert_array_equal(G, of_it[1])


def test_an_empty_stack_has_no_exponential() -> None:
    F, G = exponential(np.zeros((0, 3, 3)), np.zeros((0, 3, 2)))
    assert (F.shape, G.shape) == ((0, 3, 3), (0, 3, 2))
