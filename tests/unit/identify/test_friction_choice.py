"""Which friction a recording shows: what is worth a parameter, and which of shapes that are as good as another."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from agent.identify.friction import BREAKAWAY, BREAKAWAY_LOAD, FOLDS, LOAD, SHAPES, Choice, Columns, Shape, choose
from drivers.interface import Vector

SAMPLES = 250 * FOLDS


def columns(breakaway: dict[Shape, Vector]) -> Columns:
    """One joint's; of a shape that is not given, and of load, nothing that is in any torque here."""
    random = np.random.default_rng(1)
    drawn = {
        (key, shape): random.normal(size=(SAMPLES, 1))
        for key, shape in itertools.product((BREAKAWAY, BREAKAWAY_LOAD), SHAPES)
    } | {(LOAD, None): random.normal(size=(SAMPLES, 1))}
    return Columns(drawn | {(BREAKAWAY, shape): column[:, None] for shape, column in breakaway.items()})


def chosen(tau: Vector, friction: Columns) -> Choice:
    own = np.random.default_rng(2).normal(size=(SAMPLES, 1, 1))
    return choose(own, (tau + own[:, 0, 0])[:, None], np.ones((SAMPLES, 1), dtype=bool), friction, 1e4)


@pytest.mark.parametrize(("share", "taken"), [(0.012, ()), (0.2, (BREAKAWAY,))])
def test_a_parameter_must_take_a_fiftieth_of_what_is_left_over(share: float, taken: tuple[str, ...]) -> None:
    """Friction that is not there takes up to 1 % of it, of arms as shipped."""
    random = np.random.default_rng(3)
    sticks, rest = random.normal(size=SAMPLES), random.normal(size=SAMPLES)
    tau = np.sqrt(share) * sticks + np.sqrt(1.0 - share) * rest
    choice = chosen(tau, columns({SHAPES[4]: sticks}))
    assert choice.keys == taken
    assert choice.shape == (SHAPES[4] if taken else None)


def test_the_search_begins_at_the_shape_that_predicts_best() -> None:
    random = np.random.default_rng(4)
    sticks, rest, other = (random.normal(size=SAMPLES) for _ in range(3))
    choice = chosen(sticks + rest, columns({SHAPES[2]: sticks + 0.1 * other, SHAPES[6]: sticks}))
    assert choice.keys == (BREAKAWAY,)
    assert choice.shape == SHAPES[6]


def test_rivals_are_the_models_that_predict_as_well_and_no_others() -> None:
    """Load is in no torque here: with it breakaway predicts as well, and without breakaway nothing does."""
    random = np.random.default_rng(5)
    sticks, rest = random.normal(size=SAMPLES), random.normal(size=SAMPLES)
    choice = chosen(sticks + rest, columns({SHAPES[4]: sticks}))
    assert choice.keys == (BREAKAWAY,)
    assert [keys for keys, _ in choice.rivals] == [(BREAKAWAY, LOAD), (BREAKAWAY, BREAKAWAY_LOAD)]
