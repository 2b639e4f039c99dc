"""Dry friction with presliding, on one or several rotors without anything else."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from drivers.dynamixel.servo.counts import VELOCITY_UNIT_RAD_PER_S
from drivers.interface import Vector
from sim_backend.physics.actuator import ActuatorError
from sim_backend.physics.friction import PRESLIDING_RAD, DryFriction, FrictionSpec

H = 1e-3
INERTIA = 0.012
MX64 = {
    "coulomb_Nm": 0.0615, "breakaway_Nm": 0.0239, "stribeck_rad_s": 1.52, "stribeck_exponent": 1.33,
    "load": 0.0, "breakaway_load": 0.0, "viscous_Nms_rad": 0.0148,
}  # fmt: skip
STATIC = 0.0615 + 0.0239


def spec(**changes: float) -> FrictionSpec:
    return FrictionSpec(**{key: np.array([value]) for key, value in (MX64 | changes).items()})


class Rotor:
    """A free rotor under a torque and its friction."""

    def __init__(self, friction: FrictionSpec, h: float = H, dq: float = 0.0) -> None:
        self.h = h
        self.friction = DryFriction(friction, np.array([INERTIA]), h)
        self.q, self.dq, self.tau_friction = 0.0, np.array([dq]), 0.0

    def step(self, tau: float) -> None:
        motor = np.array([tau])
        self.friction.load(motor)
        D, f = self.friction.torque(self.dq)
        a = (motor + f - D * self.dq) / (INERTIA + 0.5 * self.h * D)
        mean = self.dq + 0.5 * self.h * a
        self.tau_friction = float((f - D * mean)[0])
        self.friction.step(mean)
        self.dq = self.dq + self.h * a
        self.q += self.h * float(mean[0])

    @property
    def energy(self) -> float:
        return 0.5 * INERTIA * float(self.dq[0]) ** 2 + self.friction.energy


@pytest.mark.parametrize(
    ("share", "h"),
    [
        *product((-0.95, 0.5, 0.95), (1e-3, 4e-3)),
        *(pytest.param(share, 2e-4, marks=pytest.mark.long) for share in (-0.95, 0.5, 0.95)),
    ],
)  # fmt: skip
def test_load_below_breakaway_is_held_without_creep(share: float, h: float) -> None:
    rotor = Rotor(spec(), h)
    for _ in range(round(1.0 / h)):
        rotor.step(share * STATIC)
    settled = rotor.q
    assert settled == pytest.approx(share * PRESLIDING_RAD, rel=1e-3)
    for _ in range(round(2.0 / h)):
        rotor.step(share * STATIC)
    assert rotor.q == pytest.approx(settled, abs=4e-10)
    assert rotor.tau_friction == pytest.approx(-share * STATIC, rel=1e-6)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(("load", "breakaway_load"), [(0.0, 0.0), (0.1, 0.0), (0.0, 0.2), (0.1, 0.2)])
def test_breaks_away_at_the_bound_that_grows_with_load(load: float, breakaway_load: float, sign: float) -> None:
    """At rest the bound is F_c + F_s + (μ + μ_s) |τ|, so the torque that first reaches it is the quotient."""
    rotor = Rotor(spec(load=load, breakaway_load=breakaway_load))
    tau, per_step = 0.0, 0.05 * H
    while abs(rotor.q) < 1.02 * tau / STATIC * PRESLIDING_RAD or tau < 0.5 * STATIC:
        tau += per_step
        rotor.step(sign * tau)
    assert tau == pytest.approx(STATIC / (1.0 - load - breakaway_load), rel=0.02)
    for _ in range(200):
        rotor.step(sign * tau)
    assert sign * rotor.q > 10 * PRESLIDING_RAD


def test_slides_against_the_stribeck_curve() -> None:
    for speed in (0.3, 1.52, 6.0):
        friction = DryFriction(spec(load=0.1, breakaway_load=0.2), np.array([INERTIA]), H)
        friction.load(np.array([-0.5]))
        for _ in range(50):
            D, f = friction.torque(np.array([speed]))
            friction.step(np.array([speed]))
        bound = 0.0615 + 0.1 * 0.5 + (0.0239 + 0.2 * 0.5) * np.exp(-((speed / 1.52) ** 1.33))
        assert f[0] - D[0] * speed == pytest.approx(-bound - 0.0148 * speed, rel=1e-12)


@pytest.mark.parametrize("h", [pytest.param(2e-4, marks=pytest.mark.long), 1e-3, 4e-3])
def test_thrown_rotor_stops_and_stays(h: float) -> None:
    rotor = Rotor(spec(), h, dq=3.0)
    for _ in range(round(2.0 / h)):
        rotor.step(0.0)
    stopped = rotor.q
    for _ in range(round(1.0 / h)):
        rotor.step(0.0)
    assert abs(float(rotor.dq[0])) < 1e-9
    assert rotor.q == pytest.approx(stopped, abs=1e-9)


def test_jitter_below_breakaway_moves_nothing_a_servo_could_read() -> None:
    rotor, rng = Rotor(spec()), np.random.default_rng(3)
    seen = []
    for _ in range(4000):
        rotor.step(float(rng.uniform(-0.4, 0.8)) * STATIC)
        seen.append((rotor.q, float(rotor.dq[0])))
    q, dq = np.abs(np.array(seen)).max(axis=0)
    assert q < PRESLIDING_RAD
    assert dq < VELOCITY_UNIT_RAD_PER_S / 2
    assert not rotor.friction.sliding.any()


@pytest.mark.parametrize("h", [pytest.param(2e-4, marks=pytest.mark.long), 1e-3, 4e-3])
def test_friction_gives_no_energy_over_a_random_motion(h: float) -> None:
    """Rotor and bristle together gain at most the motor's work, but for the step in which a sliding joint turns."""
    rng = np.random.default_rng(5)
    rotor = Rotor(spec(load=0.05, breakaway_load=0.1), h, dq=1.0)
    worst, turns = 0.0, 0
    for k in range(round(4.0 / h)):
        if k % round(0.02 / h) == 0:
            tau = float(rng.normal()) * 2.0 * STATIC
        before, q, dq = rotor.energy, rotor.q, float(rotor.dq[0])
        rotor.step(tau)
        gain = rotor.energy - before - tau * (rotor.q - q)
        turned = dq * float(rotor.dq[0]) < 0.0
        turns += turned
        worst = max(worst, 0.0 if turned else gain)
        assert gain < 2e-6 * (h / 1e-3) ** 2
    assert turns > 10
    assert worst <= 1e-15


def test_joint_without_dry_friction_is_viscous_alone() -> None:
    rotor = Rotor(spec(coulomb_Nm=0.0, breakaway_Nm=0.0), dq=2.0)
    for _ in range(1000):
        rotor.step(0.0)
    assert float(rotor.dq[0]) == pytest.approx(2.0 * np.exp(-0.0148 / INERTIA), rel=1e-4)
    rotor.friction.set_viscous(slice(0, 1), 10.0)
    for _ in range(100):
        rotor.step(0.0)
    assert abs(float(rotor.dq[0])) < 1e-9


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"coulomb_Nm": -0.1}, "coulomb_Nm"),
        ({"stribeck_rad_s": 0.0}, "stribeck_rad_s"),
        ({"stribeck_exponent": 0.0}, "stribeck_exponent"),
        ({"viscous_Nms_rad": np.nan}, "viscous_Nms_rad"),
        ({"load": 0.6, "breakaway_load": 0.4}, "below 1 in sum"),
    ],
)
def test_impossible_friction_is_refused(changes: dict[str, float], message: str) -> None:
    with pytest.raises(ActuatorError, match=message):
        spec(**changes)


def test_joints_do_not_mix() -> None:
    pair = FrictionSpec(**{key: np.array([value, 2.0 * value]) for key, value in MX64.items()})
    both = DryFriction(pair, np.full(2, INERTIA), H)
    alone = DryFriction(spec(), np.array([INERTIA]), H)
    dq: Vector = np.array([0.4, -0.1])
    for _ in range(30):
        D, f = both.torque(dq)
        D_alone, f_alone = alone.torque(dq[:1])
        assert (D[0], f[0]) == (D_alone[0], f_alone[0])
        both.step(dq)
        alone.step(dq[:1])
