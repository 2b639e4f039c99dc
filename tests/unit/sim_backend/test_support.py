"""A box on a table without end: it stands where it stood, is stopped where it falls, and rubs where it slides."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from sim_backend.physics.support import FRICTION, OMEGA_RAD_PER_S, Support

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
