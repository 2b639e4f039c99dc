"""The desired motion: the paper's numbers, and derivatives against central differences."""

from __future__ import annotations

import math

import numpy as np
import pytest

from agent.control.quaternion import angle_between, conjugate, multiply
from agent.control.trajectory import Sinusoid, Trajectory
from agent.control.trajectory_ease import Eased
from tests.support.control.oracle import rate_at

IDENTITY = (1.0, 0.0, 0.0, 0.0)
PAPER = Sinusoid((0.3, 0.12, 0.0), (0.05, 0.0, 0.0), IDENTITY, (0.0, 0.0, 1.0), -math.pi / 30, 15.0)
TILTED = Sinusoid((0.1, -0.2, 0.3), (0.02, 0.05, -0.03), (0.5, 0.5, -0.5, 0.5), (0.36, 0.48, 0.8), 0.7, 4.0)
EASED = Eased(TILTED, 1.6)
MOVING = (PAPER, TILTED, EASED)
TIMES = (0.0, 0.3, 1.7, 3.75, 7.9, 14.999, 40.0, 99.5)


@pytest.mark.parametrize("t", TIMES)
def test_paper_motion_is_the_printed_one(t: float) -> None:
    s = math.sin(2 * math.pi * t / 15)
    a = math.pi / 60 * s
    desired = PAPER.at(t)
    assert desired.p == pytest.approx((0.3 + 0.05 * s, 0.12, 0.0), abs=1e-15)
    assert desired.quat == pytest.approx((math.cos(a), 0.0, 0.0, -math.sin(a)), abs=1e-15)


@pytest.mark.parametrize("trajectory", MOVING)
@pytest.mark.parametrize("t", TIMES)
def test_twist_is_the_derivative_of_the_pose(trajectory: Trajectory, t: float) -> None:
    desired = trajectory.at(t)
    assert rate_at(lambda s: np.array(trajectory.at(s).p), t) == pytest.approx(desired.v[:3], abs=1e-9)

    def small_rotation(s: float) -> np.ndarray:
        """Twice the vector part of the rotation from time t to time s: its rate at t is ω, world axes."""
        return 2.0 * np.array(multiply(trajectory.at(s).quat, conjugate(desired.quat))[1:])

    assert rate_at(small_rotation, t) == pytest.approx(desired.v[3:], abs=1e-9)


@pytest.mark.parametrize("trajectory", MOVING)
@pytest.mark.parametrize("t", TIMES)
def test_acceleration_is_the_derivative_of_the_twist(trajectory: Trajectory, t: float) -> None:
    assert rate_at(lambda s: np.array(trajectory.at(s).v), t) == pytest.approx(trajectory.at(t).a, abs=1e-9)


@pytest.mark.parametrize("trajectory", [PAPER, TILTED])
def test_motion_repeats_after_its_period_and_keeps_unit_attitudes(trajectory: Sinusoid) -> None:
    for t in TIMES:
        now, later = trajectory.at(t), trajectory.at(t + 3 * trajectory.period_s)
        assert later.p == pytest.approx(now.p, abs=1e-12)
        assert later.a == pytest.approx(now.a, abs=1e-12)
        assert angle_between(later.quat, now.quat) < 1e-12
        assert math.hypot(*now.quat) == pytest.approx(1.0, abs=1e-14)


def test_an_eased_motion_begins_at_rest_and_ends_half_a_ramp_late() -> None:
    rest, still = EASED.at(0.0), (0.0,) * 6
    assert (rest.p, rest.v, rest.a) == (TILTED.at(0.0).p, still, still)
    assert EASED.at(-1.0) == rest
    assert EASED.at(1.6) == TILTED.at(0.8)
    assert EASED.at(7.0) == TILTED.at(6.2)
    assert EASED.period_s == pytest.approx(4.8)
    speeds = [math.hypot(*EASED.at(0.01 * k).v[:3]) for k in range(40)]
    assert speeds == sorted(speeds), "no faster than it will be, and without a step"
