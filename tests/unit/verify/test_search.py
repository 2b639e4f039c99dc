"""The climb that `coop tune` searches with: to a known top, along a bound, and back from where nothing is allowed."""

from __future__ import annotations

import numpy as np
import pytest

from agent.verify.search import Miss, climb
from drivers.interface import Vector


def inside(x: Vector, _enough: float) -> Miss:
    """Within the unit ball."""
    return Miss(float(np.linalg.norm(x)) - 1.0, "ball")


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("begin", [np.zeros(4), np.full(4, 3.0)])
def test_it_finds_the_highest_point_of_a_ball_from_inside_and_from_outside(begin: Vector, seed: int) -> None:
    slope = np.array([1.0, 2.0, -1.0, 0.5])
    found = climb(begin, lambda x: float(slope @ x), inside, range(2000), np.random.default_rng(seed))
    assert found.miss.excess <= 0.0
    assert float(slope @ found.x) > 0.98 * float(np.linalg.norm(slope))


def test_where_nothing_is_allowed_it_ends_where_least_is_missed() -> None:
    def never(x: Vector, _enough: float) -> Miss:
        return Miss(1.0 + float(np.sum((x - 2.0) ** 2)), "never")

    found = climb(np.zeros(3), lambda _: 0.0, never, range(2000), np.random.default_rng(0))
    assert found.miss.excess == pytest.approx(1.0, abs=1e-3)
    assert found.x == pytest.approx([2.0, 2.0, 2.0], abs=0.05)


def test_the_same_seed_climbs_the_same_way() -> None:
    a, b = (
        climb(np.zeros(3), lambda x: float(x.sum()), inside, range(100), np.random.default_rng(3)) for _ in range(2)
    )
    assert (a.x == b.x).all()


def test_without_tries_it_stays() -> None:
    assert (climb(np.ones(2), lambda x: float(x.sum()), inside, [], np.random.default_rng(0)).x == 1.0).all()
