"""Friction feed-forward: what it cancels on the plant, where its speeds come from, and its corners."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.control.friction import Friction, JointFriction, solved, sticking_columns
from drivers.interface import Vector
from sim_backend.physics.friction import DryFriction, FrictionSpec

SEEDS = st.integers(0, 2**31)
PARTS = st.floats(0.0, 0.45)
FAST = 5.0  # rad/s, at which the smooth sign is one
MX64 = JointFriction(0.0615, 0.0148, 0.0239, 1.52, 1.33, 0.0, 0.4686)


def some(rng: np.random.Generator, n: int) -> tuple[JointFriction, ...]:
    low, high = (0.0, 0.0, 0.0, 0.1, 0.5, 0.0, 0.0), (0.2, 0.1, 0.1, 2.0, 2.0, 0.3, 0.5)
    return tuple(JointFriction(*row) for row in rng.uniform(low, high, (n, 7)).tolist())


def sliding(joints: tuple[JointFriction, ...], dq: Vector, tau_motor: Vector) -> Vector:
    """Friction torque (n,) of the plant's joints that slide at dq (n,) under the motors' torques."""
    coulomb, viscous, breakaway, speed, exponent, load, breakaway_load = np.array(joints).T
    spec = FrictionSpec(coulomb, breakaway, speed, exponent, load, breakaway_load, viscous)
    friction = DryFriction(spec, np.full(len(dq), 0.01), 1e-3)
    friction.load(tau_motor)
    for _ in range(100):
        D, f = friction.torque(dq)
        friction.step(dq)
    assert friction.sliding.all()
    return f - D * dq


@given(SEEDS)
def test_it_cancels_the_friction_by_which_the_plant_slides_under_the_whole_torque(seed: int) -> None:
    rng = np.random.default_rng(seed)
    joints, tau_law = some(rng, 6), rng.normal(scale=1.5, size=6)
    dq = rng.choice([-1.0, 1.0], 6) * rng.uniform(0.5, 3.0, 6)
    feed_forward = Friction(joints, 0.01).torque(dq, dq, tau_law)
    assert feed_forward == pytest.approx(-sliding(joints, dq, tau_law + feed_forward), rel=1e-9, abs=1e-12)


@given(SEEDS, st.floats(0.5, 2.0))
def test_with_a_learned_factor_it_cancels_the_friction_of_a_plant_that_has_so_many_times_the_file_s(
    seed: int, factor: float
) -> None:
    """Load in it, at the torque that is sent: the whole friction but the viscous is the factor times as large."""
    rng = np.random.default_rng(seed)
    joints, tau_law = some(rng, 6), rng.normal(scale=1.5, size=6)
    joints = tuple(j._replace(load=0.5 * j.load, breakaway_load=0.5 * j.breakaway_load) for j in joints)
    scaled = tuple(
        j._replace(
            coulomb_Nm=factor * j.coulomb_Nm, breakaway_Nm=factor * j.breakaway_Nm,
            load=factor * j.load, breakaway_load=factor * j.breakaway_load,
        )
        for j in joints
    )  # fmt: skip
    dq = rng.choice([-1.0, 1.0], 6) * rng.uniform(0.5, 3.0, 6)
    feed_forward = Friction(joints, 0.01).torque(dq, dq, tau_law, factor)
    assert feed_forward == pytest.approx(-sliding(scaled, dq, tau_law + feed_forward), rel=1e-9, abs=1e-12)


@given(SEEDS, st.floats(0.5, 2.0))
def test_a_factor_of_one_and_any_of_joints_without_load_friction_change_no_bit(seed: int, factor: float) -> None:
    """Older logs replay: Γ by the file, times sign and factor."""
    rng = np.random.default_rng(seed)
    joints, (dq_ref, dq, tau) = some(rng, 6), rng.normal(scale=0.3, size=(3, 6))
    alone = tuple(j._replace(load=0.0, breakaway_load=0.0) for j in joints)
    for of, times in ((joints, 1.0), (alone, factor)):
        expected = []
        for j, v_ref, v, rest in zip(of, dq_ref.tolist(), dq.tolist(), tau.tolist(), strict=True):
            sign, drag, left = math.tanh(v_ref * (1.0 / 0.05)), j.viscous_Nm_s_per_rad * v_ref, j.breakaway_left(v)
            by_file = solved(j.coulomb_Nm + j.breakaway_Nm * left, j.load + j.breakaway_load * left, rest + drag, sign)
            expected.append(times * sign * by_file + drag)
        assert Friction(of, 0.05).torque(dq_ref, dq, tau, times).tolist() == expected


@pytest.mark.parametrize("factor", [1.0, 1.5, 2.5])
@pytest.mark.parametrize("load", [0.3, 0.6, 0.97])
def test_however_large_a_factor_is_the_feed_forward_is_bounded_and_goes_through_zero_smoothly(
    factor: float, load: float
) -> None:
    joint = JointFriction(0.1, 0.0, load=load)
    friction, speeds = Friction((joint,), 0.05), np.arange(-0.2, 0.2, 1e-4)
    tau = np.array([friction.torque(np.array([v]), np.array([v]), np.array([0.8]), factor)[0] for v in speeds])
    most = factor * (0.1 + load * 0.8) / (1.0 - max(min(factor * load, 0.95), load))
    assert np.abs(tau).max() <= most * (1.0 + 1e-9)
    assert np.all(np.diff(tau) > 0.0)
    steepest = np.abs(np.diff(tau)).max()
    assert steepest < 1.05 * most * (1.0 + max(min(factor * load, 0.95), load) / 0.03) * 1e-4 / 0.05


@given(st.floats(0.0, 1.0), PARTS, st.floats(-5.0, 5.0), st.floats(-1.0, 1.0))
def test_the_bound_belongs_to_the_torque_that_it_is_part_of(
    constant: float, load: float, tau: float, sign: float
) -> None:
    bound = solved(constant, 2.0 * load, tau, sign)
    assert bound >= 0.0
    assert bound == pytest.approx(constant + 2.0 * load * abs(tau + sign * bound), rel=1e-9, abs=1e-12)


def test_without_breakaway_and_load_it_is_coulomb_with_a_smooth_sign_and_viscous() -> None:
    joints = (JointFriction(0.0843, 0.0347), JointFriction(0.0078, 0.0362))
    dq_ref = np.array([0.03, -0.2])
    nobody_asks = np.full(2, np.nan)  # the joints' own speeds, nor the torques
    found = Friction(joints, 0.05).torque(dq_ref, nobody_asks, nobody_asks)
    expected = [0.0843 * math.tanh(0.6) + 0.0347 * 0.03, 0.0078 * math.tanh(-4.0) - 0.0362 * 0.2]
    assert found.tolist() == pytest.approx(expected, rel=1e-15)


def test_the_sign_is_the_references_and_what_breakaway_is_left_the_joints() -> None:
    """At creep the joint takes all of its breakaway, and none at ten times its Stribeck velocity."""
    friction, tau = Friction((MX64,), 0.05), np.array([0.5])
    reference = np.array([FAST])
    creeping, backwards, running = (friction.torque(reference, np.array([v]), tau)[0] for v in (1e-9, -1e-9, 15.2))
    assert creeping == backwards == pytest.approx((0.0854 + 0.4686 * 0.574) / (1.0 - 0.4686) + 0.074, rel=1e-6)
    assert running == pytest.approx(0.0615 + 0.0148 * FAST, rel=1e-6)
    assert friction.torque(-reference, np.array([1e-9]), tau)[0] < 0.0


def test_a_motor_that_lowers_its_load_is_helped_by_friction() -> None:
    """Raising takes load friction of more than the weight, lowering of less than it."""
    friction = Friction((JointFriction(0.0, 0.0, load=0.2),), 0.01)
    up, down = (friction.torque(np.array([v]), np.array([v]), np.array([1.0]))[0] for v in (FAST, -FAST))
    assert up == pytest.approx(0.2 / 0.8)
    assert down == pytest.approx(-0.2 / 1.2)


def test_around_a_turn_it_changes_smoothly() -> None:
    """Over one mrad/s it changes by no more than the bound times that of the smooth sign."""
    friction, speeds = Friction((MX64,), 0.05), np.arange(-0.2, 0.2, 1e-3)
    tau = np.array([friction.torque(np.array([v]), np.array([v]), np.array([0.8]))[0] for v in speeds])
    largest = friction.torque(np.array([FAST]), np.array([0.0]), np.array([0.8]))[0]
    assert np.abs(np.diff(tau)).max() < 1.05 * largest * 1e-3 / 0.05
    assert np.all(np.diff(tau[np.abs(speeds) < 0.05]) > 0.0)


@pytest.mark.parametrize("speed", [0.0, 1e300, -1e300])
def test_any_finite_speed_gives_a_finite_torque(speed: float) -> None:
    steep = MX64._replace(stribeck_exponent=100.0, stribeck_rad_per_s=1e-3)
    assert np.isfinite(Friction((steep,), 0.05).torque(np.array([0.1]), np.array([speed]), np.array([0.5]))).all()


def test_a_joint_without_load_friction_is_exact_beside_one_that_has_it() -> None:
    alone = Friction((JointFriction(0.1, 0.05),), 0.05)
    both = Friction((JointFriction(0.1, 0.05), MX64), 0.05)
    dq_ref, tau = np.array([0.02, 0.3]), np.array([1.0, 1.0])
    found = both.torque(dq_ref, dq_ref, tau)
    assert found[0] == alone.torque(dq_ref[:1], dq_ref[:1], tau[:1])[0]
    assert found[1] == Friction((MX64,), 0.05).torque(dq_ref[1:], dq_ref[1:], tau[1:])[0]
    assert solved(0.1, 0.0, math.inf, 1.0) == 0.1, "whatever the motor does"


@pytest.mark.parametrize(("part", "sticks"), [(2, True), (5, True), (6, True), (None, False)])
def test_a_joint_sticks_by_any_part_beside_coulomb_and_viscous_friction(part: int | None, sticks: bool) -> None:
    values = [0.1, 0.05, 0.0, 1.5, 1.3, 0.0, 0.0]
    if part is not None:
        values[part] = 1e-3
    assert JointFriction(*values).sticks is sticks
    usual = JointFriction(0.1, 0.05, 0.1)
    assert [usual.breakaway_left(v) for v in (1.0, -2.0)] == [math.exp(-1.0), math.exp(-2.0)]


def test_columns_make_the_friction_with_their_parameters() -> None:
    """sign Γ is the sum of parameter times column, with Γ at the motor's torque that contains it."""
    theta = np.array([[0.06, 0.1, 0.2], [0.03, 0.02, 0.01], [0.1, 0.2, 0.3], [0.4, 0.3, 0.2]])
    sign, dq, tau_rest = np.array([0.9, -0.8, 0.7]), np.array([0.4, 1.1, -0.8]), np.array([0.5, 0.4, -0.3])
    shapes = (MX64, MX64._replace(stribeck_rad_per_s=0.7), MX64._replace(stribeck_exponent=1.9))
    columns = sticking_columns(shapes, theta, sign, dq, tau_rest)
    made = sign * theta[0] + (theta[1:] * columns).sum(axis=0)
    left = np.array([p.breakaway_left(v) for p, v in zip(shapes, dq, strict=True)])
    size = np.abs(tau_rest + made)
    assert columns == pytest.approx(np.array([sign * left, sign * size, sign * left * size]), rel=1e-12)
    assert np.sign(tau_rest + made).tolist() == [1.0, 1.0, -1.0]
