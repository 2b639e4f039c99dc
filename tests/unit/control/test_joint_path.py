"""Ways of the joints: where they begin and end, how fast and how smooth they are, and from where they can be taken."""

from __future__ import annotations

import numpy as np
import pytest

from agent.control.joint_path import JointPath, Journey, Leg, straight, timed
from agent.control.life import Life

REST, BEFORE, GRASP = np.array([-1.8, 1.5, 0.8]), np.array([-0.6, 1.0, -0.3]), np.array([-0.3, 0.7, -0.4])
KNOTS = np.array([BEFORE, 0.5 * (BEFORE + GRASP) + [0.02, -0.03, 0.01], GRASP])
SPEED, EASE = 0.6, 0.8


def path() -> JointPath:
    return JointPath((straight(REST, BEFORE, SPEED, 1.0), timed(KNOTS, SPEED, 1.0)))


def journeys() -> list[Journey]:
    middle = path().at(2.0).q + np.array([0.05, -0.02, 0.0])
    return [
        Journey(path(), q, forward, EASE)
        for q, forward in ((REST, True), (GRASP, False), (middle, True), (middle, False), (REST + 0.1, True))
    ]


def derivative(f: object, t: float, h: float = 1e-5) -> np.ndarray:  # type: ignore[type-arg]
    return (f(t + h) - f(t - h)) / (2.0 * h)  # type: ignore[operator, no-any-return]


def test_a_path_begins_and_ends_at_rest_and_stops_at_the_place_before_the_grasp() -> None:
    p = path()
    for s, q in ((-1.0, REST), (0.0, REST), (p.legs[0].seconds, BEFORE), (p.seconds, GRASP), (p.seconds + 9.0, GRASP)):
        at = p.at(s)
        assert np.allclose(at.q, q, atol=1e-12)
        assert not at.dq.any()
        assert not at.ddq.any()


def test_a_leg_goes_through_its_knots_with_continuous_acceleration() -> None:
    leg = timed(KNOTS, SPEED, 1.0)
    assert np.allclose(leg.at(0.5 * leg.seconds).q, KNOTS[1])
    before, after = (leg.at(0.5 * leg.seconds + d).ddq for d in (-1e-6, 1e-6))
    assert np.allclose(before, after, atol=1e-4)


@pytest.mark.parametrize("journey", journeys(), ids=str)
def test_speeds_are_derivatives_of_places_and_accelerations_of_speeds(journey: Journey) -> None:
    for t in np.linspace(0.05, journey.seconds() - 0.05, 37):
        at = journey.at(float(t))
        assert np.allclose(at.dq, derivative(lambda s: journey.at(s).q, float(t)), atol=1e-6)
        assert np.allclose(at.ddq, derivative(lambda s: journey.at(s).dq, float(t)), atol=1e-4)


@pytest.mark.parametrize("journey", journeys(), ids=str)
def test_a_journey_begins_where_the_arm_stands_and_ends_at_the_end_of_its_way(journey: Journey) -> None:
    begin, end = journey.at(0.0), journey.at(journey.seconds())
    assert np.allclose(begin.q, journey.q_from, atol=1e-12)
    assert np.allclose(end.q, GRASP if journey.forward else REST, atol=1e-9)
    for at in (begin, end):
        assert np.allclose(at.dq, 0.0, atol=1e-9)
        assert np.allclose(at.ddq, 0.0, atol=1e-9)
    times = np.linspace(0.0, journey.seconds(), 400).tolist()
    beside = 1.875 * float(np.abs(journey.q_from - path().at(path().nearest(journey.q_from).s).q).max()) / EASE
    assert max(float(np.abs(journey.at(t).dq).max()) for t in times) <= SPEED + beside + 1e-9


def test_legs_are_as_slow_as_the_bound_asks_and_not_slower() -> None:
    for leg in path().legs:
        fastest = max(float(np.abs(leg.at(t).dq).max()) for t in np.linspace(0.0, leg.seconds, 300).tolist())
        assert fastest <= SPEED
        assert fastest > 0.97 * SPEED or leg.seconds == 1.0


def test_the_nearest_place_says_how_far_the_farthest_joint_is_off() -> None:
    p = path()
    place = p.nearest(p.at(1.7).q + np.array([0.0, 0.0, 0.04]))
    assert place.s == pytest.approx(1.7, abs=0.1)
    assert 0.02 < place.off_rad <= 0.04


def test_a_leg_of_one_knot_or_no_time_is_none() -> None:
    with pytest.raises(ValueError, match="1 knots"):
        Leg(np.array([REST]), 1.0)
    with pytest.raises(ValueError, match=r"in 0\.0 s"):
        Leg(KNOTS, 0.0)


def test_an_arm_at_its_rest_is_known_and_one_beside_it_is_not() -> None:
    life = Life(path(), ((0.0, 0.0, 0.2), (1.0, 0.0, 0.0, 0.0)), 1.0, 1.0, 1.0, 12.0, 0.1, 0.25)
    assert life.at_rest(REST + 0.2)
    assert not life.at_rest(REST + 0.3)
    assert life.off(GRASP) < 1e-9
