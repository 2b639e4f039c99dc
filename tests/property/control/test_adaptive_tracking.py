"""The adaptive law on the simulated cells that ship, with every effect of real servos and without: promised bounds."""

from __future__ import annotations

import numpy as np
import pytest

import configs
from agent.config.cell import Cell, load_cell
from agent.loop import Outcome
from agent.safety import Flag
from tests.support.plant.inprocess import simulate

BOUND_M = 0.5e-3  # over one period of the motion behind the transient
TRANSIENT_S = 2.5
DURATION_S = TRANSIENT_S + 15.0
QUARTER_S = TRANSIENT_S + 3.75  # with the largest errors of a period; `make long` has all of it
WAY_S = 40.0  # of a box
LONG_S = 45.0  # of the run that begins with nothing: estimates go on moving
IDEAL = (
    "simulation.effects.friction=false",
    "simulation.effects.position_quantisation=false",
    "simulation.effects.velocity_quantisation=false",
    "simulation.effects.torque_quantisation=false",
    "simulation.effects.saturation=false",
    "loop_delay_s=0.0",
    'controller.velocity="servo"',
    "controller.friction_feedforward=false",
)
STARTS = {
    "nothing": ('controller.adaptive.start="zero"',),
    "half": ('controller.adaptive.start="nominal"', "controller.adaptive.start_scale=0.5"),
    "double": ('controller.adaptive.start="nominal"', "controller.adaptive.start_scale=2.0"),
}


def paper(*overrides: str) -> Cell:
    return load_cell(configs.CELLS_DIR / "paper_adaptive.toml", overrides)


@pytest.mark.parametrize(
    ("start", "effects", "duration_s"),
    [
        pytest.param("nothing", (), QUARTER_S, id="nothing"),
        pytest.param("nothing", (), DURATION_S, id="nothing, a period", marks=pytest.mark.long),
        pytest.param("nothing", (), LONG_S, id="nothing, for long", marks=pytest.mark.long),
        pytest.param("half", (), DURATION_S, id="half", marks=pytest.mark.long),
        pytest.param("double", (), DURATION_S, id="double", marks=pytest.mark.long),
        pytest.param(
            "nothing",
            (*IDEAL, "controller.adaptive.rotor_inertia=true"),
            DURATION_S,
            id="nothing, ideal actuators",
            marks=pytest.mark.long,
        ),
    ],
)
def test_it_tracks_whatever_it_believes_at_first(start: str, effects: tuple[str, ...], duration_s: float) -> None:
    """Ideal actuators: the reflected inertia is unknown too."""
    estimates: list[np.ndarray] = []

    def watch(_: int, outcomes: list[Outcome]) -> None:
        assert not any(o.flags & (Flag.NOT_FINITE | Flag.SINGULAR) for o in outcomes)
        estimates.append(np.concatenate([o.memory.estimate.arm for o in outcomes if o.memory.estimate is not None]))

    cell = paper(*STARTS[start], *effects)
    history = simulate(cell, duration_s, watch=watch)
    assert history.after(TRANSIENT_S)[0] <= BOUND_M
    upper = np.concatenate([data.upper.arm for data in (cell.offline(a).adaptation for a in cell.arms) if data])
    assert np.linalg.norm(estimates, axis=1).max() <= 2.0 * np.linalg.norm(upper)


def test_an_object_twice_as_heavy_as_configured_is_learnt() -> None:
    """Beside the non-adaptive law, which keeps its error.  The agents begin with what the cell file says."""
    believed = ("object.mass_kg=0.031", 'controller.adaptive.start="nominal"', *IDEAL)
    adaptive, known = (
        simulate(paper(*IDEAL), duration_s, agents_cell=paper(*believed, *kind)).after(TRANSIENT_S)[0]
        for kind, duration_s in (((), QUARTER_S), (('controller.kind="known"',), TRANSIENT_S + 2.5))
    )
    assert adaptive <= BOUND_M
    assert known > 5.0 * adaptive


@pytest.mark.parametrize(
    ("cell", "kind", "duration_s"),
    [
        pytest.param("three_wx250s", "known", WAY_S, marks=pytest.mark.long),
        pytest.param("four_wx250s", "known", WAY_S, marks=pytest.mark.long),
        pytest.param("three_wx250s", "adaptive", WAY_S, marks=pytest.mark.long),
        ("three_wx250s", "adaptive", 0.15 * WAY_S),
    ],
)
def test_arms_with_six_joints_carry_the_box_along_its_way(cell: str, kind: str, duration_s: float) -> None:
    """2 mm and 10 mrad with every servo effect on."""
    loaded = load_cell(configs.CELLS_DIR / f"{cell}.toml", (f'controller.kind="{kind}"',))
    position_m, attitude_rad = simulate(loaded, duration_s).after(loaded.file.report.transient_s)
    assert position_m <= 2e-3
    assert attitude_rad <= 10e-3


def test_two_different_arms_share_a_plane() -> None:
    cell = load_cell(configs.CELLS_DIR / "two_models.toml")
    position_m, attitude_rad = simulate(cell, QUARTER_S).after(TRANSIENT_S)
    assert position_m <= 1e-3
    assert attitude_rad <= 2e-3
