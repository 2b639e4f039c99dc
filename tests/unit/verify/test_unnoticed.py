"""How far off arms come where nobody notices: until the errors that hold them, or as far as the motion goes."""

from __future__ import annotations

import numpy as np
import pytest

from agent.verify.unnoticed import to_the_end, until_off_track
from tests.support.control.criterion_cells import gentle

M, RAD = 0.05, 0.3


def off(*x_m: float, turn_rad: float = 0.0) -> list[list[float]]:
    return [[x, 0.0, 0.0, 0.0, 0.0, turn_rad] for x in x_m]


def test_the_first_error_beyond_a_limit_counts_at_it_and_without_one_the_largest() -> None:
    way = np.array([off(0.01, 0.1, 0.2), off(0.01, -0.04, 0.02), off(0.0, 0.0, 0.0)])
    np.testing.assert_allclose(until_off_track(way, M, RAD)[:, 0], [0.05, -0.04, 0.0])
    passed = np.array([off(-0.06, 0.2)])
    np.testing.assert_allclose(until_off_track(passed, M, RAD)[:, 0], [-0.05])


def test_a_turn_holds_an_arm_as_a_way_does() -> None:
    (found,) = until_off_track(np.array([off(0.02, turn_rad=0.6)]), M, RAD)
    np.testing.assert_allclose(found, [0.01, 0.0, 0.0, 0.0, 0.0, 0.3])


def test_the_motion_goes_on_over_its_turning_point_for_a_period_or_as_long_as_the_run() -> None:
    ways = to_the_end(gentle("paper"), [0.0, 3.75])
    np.testing.assert_allclose(ways[:, 0], 0.0, atol=1e-12)
    assert ways[0, :, 0].max() == pytest.approx(0.05)
    assert ways[0, :, 0].min() == pytest.approx(-0.05)
    assert ways[1, :, 0].min() == pytest.approx(-0.1)
    assert ways[1, :, 5].max() == pytest.approx(2.0 * np.pi / 30.0)  # −π/30 is the turn at that end
    short = to_the_end(gentle("paper", "duration_s=3.75", "report.transient_s=1.0"), [0.0, 3.75])
    assert short[0, -1, 0] == pytest.approx(0.05)
    assert short[0, :, 0].min() >= 0.0
    np.testing.assert_allclose(short[1], 0.0, atol=1e-12)
