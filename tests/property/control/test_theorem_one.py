"""Theorem 1 on ideal arms: from random starts with attitude errors up to 170° every error goes to zero.

5 starts, and all 200 in `make long`.
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

from tests.support.control.ideal_arm import IdealCell, random_cell

STARTS, BATCHES, QUICK = 200, 40, 1
SECONDS, STEP_S = 8.0, 0.04  # the fastest mode takes 1 s / 44
GONE = 5e-4  # an error
ANGLE_MAX_RAD = math.radians(170.0)


def start(cell: IdealCell, rng: np.random.Generator) -> tuple[pin.SE3, np.ndarray]:
    """A random pose, up to 0.5 m and 170° from the desired one, and a random twist."""
    desired = cell.trajectory.at(0.0)
    axis = rng.normal(size=3)
    turn = pin.exp3(axis / np.linalg.norm(axis) * rng.uniform(0.0, ANGLE_MAX_RAD))
    R = turn @ pin.Quaternion(*desired.quat).matrix()
    p = np.array(desired.p) + rng.uniform(-0.3, 0.3, 3)
    return pin.SE3(R, p), rng.normal(scale=0.3, size=6)


@pytest.mark.parametrize(
    "batch", [*range(QUICK), *(pytest.param(k, marks=pytest.mark.long) for k in range(QUICK, BATCHES))]
)
def test_errors_vanish_from_random_starts_and_v_never_grows(batch: int) -> None:
    for i in range(STARTS // BATCHES):
        seed = 1000 * batch + i
        rng = np.random.default_rng(seed)
        pin.seed(seed)
        cell = random_cell(rng)
        T, v = start(cell, rng)
        terms = cell.terms(0.0, T, v)
        V = [sum(t.lyapunov for t in terms)]
        e_eta = [terms[0].errors.e_eta]
        for k in range(round(SECONDS / STEP_S)):
            T, v = cell.step(k * STEP_S, T, v, STEP_S)
            if k % 8 == 7:
                terms = cell.terms((k + 1) * STEP_S, T, v)
                V.append(sum(t.lyapunov for t in terms))
                e_eta.append(terms[0].errors.e_eta)
                errors = terms[0].errors
                if max(*map(abs, (*errors.e_p, *errors.e_eps, *errors.e_v))) < GONE:
                    break
        assert np.diff(V).max() < 1e-6 * V[0], seed
        assert math.hypot(*errors.e_p) < 1e-3, seed
        assert math.hypot(*errors.e_eps) < 1e-3, seed
        assert math.hypot(*errors.e_v) < 1e-3, seed
        assert abs(abs(e_eta[-1]) - 1.0) < 1e-6, seed


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_no_unwinding(sign: float) -> None:
    """e_ξ and −e_ξ are one attitude: the motion is the same, and e_η goes to the nearer of 1 and −1."""
    rng = np.random.default_rng(7)
    pin.seed(7)
    cell = random_cell(rng)
    T, v = start(cell, rng)
    quat = cell.trajectory.quat_centre
    cell.trajectory = type(cell.trajectory)(
        cell.trajectory.p_centre, cell.trajectory.p_amplitude, tuple(sign * x for x in quat), cell.trajectory.axis,
        cell.trajectory.angle_rad, cell.trajectory.period_s,
    )  # fmt: skip
    begin = cell.terms(0.0, T, v)[0].errors.e_eta
    for k in range(round(SECONDS / STEP_S)):
        T, v = cell.step(k * STEP_S, T, v, STEP_S)
    end = cell.terms(SECONDS, T, v)[0].errors.e_eta
    assert end == pytest.approx(math.copysign(1.0, begin), abs=1e-6)
