"""`[tolerance]`: what a cell that says nothing lives with, and ranges that cannot be meant."""

from __future__ import annotations

import math

import pytest

import configs
from agent.config.cell import ConfigError, load_cell

PAPER = configs.CELLS_DIR / "paper.toml"


def test_a_cell_that_says_nothing_lives_with_the_stated_realities() -> None:
    tolerance = load_cell(PAPER).tolerance
    assert (tolerance.base_m, tolerance.base_rad, tolerance.grasp_m) == (1e-3, math.radians(0.5), 2e-3)
    assert (tolerance.masses, tolerance.object, tolerance.torque_constant) == (0.1, 0.2, 0.1)
    assert tolerance.friction == (0.6, 1.5)
    assert tolerance.pads_N_per_m == (1e3, 1e6)
    assert tolerance.pads_Nm_per_rad == (5.0, 1e3)
    assert tolerance.delay == (0.8, 1.25)
    assert tolerance.skew_s == 5e-3


def test_zeros_of_a_planar_arm_may_be_off_by_more_than_those_of_six_joints() -> None:
    tolerance = load_cell(PAPER).tolerance
    assert tolerance.zeros_of(3) == math.radians(0.5)
    assert tolerance.zeros_of(6) == tolerance.zeros_of(7) == math.radians(0.1)


def test_zeros_that_are_given_hold_for_every_arm() -> None:
    tolerance = load_cell(PAPER, ["tolerance.zeros_rad=0.003"]).tolerance
    assert tolerance.zeros_of(3) == tolerance.zeros_of(6) == 0.003


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("tolerance.delay=[1.1, 1.25]", "a range with 1 in it, which is what the files say"),
        ("tolerance.friction=[0.5, 0.9]", "a range with 1 in it, which is what the files say"),
        ("tolerance.pads_N_per_m=[1e6, 1e3]", "a range from low to high"),
        ("tolerance.zero_rad=0.01", "did you mean zeros_rad?"),
        ("tolerance.base_rad=0.5", "0.2"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_the_key(override: str, expected: str) -> None:
    key = override.partition("=")[0]
    with pytest.raises(ConfigError, match=key.replace(".", r"\.")) as caught:
        load_cell(PAPER, [override])
    assert expected in str(caught.value)
