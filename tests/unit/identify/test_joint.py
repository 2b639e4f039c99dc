"""Friction, the speed over which breakaway falls off and the loop's delay, together, on torques that are known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.identify.equations import Options
from agent.identify.fit import Fit, fit
from agent.identify.friction import BREAKAWAY
from agent.identify.joint import together
from agent.identify.recording import Recording, acted
from agent.identify.result import Outcome, identified
from tests.support.identify_rig import exact

CELL = load_cell(configs.CELLS_DIR / "identify_wx200.toml")
PERIOD = 1.0 / CELL.file.rate_hz
SEEN = exact(CELL, 0.5, (0.1, 0.37, 0.9), 60.0)  # no breakaway, and torque that acts at once
SPEED = np.gradient(SEEN.q, PERIOD, axis=0)
HALF = 0.5 * np.array([servo.coulomb_Nm.value for servo in SEEN.arm.servos])
NOISE = np.random.default_rng(1).normal(size=SPEED.shape)


def late(tau: np.ndarray, periods: int, believed_s: float = PERIOD) -> Recording:
    """Recording of this torque, sent so many periods less half of one before it acted."""
    sent = np.concatenate([tau[periods:], np.repeat(tau[-1:], periods, axis=0)])
    return replace(SEEN, tau=acted(sent, believed_s / PERIOD), sent=sent, delay_s=believed_s)


def breakaway(speed_rad_per_s: float) -> np.ndarray:
    """Of half of Coulomb friction."""
    sticks: np.ndarray = HALF * np.tanh(SPEED / 0.02) * np.exp(-np.abs(SPEED) / speed_rad_per_s)
    return sticks


def coulomb_off(found: Fit) -> np.ndarray:
    """By how many standard errors Coulomb friction is off."""
    own = [found.base.coulomb(j) for j in range(3)]
    off: np.ndarray = (found.value[own] - 2.0 * HALF) / found.sigma[own]
    return off


@pytest.mark.parametrize(("true", "periods"), [(0.45, 1), (0.8, 2)])
def test_a_speed_between_those_that_are_tried_is_found_with_the_delay(true: float, periods: int) -> None:
    found = fit(late(SEEN.tau + breakaway(true), periods), Options())
    assert found.choice.keys == (BREAKAWAY,)
    assert found.choice.shape is not None
    assert found.choice.shape.stribeck_rad_per_s == pytest.approx(true, rel=0.04)
    assert found.choice.shape.stribeck_exponent == 1.0
    assert found.delay is not None
    assert found.delay.value_s == pytest.approx((periods - 0.5) * PERIOD, abs=0.2e-3)
    assert found.delay.taken_s == pytest.approx((periods - 0.5) * PERIOD, abs=0.2e-3)
    for i, half in zip([found.base.coulomb(j) for j in range(3)], HALF, strict=True):
        assert found.value[i] == pytest.approx(2.0 * half, rel=0.03)
    figures = {(f.joint, f.key): f for f in identified(SEEN, Options(), found).figures}
    speed = figures["elbow", "stribeck_rad_per_s"]
    assert (speed.sigma, speed.outcome) == (found.speed_sigma, Outcome.REPLACED)
    assert speed.sigma is not None
    assert 0.0 < speed.sigma < 0.1 * true


def test_what_a_joint_does_while_it_is_stuck_is_in_no_figure() -> None:
    """Any torque at all where a joint is slow: a filter with a tail takes it into the equations that are used."""
    stuck = np.where(np.abs(SPEED) < 0.15, 0.3, 0.0)
    free, found = (fit(late(tau, 1), Options()) for tau in (SEEN.tau, SEEN.tau + stuck))
    assert free.delay is not None
    assert found.delay is not None
    assert found.delay.value_s == pytest.approx(free.delay.value_s, abs=1e-9)
    np.testing.assert_allclose(found.value, free.value, rtol=0, atol=1e-9)


def test_breakaway_that_is_not_told_from_the_rest_is_in_the_errors_of_the_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agent.identify.fit.EXPONENTS", (1.0,))  # which the other one is too
    found = fit(late(SEEN.tau + breakaway(1.2) + 0.004 * NOISE, 1), Options())
    assert found.sticking == ()
    assert found.choice.keys == (BREAKAWAY,)
    assert np.all(np.abs(coulomb_off(found)) < 3.0)


def test_an_exponent_that_fits_as_well_is_in_the_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = late(SEEN.tau + breakaway(0.45), 1)
    alone = fit(recording, Options())
    monkeypatch.setattr("agent.identify.fit.clearly_larger", lambda *_: False)
    found = fit(recording, Options())
    assert len(alone.sticking) == 3
    assert found.sticking == (), "with the other one they are others by more than a quarter"


@pytest.mark.parametrize("periods", [1, 2])
def test_a_delay_that_other_friction_explains_as_well_is_not_taken(
    periods: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def other(*args: Any, hold: bool = False, **named: Any) -> Any:
        found = together(*args, hold=hold, **named)
        return replace(found, delay_s=found.delay_s + 3e-3) if hold else found

    recording = late(SEEN.tau, periods)
    alone = fit(recording, Options()).delay
    monkeypatch.setattr("agent.identify.fit.together", other)
    delay = fit(recording, Options()).delay
    assert alone is not None
    assert delay is not None
    assert alone.taken_s == pytest.approx((periods - 0.5) * PERIOD, abs=0.2e-3)
    assert delay.taken_s == delay.believed_s == PERIOD
    assert delay.by_friction_s > 2e-3
    assert delay.may_be_friction
    assert not alone.may_be_friction


def test_a_delay_that_is_not_seen_may_be_off_by_a_period(monkeypatch: pytest.MonkeyPatch) -> None:
    """And so may what it moves: viscous friction above all."""
    recording = late(SEEN.tau, 2)  # 7.5 ms, of which 5 are believed
    monkeypatch.setattr("agent.identify.fit._delay", lambda *_: None)
    found = fit(recording, Options())
    assert found.delay is None
    own = [found.base.viscous(j) for j in range(3)]
    assert np.all(np.abs(found.value[own] - found.described[own]) < found.sigma[own])
    assert np.all(found.sigma[own] < 2.5 * np.abs(found.value[own] - found.described[own]))
