"""A box on a table without end: it stands where it stood, is stopped where it falls, and rubs where it slides."""

from __future__ import annotations

import itertools

import numpy as np
import pinocchio as pin
import pytest

from sim_backend.physics.support import DAMPING_RATIO, FRICTION, GRIP_PER_S, OMEGA_RAD_PER_S, Support

SIZE, MASS, G = np.array([0.135, 0.044, 0.044]), 0.062, 9.81
GRAVITY = np.array([0.0, 0.0, -G])
PLACE = pin.SE3(np.eye(3), np.array([0.3, 0.1, 0.25]))
STILL, UP = np.zeros(6), np.array([0.0, 0.0, 1.0])


def support() -> Support:
    return Support(PLACE, SIZE, MASS, GRAVITY)


def test_at_its_place_the_table_bears_the_weight_and_turns_nothing() -> None:
    wrench = support().wrench(PLACE, STILL)
    assert wrench is not None
    assert wrench == pytest.approx([0.0, 0.0, MASS * G, 0.0, 0.0, 0.0], abs=1e-9)


def test_above_the_table_there_is_nothing() -> None:
    lifted = pin.SE3(np.eye(3), PLACE.translation + 2.0 * G / OMEGA_RAD_PER_S**2 * UP)
    assert support().wrench(lifted, STILL) is None
    assert support().wrench(pin.SE3(np.eye(3), PLACE.translation + UP), STILL) is None


def test_a_box_that_leans_is_turned_back() -> None:
    for axis in (0, 1):
        turn = np.zeros(3)
        turn[axis] = 0.01
        wrench = support().wrench(pin.SE3(pin.exp3(turn), PLACE.translation), STILL)
        assert wrench is not None
        assert wrench[3 + axis] < 0.0


def test_the_table_never_pulls() -> None:
    rising = np.array([0.0, 0.0, 5.0, 0.0, 0.0, 0.0])
    wrench = support().wrench(PLACE, rising)
    assert wrench is not None
    assert wrench[2] == 0.0


def test_a_sliding_box_is_rubbed_against_its_way_by_its_weight_times_the_coefficient() -> None:
    wrench = support().wrench(PLACE, np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert wrench is not None
    assert wrench[0] == pytest.approx(-FRICTION * MASS * G)
    slow = support().wrench(PLACE, np.array([1e-4, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert slow is not None
    assert -FRICTION * MASS * G < slow[0] < 0.0


@pytest.mark.parametrize("seed", range(3))
def test_every_corner_below_the_plane_is_pushed_and_rubbed_by_itself(seed: int) -> None:
    """Springs, dampers and friction of each corner by their definitions, on any table, at any pose and twist."""
    rng = np.random.default_rng(seed)
    borne = 0
    for _ in range(40):
        gravity = 9.0 * rng.normal(size=3)
        g, up = np.linalg.norm(gravity), -gravity / np.linalg.norm(gravity)
        place = pin.SE3(pin.exp3(rng.normal(scale=0.5, size=3)), rng.normal(scale=0.1, size=3))
        own = Support(place, SIZE, MASS, gravity)
        corners = np.array(list(itertools.product(*((-0.5 * s, 0.5 * s) for s in SIZE))))
        heights = [up.dot(place.act(c)) for c in corners]
        standing = sum(h < min(heights) + 1e-3 for h in heights)
        k, c = MASS * OMEGA_RAD_PER_S**2 / standing, 2.0 * DAMPING_RATIO * OMEGA_RAD_PER_S * MASS / standing
        at = place * pin.SE3(pin.exp3(rng.normal(scale=0.05, size=3)), rng.normal(scale=0.01, size=3))
        v = rng.normal(scale=0.1, size=6)
        force, moment, touched = np.zeros(3), np.zeros(3), False
        for corner in corners:
            arm = at.rotation.dot(corner)
            depth = min(heights) + g / OMEGA_RAD_PER_S**2 - up.dot(at.translation + arm)
            if depth <= 0.0:
                continue
            touched, speed = True, v[:3] + np.cross(v[3:], arm)
            normal = max(0.0, k * depth - c * up.dot(speed))
            sliding = speed - up.dot(speed) * up
            drag = min(GRIP_PER_S * MASS, FRICTION * normal / np.linalg.norm(sliding))
            force, moment = force + normal * up - drag * sliding, moment + np.cross(arm, normal * up - drag * sliding)
        found = own.wrench(at, v)
        assert (found is not None) is touched
        if found is not None:
            borne += 1
            assert found == pytest.approx([*force, *moment], rel=1e-9, abs=1e-10)
    assert 10 < borne < 40
