"""How well the paper's cell tracks, against the bounds that users were promised; plant and agents in one process."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from tests.support.few import long
from tests.support.plant.inprocess import History, simulate

TRANSIENT_S = 2.5  # every cell is settled by then
DURATION_S = TRANSIENT_S + 15.0  # one period of the trajectory behind it
QUARTER_S = TRANSIENT_S + 3.75  # has the largest errors of the position; `make long` has the whole period
SERVOS = ('controller.velocity="servo"',)
WITHOUT = ("controller.friction_feedforward=false",)


def run(name: str, *overrides: str, duration_s: float = DURATION_S) -> History:
    """The same for all tests that ask: nobody changes it."""
    return _run(name, overrides, duration_s)


@cache
def _run(name: str, overrides: tuple[str, ...], duration_s: float) -> History:
    return simulate(load_cell(configs.CELLS_DIR / f"{name}.toml", overrides), duration_s)


@pytest.mark.parametrize(
    ("cell", "overrides", "bound_m", "bound_rad", "duration_s"),
    [
        long(("paper_ideal", (), 0.3e-3, 0.5e-3, QUARTER_S)),
        ("paper", (), 1e-3, 2e-3, QUARTER_S),
        ("paper", SERVOS, 1e-3, 2e-3, QUARTER_S),
        long(("paper", WITHOUT, 4e-3, np.inf, QUARTER_S)),
        pytest.param("paper_ideal", (), 0.3e-3, 0.5e-3, DURATION_S, marks=pytest.mark.long),
        pytest.param("paper", (), 1e-3, 2e-3, DURATION_S, marks=pytest.mark.long),
        pytest.param("paper", SERVOS, 1e-3, 2e-3, DURATION_S, marks=pytest.mark.long),
        pytest.param("paper", WITHOUT, 4e-3, np.inf, DURATION_S, marks=pytest.mark.long),
        pytest.param("two_wx200", (), 1e-3, 2e-3, DURATION_S, marks=pytest.mark.long),
    ],
    ids=[
        "ideal",
        "all servo effects",
        "servo velocities",
        "no feed-forward",
        "ideal, a period",
        "all servo effects, a period",
        "servo velocities, a period",
        "no feed-forward, a period",
        "two wx200",
    ],
)
def test_errors_after_the_transient(
    cell: str, overrides: tuple[str, ...], bound_m: float, bound_rad: float, duration_s: float
) -> None:
    history = run(cell, *overrides, duration_s=duration_s)
    position_m, attitude_rad = history.after(TRANSIENT_S)
    assert position_m <= bound_m
    assert attitude_rad <= bound_rad


@pytest.mark.parametrize(
    ("cell", "bound_m", "bound_rad", "chatter_Nm", "duration_s"),
    [
        ("paper_real", 0.5e-3, 2e-3, 0.022, QUARTER_S),
        pytest.param("paper_real", 0.5e-3, 2e-3, 0.022, DURATION_S, marks=pytest.mark.long),
        pytest.param("two_wx200", 0.5e-3, 2e-3, 0.030, DURATION_S, marks=pytest.mark.long),
        pytest.param("two_models", 0.5e-3, 2e-3, 0.037, DURATION_S, marks=pytest.mark.long),
        pytest.param("paper_adaptive", 0.5e-3, 2e-3, 0.022, DURATION_S, marks=pytest.mark.long),
        pytest.param("three_wx250s", 1e-3, 6e-3, 0.013, DURATION_S, marks=pytest.mark.long),
        pytest.param("four_wx250s", 1e-3, 6e-3, 0.013, DURATION_S, marks=pytest.mark.long),
    ],
)
def test_cells_for_real_arms_cost_little_accuracy_and_are_calm(
    cell: str, bound_m: float, bound_rad: float, chatter_Nm: float, duration_s: float
) -> None:
    """Gains that live with pads and errors of calibration; calm: half of what the printed gains change per tick."""
    history = run(cell, duration_s=duration_s)
    position_m, attitude_rad = history.after(5.0)
    assert position_m <= bound_m
    assert attitude_rad <= bound_rad
    assert history.chatter(5.0) <= chatter_Nm


@pytest.mark.parametrize(("cell", "duration_s"), [("paper_ideal", QUARTER_S), ("paper", QUARTER_S)])
def test_the_start_error_decays(cell: str, duration_s: float) -> None:
    """Of runs that are made above."""
    history = run(cell, duration_s=duration_s)
    assert history.e_p_m[0] > 3e-3
    assert history.after(1.0)[0] < 0.3 * history.e_p_m[0]


def test_torques_stay_below_half_of_stall() -> None:
    unbounded = ("safety.tau_max_fraction_of_stall=1.0",)
    cell = load_cell(configs.CELLS_DIR / "paper.toml", unbounded)
    stall = np.concatenate([arm.tau_stall_Nm for arm in cell.arms])
    assert (np.abs(np.array(run("paper", *unbounded, duration_s=QUARTER_S).tau)).max(axis=0) < 0.5 * stall).all()


def test_the_observer_calms_the_torque() -> None:
    """What it is for: the same accuracy with a fraction of the torque changes that quantised velocities cause."""
    raw, observed = (run("paper", *more, duration_s=QUARTER_S) for more in (SERVOS, ()))
    assert observed.chatter(TRANSIENT_S) < 0.5 * raw.chatter(TRANSIENT_S)
    assert observed.after(TRANSIENT_S)[0] < 1.5 * raw.after(TRANSIENT_S)[0]
