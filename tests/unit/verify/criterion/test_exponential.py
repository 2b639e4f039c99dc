"""Exponentials of a stack, against those of each matrix and of numbers, at every size."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm

from agent.verify.criterion.exponential import exponential


@pytest.mark.parametrize("scale", [1e-8, 1e-3, 1.0, 30.0, 1e3])
def test_exponentials_of_a_stack_are_those_of_each(scale: float) -> None:
    stack = scale * np.random.default_rng(1).normal(size=(3, 9, 9)) / 9.0 - scale * np.eye(9)
    for found, A in zip(exponential(stack), stack, strict=True):
        assert found == pytest.approx(expm(A), rel=1e-9, abs=1e-12 * np.abs(expm(A)).max())


@pytest.mark.parametrize("sizes", [(0.1, 5.3, 10.7, 21.0, 43.0), (43.0, 0.1), (10.7,), (5.3, 5.3)])
def test_large_and_small_ones_of_a_stack_are_each_squared_as_often_as_they_need(sizes: tuple[float, ...]) -> None:
    for sign in (1.0, -1.0):
        found = exponential(sign * np.array(sizes)[:, None, None])
        assert found.ravel().tolist() == pytest.approx([math.exp(sign * size) for size in sizes], rel=1e-13)


def test_what_a_column_adds_up_to_says_how_often_one_is_squared() -> None:
    """A column of norm 40, rows of norm 4: e^A of a nilpotent A is one and A."""
    A = np.zeros((11, 11))
    A[1:, 0] = 4.0
    np.testing.assert_allclose(exponential(A), np.eye(11) + A, rtol=1e-14)


def test_stacks_of_stacks_are_taken_too() -> None:
    stack = np.random.default_rng(2).normal(size=(3, 5, 2, 2)) * np.array([0.1, 1.0, 30.0])[:, None, None, None]
    for found, A in zip(exponential(stack), stack, strict=True):
        np.testing.assert_array_equal(found, exponential(A))


def test_an_empty_stack_has_no_exponential() -> None:
    assert exponential(np.zeros((0, 3, 3))).shape == (0, 3, 3)
