"""When others feel an arm that stays: as the channels of their residual do, on the way that the motion goes on."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from agent.config import coordination
from agent.config.cell import Cell, placement
from agent.control.models import Matrix
from agent.control.residual import Channels
from agent.verify.ahead import turned
from agent.verify.felt import STEP_S, STEPS, Feeling, summed
from tests.support.control.criterion_cells import cell_of

LIMITS = Channels(2.0, 0.5, 1.0, 0.2)


def feeling(cell: Cell, *instants: float, limits: Channels = LIMITS) -> Feeling:
    residual = coordination.residual(cell, cell.arms[0])
    assert residual is not None
    return Feeling(cell, replace(residual, limits=limits), instants or (0.0,))


def pull(*sizes: float, row: int = 0) -> Matrix:
    """(T, STEPS + 1, 6): one place for each size, which pulls by so much from the begin on."""
    w = np.zeros((len(sizes), STEPS + 1, 6))
    w[:, :, row] = np.array(sizes)[:, None]
    return w


def felt_step_by_step(w: Matrix, limits: Channels, rates: tuple[float, float, float]) -> int:
    """Of one place (STEPS + 1, 6), by the recursion itself."""
    own, base, slow = (1.0 - math.exp(-rate * STEP_S) for rate in rates)
    r, b, s = np.zeros((3, 6))
    for k in range(STEPS + 1):
        r = r + own * (w[k] - r)
        b, s = b + base * (r - b), s + slow * (r - s)
        found = [float(np.linalg.norm(x[part])) for x in (r - b, s) for part in (slice(3), slice(3, 6))]
        if any(x > most for x, most in zip(found, limits, strict=True)):
            return k
    return -1


@pytest.mark.parametrize("row", range(6))
def test_a_pull_that_grows_is_felt_when_a_channel_is_above_its_limit(row: int) -> None:
    f = feeling(cell_of("paper_real"))
    for speed in (0.4, 0.7, 1.0, 4.0, 20.0):
        w = pull(1.0, row=row) * np.linspace(0.0, speed * STEPS * STEP_S, STEPS + 1)[:, None]
        k = felt_step_by_step(w[0], LIMITS, (30.0, 0.5, 2.0))
        at, when = f.until_felt([w], 0.0)
        assert k > 0
        assert (at.tolist(), when.tolist()) == ([k], [pytest.approx(k * STEP_S)])


def test_a_blow_is_felt_by_the_fast_channel_and_what_stays_by_the_slow_one() -> None:
    fast, slow = Channels(2.0, 9.0, 9.0, 9.0), Channels(9.0, 9.0, 1.0, 9.0)
    cell = cell_of("paper_real")
    (blow,), _ = feeling(cell, limits=fast).until_felt([pull(3.0)], 0.0)
    (stays,), when = feeling(cell, limits=slow).until_felt([pull(3.0)], 0.0)
    assert blow * STEP_S < 0.06 < 0.15 < stays * STEP_S < 0.35
    assert when[0] == pytest.approx(stays * STEP_S)
    assert math.isinf(feeling(cell, limits=fast).until_felt([pull(1.9)], 0.0)[1][0])


def test_no_arm_feels_it_sooner_than_it_may_and_the_first_of_several_counts() -> None:
    f = feeling(cell_of("paper_real"), 0.0, 1.0)
    at, when = f.until_felt([pull(0.0, 5.0), pull(5.0, 0.0)], 0.5)
    assert (at.tolist(), when.tolist()) == ([10, 10], [0.5, 0.5])
    at, when = f.until_felt([pull(0.0, 0.0), pull(5.0, 0.0)], 0.1)
    assert (at[0], when[0]) == (2, pytest.approx(0.1))
    assert math.isinf(when[1])


def test_what_is_not_felt_pulls_hardest_somewhere() -> None:
    w = pull(0.5) * np.sin(np.linspace(0.0, 3.0, STEPS + 1))[:, None]
    (at,), (when,) = feeling(cell_of("paper_real")).until_felt([w, 0.5 * w], 0.1)
    assert at == int(np.argmax(w[0, :, 0]))
    assert math.isinf(when)
    moment, down = pull(9.0, row=3) * np.linspace(1.0, 0.0, STEPS + 1)[:, None], pull(1.0, row=2)
    down[0, :, 2] *= np.linspace(0.0, 0.1, STEPS + 1)
    unfelt = feeling(cell_of("paper_real"), limits=Channels(99.0, 99.0, 99.0, 99.0))
    (at,), _ = unfelt.until_felt([moment + down], 0.1)
    assert at == STEPS, "by the force, whatever the moment"
    _, (never,) = feeling(cell_of("paper_real")).until_felt([np.full((1, STEPS + 1, 6), 0.0)], 0.1)
    assert math.isinf(never)


def test_ways_are_those_of_the_motion_and_end_with_the_run() -> None:
    given = [f"safety.noticing.{key}=9.0" for key in Channels._fields]  # none can be derived where nobody can reach
    cell = cell_of("paper_real", "trajectory.angle_rad=-1.5", "duration_s=10.0", *given)
    motion, instants = cell.trajectory(), (1.0, 4.0, 9.9)
    ways = feeling(cell, *instants).ways
    assert ways.shape == (3, 81, 6)
    assert pytest.approx(4.0) == STEP_S * STEPS
    for t, way in zip(instants, ways, strict=True):
        now = motion.at(t)
        for k in (0, 1, 17, STEPS):
            then = motion.at(min(t + k * STEP_S, 10.0))
            np.testing.assert_allclose(way[k, :3], np.subtract(then.p, now.p), atol=1e-9)
            a, b = (placement((0.0, 0.0, 0.0), quat).rotation for quat in (now.quat, then.quat))
            np.testing.assert_allclose(way[k, 3:], pin.log3(b @ a.T), atol=1e-9)
    assert np.abs(ways[:2, -1, 3:]).max() > 1.0, "far enough to tell an angle from its sine"


def test_rotation_vectors_are_those_from_the_first_attitude_on() -> None:
    rng = np.random.default_rng(4)
    R = [[pin.exp3(v) for v in row] for row in rng.uniform(-1.0, 1.0, (3, 5, 3))]
    quat = np.array([[[q.w, q.x, q.y, q.z] for q in map(pin.Quaternion, row)] for row in R])
    quat *= rng.choice([-1.0, 1.0], (3, 5, 1))  # of either sign
    expected = [[pin.log3(x @ row[0].T) for x in row] for row in R]
    np.testing.assert_allclose(turned(quat), expected, atol=1e-9)


@pytest.mark.parametrize("leak", [0.0, 4.0])
def test_what_estimates_come_to_is_the_sum_of_their_rates_less_what_they_forget(leak: float) -> None:
    rates = np.random.default_rng(1).normal(size=(2, STEPS + 1, 3))
    x, expected = np.zeros((2, 3)), []
    for k in range(STEPS + 1):
        expected.append(x)
        x = math.exp(-leak * STEP_S) * x + STEP_S * rates[:, k]
    np.testing.assert_allclose(summed(rates, leak), np.stack(expected, axis=1), atol=1e-9)
