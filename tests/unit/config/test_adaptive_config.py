"""`[controller.adaptive]`: what is refused, what is warned of, and that the warnings are those of the simulation."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config.adaptive import AdaptationError
from agent.config.cell import Cell, ConfigError, load_cell
from agent.config.schema.arm import ServoJoint
from agent.control.adaptation_bound import (
    Point,
    ReferenceTwist,
    believed_inertia,
    gain_limits,
    radius_with_adaptation,
)
from agent.control.friction import LOAD_MAX
from agent.control.stability import SampledLoop, coupled_inertia, spectral_radius
from agent.loop import Outcome
from agent.verify.check import Finding, Verdict, examine
from drivers.interface import Refusal
from sim_backend.physics.spec import PlantError
from tests.support.arm_files import sticking, with_figures
from tests.support.plant.inprocess import simulate
from tests.support.starts import start_joints

KIND = 'controller.kind="adaptive"'
ZERO = 'controller.adaptive.start="zero"'


def cell_of(name: str, *overrides: str) -> Cell:
    return load_cell(configs.CELLS_DIR / f"{name}.toml", overrides)


def finding(cell: Cell, what: str) -> Finding:
    return next(f for f in examine(cell).findings if f.what == what)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (("controller.adaptive.start_scale=6.0",), "start of the adaptive law, arm of left, mass of the link behind"),
        ((ZERO, "controller.adaptive.bounds.relative_min=0.2"), r"found 0, expected within its bounds 0\.0\d+ to"),
        (("controller.adaptive.bounds_object.mass_max_kg=0.01",), "object of left, mass: found 0.062"),
        (("controller.adaptive.bounds.rotor_inertia_max_kg_m2=1e-3",), "rotor inertia of shoulder"),
        (("controller.adaptive.coulomb=true", "controller.adaptive.bounds.coulomb_max_Nm=1e-3"), "Coulomb friction of"),
    ],
)
def test_bounds_that_exclude_the_start_are_refused_in_one_line(overrides: tuple[str, ...], message: str) -> None:
    with pytest.raises(AdaptationError, match=message) as caught:
        examine(cell_of("paper", KIND, *overrides))
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, Refusal)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("controller.adaptive.gamma=-1.0", "controller.adaptive.gamma in .*greater than or equal to 0"),
        ("controller.adaptive.gama=1.0", "did you mean gamma"),
        ('controller.adaptive.start="nothing"', "'zero' or 'nominal'"),
        ("controller.adaptive.bounds={relative_min=0.9, relative_max=0.5}", "relative_min ≤ relative_max"),
        ('controller.adaptive={start="zero", start_scale=0.5}', 'start_scale only with start = "nominal"'),
        ("controller.adaptive.factor.mass=-0.1", "factor.mass in .*greater than or equal to 0"),
    ],
)
def test_what_cannot_be_meant_is_refused(override: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        cell_of("paper", KIND, override)


def test_the_shipped_cells_adapt_within_the_recommended_gains() -> None:
    for name in ("paper_adaptive", "three_wx250s"):
        report = examine(cell_of(name, KIND))
        assert {f.what: f.verdict for f in report.findings if "gamma" in f.what or "start" in f.what}
        assert all(f.verdict is Verdict.OK for f in report.findings if f.what in ("gamma", "gamma_object"))


def test_an_arm_learns_and_forgets_as_fast_as_its_cell_says() -> None:
    rates = ("gamma=0.5", "gamma_object=3.0", "leak_per_s=2.5")
    cell = cell_of("paper_adaptive", *(f"controller.adaptive.{rate}" for rate in rates))
    learns = cell.offline(cell.arms[0]).adaptation
    assert learns is not None
    factors, of_object = cell.file.controller.adaptive.factor, cell.file.controller.adaptive.factor_object
    assert learns.leak_per_s == 2.5
    assert learns.gain.arm[0] == pytest.approx(0.5 * factors.mass)
    assert learns.gain.object[0] == pytest.approx(3.0 * of_object.mass)


@pytest.mark.parametrize("key", ["gamma", "gamma_object"])
def test_a_gain_above_the_stable_bound_is_warned_of_with_the_bound(key: str) -> None:
    found = finding(cell_of("paper", KIND, f"controller.adaptive.{key}=50.0"), key)
    assert found.verdict is Verdict.WARNING
    assert found.found == "50"
    assert 0.0 < float(found.wanted.removeprefix("≤ ")) < 50.0
    assert f"lower {key}" in found.remedy


def limit_of(cell: Cell, key: str = "gamma") -> float:
    return float(finding(cell, key).wanted.removeprefix("≤ "))


def test_the_bound_grows_with_the_rate_and_shrinks_with_the_start_error() -> None:
    at = {rate: limit_of(cell_of("paper_ideal", KIND, f"rate_hz={rate}")) for rate in (200.0, 500.0)}
    assert 4.0 < at[500.0] / at[200.0] < 8.0  # as the square of the period
    near = limit_of(cell_of("paper_ideal", KIND, "object.p_start_m=[0.3, 0.12, 0.0]"))
    assert near > 1.5 * at[200.0]


def largest_error(cell: Cell) -> float:
    try:
        return simulate(cell, 2.5).after(2.0)[0]
    except PlantError:
        return np.inf


@pytest.mark.parametrize("rate", [200.0, pytest.param(500.0, marks=pytest.mark.long)])
def test_simulation_is_stable_at_the_recommended_gain_and_not_far_above(rate: float) -> None:
    """Bounds of the estimates wide open, so that nothing but the gain keeps the loop together."""
    wide = (
        "controller.adaptive.bounds={relative_max=100.0, slack_m=1.0}",
        "controller.adaptive.bounds_object={relative_max=100.0}",
        "controller.adaptive.physical=false",
        "controller.adaptive.start_scale=0.5",
        f"rate_hz={rate}",
    )
    recommended = limit_of(cell_of("paper_ideal", KIND, *wide))
    slow, fast = (
        largest_error(cell_of("paper_ideal", KIND, *wide, f"controller.adaptive.gamma={recommended * factor}"))
        for factor in (1.0, 64.0)
    )
    assert slow < 0.6e-3
    assert fast > 5.0 * slow  # 14 and 43 times: torque limits keep what is unstable, and chaotic, from going farther


def test_an_empty_estimate_that_the_rate_cannot_hold_is_warned_of_and_diverges() -> None:
    """Without any believed inertia the reference acceleration feeds nothing back: 200 Hz is too slow for that."""
    what = "spectral radius with the estimates of the start"
    unstable = cell_of("paper", KIND, ZERO)
    found = finding(unstable, what)
    assert found.verdict is Verdict.WARNING
    assert "rotor_inertia = false" in found.remedy
    assert finding(cell_of("paper_adaptive"), what).verdict is Verdict.OK
    assert largest_error(unstable) > 0.01


def test_the_inertia_of_the_configured_estimate_is_the_coupled_inertia() -> None:
    for name in ("paper", "three_wx250s"):
        cell = cell_of(name, KIND)
        models, agents = [cell.model(a) for a in cell.arms], [cell.offline(a) for a in cell.arms]
        q = start_joints(cell)
        inertia = np.array(cell.file.object.inertia_kg_m2.matrix())
        R = models[0].object_pose(q[0]).rotation
        expected = coupled_inertia(models, q, cell.file.object.mass_kg, R @ inertia @ R.T)
        assert np.abs(believed_inertia(models, agents, q, start=False) - expected).max() < 1e-9


@pytest.mark.parametrize("delay", [0.0, 0.3, 1.0, 1.6, 2.0])
def test_without_gain_the_loop_with_adaptation_is_the_loop_without(delay: float) -> None:
    cell = cell_of("paper_ideal", KIND)
    models = [cell.model(a) for a in cell.arms]
    loop = SampledLoop(0.005, delay, [cell.offline(a).gains for a in cell.arms])
    M = coupled_inertia(models, start_joints(cell), 0.062, 1e-4 * np.eye(3))
    P = models[0].task_basis
    still = radius_with_adaptation(M, np.zeros((3, 3)), P, loop)
    assert still == pytest.approx(max(1.0, spectral_radius(M, M, P, loop)), abs=1e-9)


def test_a_late_torque_lowers_what_one_tick_may_adapt_by() -> None:
    """At a start so far off that the transient decides: (1 + d) T² λ_max(M⁻¹ G) ≤ 1."""
    cell = cell_of("paper_adaptive")
    models, agents = [cell.model(a) for a in cell.arms], [cell.offline(a) for a in cell.arms]
    q = start_joints(cell)
    still = ReferenceTwist(np.zeros(6), np.zeros(6))
    point = Point(q, coupled_inertia(models, q, 0.062, 1e-4 * np.eye(3)), still)
    loops = [SampledLoop(0.004, delay, [a.gains for a in agents]) for delay in (0.0, 0.5, 1.0)]
    limits = [gain_limits(models, agents, [point], np.full(6, 0.1), loop) for loop in loops]
    assert limits[0].arm / limits[1].arm == pytest.approx(1.5)
    assert limits[0].arm / limits[2].arm == pytest.approx(2.0)
    assert limits[0].object / limits[2].object == pytest.approx(2.0)


def test_estimates_never_leave_the_configured_box() -> None:
    cell = cell_of("paper_adaptive", "controller.adaptive.gamma=1.0", "controller.adaptive.physical=false")
    data = [cell.offline(a).adaptation for a in cell.arms]

    def watch(_: int, outcomes: list[Outcome]) -> None:
        for d, o in zip(data, outcomes, strict=True):
            assert (o.memory.estimate.arm >= d.lower.arm).all()
            assert (o.memory.estimate.arm <= d.upper.arm).all()

    simulate(cell, 1.0, watch=watch)


def sticking_cell(tmp_path: Path, *overrides: str, load: float = 0.05) -> Cell:
    def figures(joint: ServoJoint) -> Mapping[str, float]:
        return {**sticking(joint), "load_friction": load, "breakaway_load_friction": 0.1}

    return with_figures(cell_of("paper", KIND, *overrides), tmp_path, figures)


def test_joints_that_stick_have_their_figures_in_the_estimate(tmp_path: Path) -> None:
    """Rotor inertia and five of friction, each of all three joints; nothing of friction is estimated by default."""
    cell = sticking_cell(tmp_path)
    data = cell.offline(cell.arms[0]).adaptation
    coulomb, viscous = np.array([0.0843, 0.0843, 0.0078]), np.array([0.0347, 0.0347, 0.0362])
    assert data.nominal.arm[30:].reshape(6, 3)[1:].tolist() == pytest.approx(
        np.array([viscous, coulomb, 0.5 * coulomb, np.full(3, 0.05), np.full(3, 0.1)])
    )
    assert not data.gain.arm[33:].any()
    assert np.array_equal(data.upper.arm[33:], data.nominal.arm[33:])
    assert [j.stribeck_rad_per_s for j in data.sticking] == [0.3] * 3


@pytest.mark.parametrize(("key", "blocks"), [("viscous", [1]), ("coulomb", [2]), ("breakaway", [3]), ("load", [4, 5])])
def test_a_friction_column_that_is_on_estimates_its_figures_alone(tmp_path: Path, key: str, blocks: list[int]) -> None:
    factor = f"controller.adaptive.factor.{key}=0.5"
    cell = sticking_cell(tmp_path, f"controller.adaptive.{key}=true", factor, "controller.friction_feedforward=false")
    data = cell.offline(cell.arms[0]).adaptation
    estimated = data.gain.arm[30:].reshape(6, 3)[1:].any(axis=1)
    assert [1 + i for i in np.flatnonzero(estimated)] == blocks
    assert data.gain.arm[30 + 3 * blocks[0]] == 0.5 * cell.file.controller.adaptive.gamma
    assert np.array_equal(data.nominal.arm[30:].reshape(6, 3)[1:].any(axis=1), estimated)
    assert bool(data.sticking) == (key in ("breakaway", "load"))


@pytest.mark.parametrize("load", [0.05, 0.8])
def test_no_estimate_of_load_friction_stops_a_joint_for_good(tmp_path: Path, load: float) -> None:
    cell = sticking_cell(tmp_path, "controller.adaptive.load=true", load=load)
    upper = cell.offline(cell.arms[0]).adaptation.upper.arm[42:].reshape(2, 3)
    assert (upper.sum(axis=0) <= LOAD_MAX + 1e-12).all()
    assert (upper >= np.array([[load], [0.1]])).all()


def test_load_columns_lower_the_recommended_gain(tmp_path: Path) -> None:
    plain, loaded = (
        sticking_cell(tmp_path, "controller.adaptive.factor.load=1e4", f"controller.adaptive.load={on}")
        for on in ("false", "true")
    )
    assert limit_of(loaded) < 0.9 * limit_of(plain)
