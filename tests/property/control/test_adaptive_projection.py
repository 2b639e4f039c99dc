"""Estimates stay inside their bounds and physically possible, and projecting them never makes them worse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.control.adaptation import MAX_INTERVALS, Adaptation, Estimate, Gradient, from_row
from agent.control.projection import CONE_TOLERANCE, second_moments, to_box, to_physical
from tests.support.control.adaptive_cells import random_body
from tests.support.control.strategies import examples, random_unit_quaternion

SEEDS = st.integers(0, 2**32 - 1)
N = 3


def adaptation(rng: np.random.Generator, *, physical: bool = True) -> Adaptation:
    """Three links and an object, boxed in around zero to twice their parameters; two pinned groups."""
    bodies = np.concatenate([random_body(rng, 0.5) for _ in range(N)])
    truth = Estimate(np.concatenate([bodies, rng.uniform(0.002, 0.05, 6 * N)]), random_body(rng, 0.2))
    gain = Estimate(rng.uniform(1e-4, 1e-2, 16 * N), rng.uniform(0.1, 2.0, 10))
    gain.arm[10 * N : 11 * N] = 0.0
    gain.object[1:4] = 0.0
    high = Estimate(2.0 * np.abs(truth.arm), 2.0 * np.abs(truth.object))
    low = Estimate(-high.arm, -high.object)
    nonnegative = [i for b in range(N) for i in (10 * b, 10 * b + 4, 10 * b + 6, 10 * b + 9)] + list(
        range(10 * N, 16 * N)
    )
    low.arm[nonnegative] = 0.0
    low.object[[0, 4, 6, 9]] = 0.0
    return Adaptation(truth, truth, low, high, gain, 0.05, friction=True, physical=physical, period_s=0.005)


def gradient(rng: np.random.Generator, scale: float) -> Gradient:
    return Gradient(rng.normal(scale=scale, size=16 * N), rng.normal(scale=scale, size=10))


@given(SEEDS)
@examples(100)
def test_box_projection_is_the_nearest_point_in_every_diagonal_metric(seed: int) -> None:
    rng = np.random.default_rng(seed)
    low = -rng.uniform(0.0, 1.0, 20)
    high, theta = low + rng.uniform(0.0, 2.0, 20), rng.normal(scale=3.0, size=20)
    found = to_box(theta, low, high)
    assert ((found >= low) & (found <= high)).all()
    inside = (theta >= low) & (theta <= high)
    assert np.array_equal(found[inside], theta[inside])
    weight, truth = rng.uniform(0.1, 1e3, 20), rng.uniform(low, high)
    assert ((found - truth) ** 2) @ weight <= ((theta - truth) ** 2) @ weight * (1 + 1e-15)
    assert np.array_equal(to_box(found, low, high), found)


@given(SEEDS)
@examples(60)
def test_second_moment_is_that_of_the_mass_distribution(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mass, r = rng.uniform(0.01, 1.0, 12), rng.normal(size=(12, 3))
    sigma = np.einsum("k,ki,kj->ij", mass, r, r)
    inertia = np.trace(sigma) * np.eye(3) - sigma
    parameters = [mass.sum(), *(mass @ r), *inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]]
    assert np.abs(second_moments(np.array([parameters]))[0] - sigma).max() < 1e-12


@given(SEEDS)
@examples(100)
def test_cone_projection_makes_principal_moments_physical_and_comes_no_farther_from_any_body(seed: int) -> None:
    rng = np.random.default_rng(seed)
    bodies, truth = rng.normal(size=(5, 10)), np.stack([random_body(rng, 3.0) for _ in range(5)])
    found = to_physical(bodies)
    assert np.array_equal(found[:, :4], bodies[:, :4])
    for body in found:
        xx, xy, yy, xz, yz, zz = body[4:]
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        assert moments[0] > -1e-12
        assert moments[2] <= moments[0] + moments[1] + 1e-12
    distance = [np.linalg.norm(second_moments(b) - second_moments(truth), axis=(1, 2)) for b in (found, bodies)]
    assert (distance[0] <= distance[1] + 1e-12).all()
    assert np.abs(to_physical(found) - found).max() < 1e-12
    # what makes it the nearest: what was added is at right angles to what is left
    left, added = second_moments(found), second_moments(found) - second_moments(bodies)
    assert np.abs(np.einsum("kij,kij->k", left, added)).max() < 1e-12


@given(SEEDS)
@examples(60)
def test_with_equal_gains_a_cone_projection_may_raise_v_eightfold_at_most(seed: int) -> None:
    """The norm of the second moments squared is between 1/4 and 2 times that of the six moments."""
    rng = np.random.default_rng(seed)
    bodies, truth = rng.normal(size=(5, 10)), np.stack([random_body(rng, 3.0) for _ in range(5)])
    found = to_physical(bodies)
    after, before = (((x - truth)[:, 4:] ** 2).sum(axis=1) for x in (found, bodies))
    assert (after <= 8.0 * before * (1.0 + 1e-9)).all()


def test_with_equal_gains_a_cone_projection_does_raise_v() -> None:
    """A body with one moment below zero: its second moments come nearer to a thin plate's, its moments do not."""
    rng, grew = np.random.default_rng(3), 0
    for _ in range(300):
        A = rng.normal(size=(3, rng.integers(1, 4)))
        inertia = np.trace(A @ A.T) * np.eye(3) - A @ A.T
        truth = np.concatenate([[1.0, 0.0, 0.0, 0.0], inertia[np.tril_indices(3)]])
        body = truth.copy()
        body[4:] += rng.normal(size=6) * rng.uniform(0.0, 4.0)
        found = to_physical(body[None])[0]
        grew += float(np.sum((found - truth) ** 2)) > 1.01 * float(np.sum((body - truth) ** 2))
    assert grew > 50


@given(SEEDS)
@examples(60)
def test_cone_projection_leaves_bodies_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    bodies = np.stack([random_body(rng, 0.4) for _ in range(7)])
    bodies[3] = 0.0  # nothing believed at all is possible too
    assert to_physical(bodies) is bodies


@given(SEEDS, st.integers(0, 6), st.sampled_from([-1e-6, -1e-9, -1e-11, -1e-13, 0.0, 1e-9]))
@examples(100)
def test_one_body_among_seven_is_changed_as_soon_as_a_moment_is_negative(
    seed: int, which: int, smallest: float
) -> None:
    rng = np.random.default_rng(seed)
    bodies = np.stack([random_body(rng, 0.4) for _ in range(7)])
    R = pin.Quaternion(random_unit_quaternion(rng)).matrix()
    sigma = R @ np.diag([smallest, *rng.uniform(1e-6, 1e-3, 2)]) @ R.T
    inertia = np.trace(sigma) * np.eye(3) - sigma
    bodies[which, 4:] = inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    found = to_physical(bodies)
    assert (found is bodies) == (smallest > -CONE_TOLERANCE)
    changed = [k for k in range(7) if not np.array_equal(found[k], bodies[k])]
    assert changed == ([] if smallest > -CONE_TOLERANCE else [which])


@given(SEEDS)
@examples(30)
def test_whatever_drives_them_estimates_stay_bounded_and_possible(seed: int) -> None:
    rng = np.random.default_rng(seed)
    data = adaptation(rng)
    estimate, ever = data.start, False
    for _ in range(200):
        estimate, held = data.advance(estimate, gradient(rng, 10.0 ** rng.uniform(-2, 6)), rng.uniform(0.0, 0.1))
        ever |= held
        bodies = np.concatenate([estimate.arm[: 10 * N], estimate.object]).reshape(-1, 10)
        assert (bodies[:, 0] >= 0.0).all()
        assert (np.linalg.eigvalsh(second_moments(bodies)) >= -2 * CONE_TOLERANCE).all()
        assert np.linalg.norm(estimate.arm) <= 4.0 * np.linalg.norm(data.upper.arm)
        joints, high = estimate.arm[10 * N :], data.upper.arm[10 * N :]
        assert ((joints >= 0.0) & (joints <= high)).all()
    assert ever
    assert np.array_equal(estimate.arm[10 * N : 11 * N], data.start.arm[10 * N : 11 * N])  # gain zero: pinned
    assert np.array_equal(estimate.object[1:4], data.start.object[1:4])


@given(SEEDS)
@examples(60)
def test_the_box_never_adds_parameter_error(seed: int) -> None:
    """½ e_θᵀ Γ⁻¹ e_θ of the Lyapunov function: held back by the box, it is not above that of the free step."""
    rng = np.random.default_rng(seed)
    data = adaptation(rng, physical=False)
    unbounded = replace(
        data,
        lower=Estimate(data.lower.arm - np.inf, data.lower.object - np.inf),
        upper=Estimate(data.upper.arm + np.inf, data.upper.object + np.inf),
    )
    before = Estimate(rng.uniform(data.lower.arm, data.upper.arm), rng.uniform(data.lower.object, data.upper.object))
    g, dt = gradient(rng, 1e3), 0.005
    (held, _), (free, _) = data.advance(before, g, dt), unbounded.advance(before, g, dt)
    assert data.parameter_error(held) <= data.parameter_error(free) * (1 + 1e-12)


def test_one_step_is_explicit_euler_of_the_adaptation_law() -> None:
    rng = np.random.default_rng(1)
    data, g = adaptation(rng, physical=False), gradient(rng, 1e-3)
    inside = Estimate(0.5 * data.start.arm, 0.5 * data.start.object)
    after, held = data.advance(inside, g, 0.005)
    assert not held
    assert after.arm == pytest.approx(inside.arm - 0.005 * data.gain.arm * g.arm, abs=1e-18)
    assert after.object == pytest.approx(inside.object - 0.005 * data.gain.object * g.object, abs=1e-18)


def test_a_long_pause_is_not_made_up_for_and_time_never_runs_backwards() -> None:
    rng = np.random.default_rng(2)
    data, g = adaptation(rng, physical=False), gradient(rng, 1e-3)
    inside = Estimate(0.5 * data.start.arm, 0.5 * data.start.object)
    longest, _ = data.advance(inside, g, MAX_INTERVALS * data.period_s)
    hour, _ = data.advance(inside, g, 3600.0)
    back, _ = data.advance(inside, g, -1.0)
    assert np.array_equal(hour.arm, longest.arm)
    assert np.array_equal(back.arm, inside.arm)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_gradient_that_is_no_number_changes_nothing_and_is_reported(bad: float) -> None:
    rng = np.random.default_rng(3)
    data = adaptation(rng)
    for where in (0, 1):
        g = gradient(rng, 1.0)
        g[where][4] = bad
        after, held = data.advance(data.start, g, 0.005)
        assert after is data.start
        assert held


def test_a_mass_held_at_zero_is_no_alarm_and_every_configured_bound_is() -> None:
    data = adaptation(np.random.default_rng(6), physical=False)
    still = Gradient(np.zeros(16 * N), np.zeros(10))
    for k, expected in ((0, False), (1, True), (12 * N, False)):
        down = Gradient(still.arm.copy(), still.object)
        down.arm[k] = 1e9
        after, held = data.advance(data.start, down, 0.005)
        assert after.arm[k] == data.lower.arm[k]
        assert held is expected
        down.arm[k] = -1e9
        after, held = data.advance(data.start, down, 0.005)
        assert after.arm[k] == data.upper.arm[k]
        assert held is True
    assert data.advance(data.start, still, 0.005)[1] is False


def test_parameter_error_counts_only_what_is_estimated() -> None:
    data = adaptation(np.random.default_rng(4))
    pinned = Estimate(data.nominal.arm.copy(), data.nominal.object.copy())
    pinned.arm[10 * N : 11 * N] += 1.0
    assert data.parameter_error(pinned) == 0.0
    pinned.object[0] += 0.1
    assert data.parameter_error(pinned) == pytest.approx(0.5 * 0.01 / data.gain.object[0])


def test_estimate_of_a_log_row_is_the_estimate_that_was_logged() -> None:
    data = adaptation(np.random.default_rng(5))
    field = np.zeros(112)
    field[: 16 * N] = data.start.arm
    found = from_row(field, data.start.object, N)
    assert np.array_equal(found.arm, data.start.arm)
    assert np.array_equal(found.object, data.start.object)


@given(SEEDS, st.floats(0.1, 10.0), st.floats(0.0, 0.02))
@examples(40)
def test_a_leak_forgets_towards_what_is_configured_at_its_rate(seed: int, leak: float, dt: float) -> None:
    """And only what is estimated: a pinned parameter stays, wherever it began."""
    rng = np.random.default_rng(seed)
    data = replace(adaptation(rng, physical=False), leak_per_s=leak)
    begun = Estimate(*(rng.uniform(0.2, 1.0) * x for x in data.nominal))
    still = Gradient(np.zeros(16 * N), np.zeros(10))
    after, held = data.advance(begun, still, dt)
    for found, before, nominal, gain in zip(after, begun, data.nominal, data.gain, strict=True):
        expected = np.where(gain > 0.0, nominal + np.exp(-leak * dt) * (before - nominal), before)
        assert found == pytest.approx(expected, rel=1e-12, abs=1e-15)
    assert held is False
    assert data.parameter_error(after) == pytest.approx(np.exp(-2.0 * leak * dt) * data.parameter_error(begun))


@given(SEEDS)
@examples(20)
def test_leak_and_adaptation_add_up(seed: int) -> None:
    """From the nominal estimate a leak takes nothing, and without one nothing is forgotten."""
    rng = np.random.default_rng(seed)
    data, some = adaptation(rng, physical=False), gradient(rng, 1e-3)
    leaking = replace(data, leak_per_s=2.0)
    assert np.array_equal(
        data.advance(data.nominal, some, 0.01)[0].arm, leaking.advance(data.nominal, some, 0.01)[0].arm
    )
    learnt = data.advance(data.nominal, some, 0.02)[0]
    still = Gradient(np.zeros(16 * N), np.zeros(10))
    assert np.array_equal(data.advance(learnt, still, 0.02)[0].arm, learnt.arm)
