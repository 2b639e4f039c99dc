"""How near balls come on ways that are known by their places: figures that can be worked out by hand, m."""

from __future__ import annotations

import math
from collections.abc import Sequence

import coal
import numpy as np
import pinocchio as pin
import pytest

from agent.verify.collision import way as module
from agent.verify.collision.way import TABLE, Nearest, Shape, Way

R_BALL, R_LARGE, TABLE_Z = 0.01, 0.02, 0.2
NEAR = 0.06  # between the surfaces of two balls that stand still
Place = tuple[float, float, float]


def ball(radius: float = R_BALL) -> Shape:
    return Shape("left", "a ball", 1, coal.Sphere(radius), radius, pin.SE3.Identity())


def table() -> Shape:
    return Shape(TABLE, TABLE, 0, coal.Halfspace(np.array([0.0, 0.0, 1.0]), TABLE_Z), 1e3, pin.SE3.Identity())


def turned(angle: float) -> np.ndarray:
    return pin.exp3(np.array([0.0, 0.0, angle]))


def way(*moves: tuple[Shape, Sequence[Place]], turns: dict[int, Sequence[float]] | None = None) -> Way:
    """Shapes with their places; turns: by number of the shape its angles there."""
    p = np.array([places for _, places in moves]).transpose(1, 0, 2)
    R = np.tile(np.eye(3), (*p.shape[:2], 1, 1))
    for i, angles in (turns or {}).items():
        R[:, i] = [turned(angle) for angle in angles]
    return Way([shape for shape, _ in moves], R, p)


def still(x: float, y: float = 0.0, z: float = 1.0) -> tuple[Shape, list[Place]]:
    return ball(), [(x, y, z)] * 3


def passing() -> Way:
    """Two that stand still, NEAR each other, and one that passes the last one, farther from it at each place."""
    return way(still(0.0), still(NEAR + 2 * R_BALL), still(9.0), (ball(), [(9.1, y, 1.0) for y in (-0.04, 0.05, 0.06)]))


AT_PLACES, THEN, AT_LAST = (math.hypot(0.1, y) - 2 * R_BALL for y in (0.04, 0.05, 0.06))


def test_between_places_a_shape_may_be_nearer_by_half_of_its_way() -> None:
    found = passing().nearest([(0, 1), (2, 3)])
    assert found is not None
    assert (found.pair, found.place) == ((2, 3), 0)
    assert found.distance_m == pytest.approx(AT_PLACES - 0.045)
    assert found.distance_m < NEAR < AT_PLACES
    back = passing().nearest([(3, 2), (0, 1)])
    assert back is not None
    assert back.distance_m == pytest.approx(found.distance_m), "whichever of them moves"


def test_at_the_places_alone_it_is_where_it_is() -> None:
    assert passing().least([(0, 1), (2, 3)]) == Nearest(pytest.approx(NEAR), (0, 1), 0)
    assert passing().least([(2, 3)]) == Nearest(pytest.approx(AT_PLACES), (2, 3), 0)
    assert passing().first([(0, 1), (2, 3)]) == pytest.approx([NEAR, AT_PLACES])
    np.testing.assert_allclose(
        passing().distances([(2, 3), (0, 1)]).T,
        [[AT_PLACES, THEN, AT_LAST], [NEAR] * 3],
    )


def test_no_more_distances_are_asked_for_than_can_be_the_least(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, int]] = []
    distance = Way._distance

    def counted(self: Way, pair: tuple[int, int], place: int) -> float:
        asked.append(pair)
        return distance(self, pair, place)

    monkeypatch.setattr(Way, "_distance", counted)
    passing().nearest([(0, 1), (2, 3)])
    assert asked == [(2, 3)]
    asked.clear()
    passing().least([(0, 1), (2, 3)])
    assert set(asked) == {(0, 1)}


def test_a_shape_is_called_by_its_arm_and_link_and_the_table_by_its_name() -> None:
    assert (ball().label, table().label, ball().holds) == ("left a ball", "table", False)


def test_without_pairs_there_is_no_distance() -> None:
    assert passing().nearest([]) is None
    assert passing().least([]) is None
    assert passing().first([]) == []


def test_the_last_step_counts_too() -> None:
    moves = [(9.1, -1.0, 1.0), (9.1, -0.05, 1.0), (9.1, 0.05, 1.0)]
    found = way(still(0.0), still(NEAR + 2 * R_BALL), still(9.0), (ball(), moves)).nearest([(0, 1), (2, 3)])
    assert found is not None
    assert (found.pair, found.place) == ((2, 3), 1), "between two steps the longer one counts"
    assert found.distance_m == pytest.approx(THEN - 0.5 * 0.95)
    found = way(still(9.0), (ball(), [(9.1, -1.0, 1.0), (9.1, -0.9, 1.0), (9.1, -0.05, 1.0)])).nearest([(0, 1)])
    assert found == Nearest(pytest.approx(THEN - 0.5 * 0.85), (0, 1), 2)


@pytest.mark.parametrize("gap", [0.04, NEAR - 0.001])
def test_a_ball_above_the_table_is_as_near_as_its_surface_is(gap: float) -> None:
    above = still(3.0, z=TABLE_Z + gap + R_BALL)
    one = way(still(0.0), still(NEAR + 2 * R_BALL), above, (table(), [(0.0, 0.0, 0.0)] * 3))
    for found in (one.nearest([(0, 1), (2, 3)]), one.least([(0, 1), (2, 3)])):
        assert found == Nearest(pytest.approx(gap), (2, 3), 0)
    np.testing.assert_allclose(one._balls([(0, 1), (2, 3)]), [[NEAR, gap]] * 3)


def test_what_turns_together_stays_as_far_apart_as_it_is() -> None:
    """As parts of one link do that turns about an axis far away."""
    angles = np.linspace(0.0, 3.0, 60).tolist()
    legs = [(math.cos(a), math.sin(a)) for a in angles]
    at = [[(r * c, r * s, 1.0) for c, s in legs] for r in (1.0, 1.0 + 2 * R_BALL + NEAR)]
    found = way((ball(), at[0]), (ball(), at[1]), turns={0: angles, 1: angles}).nearest([(0, 1)])
    assert found is not None
    assert found.distance_m == pytest.approx(NEAR, abs=1e-7)
    straight = [[(x + r, x, 1.0) for x in (0.0, 0.1, 0.3)] for r in (0.0, 2 * R_BALL + NEAR)]
    found = way((ball(), straight[0]), (ball(), straight[1])).nearest([(0, 1)])
    assert found is not None
    assert found.distance_m == pytest.approx(NEAR)


def test_half_a_turn_is_the_largest_there_is() -> None:
    one, other = still(0.0), still(NEAR + 2 * R_BALL)
    both = Way([one[0], other[0]], np.tile(np.eye(3), (60, 2, 1, 1)), np.array([[one[1][0], other[1][0]]] * 60))
    for k, axis in enumerate(np.random.default_rng(1).normal(size=(59, 3))):
        both.R[k + 1, 1] = both.R[k, 1] @ pin.exp3(math.pi * axis / np.linalg.norm(axis))
    found = both.nearest([(0, 1)])
    assert found is not None
    assert found.distance_m == pytest.approx(NEAR - 0.5 * math.pi * R_BALL, abs=1e-7)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_shape_that_turns_sweeps_as_far_as_its_radius(order: tuple[int, int]) -> None:
    """The smaller one as seen from the larger one, or each by itself, whichever says more."""
    angles, between = (0.0, 0.2, 0.4, 0.6), 0.1 - R_BALL - R_LARGE
    shapes = (ball(R_LARGE), [(0.0, 0.0, 1.0)] * 4), (ball(), [(0.1, 0.0, 1.0)] * 4)
    small = way(*shapes, turns={1: angles}).nearest([order])
    assert small is not None
    assert small.distance_m == pytest.approx(between - 0.5 * 0.2 * R_BALL)
    large = way(*shapes, turns={0: angles}).nearest([order])
    assert large is not None
    no_less = 0.5 * math.pi * 2.0 * math.sqrt(2.0) * math.sin(0.1)  # than the angle
    assert large.distance_m == pytest.approx(between - 0.5 * no_less * R_LARGE)
    alike = [(ball(), places) for _, places in shapes]
    seen_from_first = 0.5 * (0.2 if order == (0, 1) else no_less) * R_BALL
    assert way(*alike, turns={1: angles}).nearest([order]) == Nearest(
        pytest.approx(0.1 - 2 * R_BALL - seen_from_first), order, pytest.approx(2, abs=2)
    )


def test_how_far_a_shape_has_gone_adds_up_from_the_first_place() -> None:
    one = way((ball(), [(0.0, 0.0, 1.0), (0.3, 0.4, 1.0), (0.3, 0.4, 1.0)]), (table(), [(0.0, 0.0, 0.0)] * 3))
    np.testing.assert_allclose(one.gone, [[0.0, 0.5, 0.5], [0.0, 0.0, 0.0]])
    round_itself = way((ball(), [(0.0, 0.0, 1.0)] * 3), turns={0: (0.0, 0.2, 0.4)})
    assert round_itself.gone[0, 2] == pytest.approx(2 * 0.44355 * R_BALL, rel=1e-4)
    assert round_itself.gone[0, 2] > 0.4 * R_BALL, "no less than the way on the arc"


@pytest.mark.parametrize("few", [1, 2, 7, 512])
def test_all_pairs_are_looked_at_however_few_are_put_in_order_first(few: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "AT_FIRST", few)
    bound = np.random.default_rng(few).permutation(300).reshape(100, 3).astype(float)
    turn = list(module._in_turn(bound))
    assert [bound[place] for place in turn] == list(range(300))
