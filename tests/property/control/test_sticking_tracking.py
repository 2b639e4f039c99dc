"""Cells whose simulated joints stick: what feed-forward of the same model is worth."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

import configs
from agent.config.cell import load_cell
from tests.support.arm_files import sticking, with_figures
from tests.support.plant.inprocess import History, simulate

TRANSIENT_S = 2.5  # every cell is settled by then
DURATION_S = TRANSIENT_S + 15.0  # one period of the trajectory behind it
QUARTER_S = TRANSIENT_S + 3.75  # every joint turns round; `make long` has the whole period


@cache
def run(name: str, *overrides: str, sticks: bool = True, duration_s: float = DURATION_S) -> History:
    """The same for all tests that ask: nobody changes it."""
    cell = load_cell(configs.CELLS_DIR / f"{name}.toml", overrides)
    with TemporaryDirectory() as folder:
        return simulate(with_figures(cell, Path(folder), sticking) if sticks else cell, duration_s)


@pytest.mark.parametrize(
    ("cell", "bound_m", "bound_rad", "duration_s"),
    [
        ("paper", 0.5e-3, 2e-3, QUARTER_S),
        pytest.param("paper", 0.5e-3, 2e-3, DURATION_S, marks=pytest.mark.long),
        pytest.param("three_wx250s", 1e-3, 6e-3, DURATION_S, marks=pytest.mark.long),
        pytest.param("two_wx200", 0.5e-3, 2e-3, DURATION_S, marks=pytest.mark.long),
        pytest.param("two_models", 0.5e-3, 2e-3, DURATION_S, marks=pytest.mark.long),
    ],
)
def test_joints_that_stick_cost_no_more_than_the_bound(
    cell: str, bound_m: float, bound_rad: float, duration_s: float
) -> None:
    position_m, attitude_rad = run(cell, duration_s=duration_s).after(TRANSIENT_S)
    assert position_m <= bound_m
    assert attitude_rad <= bound_rad


@pytest.mark.long  # what its model does: below
def test_without_feed_forward_they_cost_ten_times_as_much() -> None:
    without = run("paper", "controller.friction_feedforward=false", duration_s=QUARTER_S)
    assert without.after(TRANSIENT_S)[0] > 10.0 * run("paper").after(TRANSIENT_S)[0]


def test_a_model_without_breakaway_and_load_does_not_do_it() -> None:
    """The plant sticks, and the agents believe in Coulomb and viscous friction alone."""
    plain = load_cell(configs.CELLS_DIR / "paper.toml")
    with TemporaryDirectory() as folder:
        believing = simulate(with_figures(plain, Path(folder), sticking), QUARTER_S, agents_cell=plain)
    assert believing.after(TRANSIENT_S)[0] > 1.6 * run("paper", duration_s=QUARTER_S).after(TRANSIENT_S)[0]


def test_torque_is_as_calm_at_turns_as_where_nothing_sticks() -> None:
    """Mean change per tick over a motion in which every joint turns round."""
    plain = run("paper", sticks=False, duration_s=QUARTER_S)
    assert run("paper", duration_s=QUARTER_S).chatter(TRANSIENT_S) < 1.1 * plain.chatter(TRANSIENT_S)
