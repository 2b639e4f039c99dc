"""The adaptive law on the simulated cells that ship, with every effect of real servos and without: promised bounds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import configs
from agent.config.cell import Cell, load_cell
from agent.control import adaptation
from agent.loop import Outcome
from agent.safety import Flag
from drivers.interface import Vector
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
NO_LEAK = "controller.adaptive.leak_per_s=0.0"
CONTINUOUS = (
    "rate_hz=1000.0", "simulation.substeps_per_cycle=2", "simulation.ready_s=0.0", "safety.noticing.enabled=false",
    "controller.alignment.enabled=false",
)  # fmt: skip
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


@dataclass(frozen=True)
class Fallen:
    """What became of the sum of the logged V of a run: how far it rose above its least before, and fell in all."""

    rose: float
    fell: float
    projections: Vector  # by how much each projection to what is physical changed it


def lyapunov(monkeypatch: pytest.MonkeyPatch, *overrides: str) -> Fallen:
    """A second of the shipped gains from θ̂(0) = 0 at 1 kHz, on a plant as configured."""
    data, cone, changes = adaptation.Adaptation, adaptation.to_physical, list[float]()
    advance = data.advance

    def watched(self: adaptation.Adaptation, *given: Any) -> Any:
        def projected(bodies: Vector) -> Vector:
            found = cone(bodies)
            if found is not bodies:
                count = bodies.size
                before, after = (
                    ((x.ravel() - self._nominal[:count]) ** 2) @ self._weight[:count] for x in (bodies, found)
                )
                changes.append(float(after - before) / 2.0)
            return found

        monkeypatch.setattr(adaptation, "to_physical", projected)
        return advance(self, *given)

    monkeypatch.setattr(data, "advance", watched)
    cell = paper(*IDEAL, *CONTINUOUS, *overrides)
    assert (cell.file.controller.adaptive.physical, cell.file.controller.adaptive.gamma) == (True, 5e-3)
    V = np.array(simulate(cell, 1.0).V)
    return Fallen(float((V - np.minimum.accumulate(V)).max()), float(V[0] - V[-1]), np.array(changes))


def test_with_the_shipped_gains_and_what_is_physical_v_falls_in_all_and_rises_by_a_bounded_part(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Neither K' = K nor the proof's projection: 0.099 up and 0.19 down, of 39.8; projections raise it by 0.018."""
    found = lyapunov(monkeypatch, NO_LEAK)
    assert 0.05 < found.rose < 0.12
    assert found.fell > 0.15
    assert 0.01 < found.projections.sum() < 0.03
    assert found.projections.max() < 1e-3


def test_where_the_reference_acceleration_has_the_gains_of_the_law_v_does_not_rise_though_projections_raise_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = lyapunov(monkeypatch, NO_LEAK, "controller.k_p_rate_per_s=154.0", "controller.k_eps_rate_rad_per_s=128.0")
    assert found.rose < 1e-3
    assert found.fell > 0.15
    assert found.projections.sum() > 0.01


def test_with_the_shipped_leak_v_only_falls(monkeypatch: pytest.MonkeyPatch) -> None:
    found = lyapunov(monkeypatch)
    assert found.rose < 1e-4
    assert found.fell > 39.0
    assert 0.005 < found.projections.sum() < 0.03
