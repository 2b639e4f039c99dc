"""Friction beside Coulomb and viscous, and the loop's delay, from runs of the simulated plant with known truth."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config.cell import Cell, load_cell
from agent.config.schema.arm import ServoJoint
from agent.identify.equations import Options
from agent.identify.fit import Fit, fit
from agent.identify.recording import Recording
from agent.identify.result import identified
from agent.identify.show import delay_line, estimates_table, friction_lines
from tests.support.arm_files import with_figures
from tests.support.identify_rig import recorded

PERIOD = 0.005
SHORTER = ("duration_s=24.0", "trajectory.motion_s=24.0")  # of the three periods of 20 s
TRUE = {"stribeck_rad_per_s": 0.3, "stribeck_exponent": 1.0}


@dataclass(frozen=True)
class Case:
    """What the plant has that the agents' arm file has not."""

    figures: Mapping[str, float]  # as shares of Coulomb friction, or as they are
    delay_s: float


CASES = {
    "simple": Case({}, 0.0035),
    "load": Case({"load_friction": 0.06}, 0.005),
    "both": Case({"breakaway_Nm": 0.5, "load_friction": 0.05}, 0.0065),
}


@dataclass(frozen=True)
class Known:
    """A run and its truth."""

    case: Case
    true: Cell
    recording: Recording
    fit: Fit


@pytest.fixture(
    scope="module",
    params=[pytest.param("simple", marks=pytest.mark.long), pytest.param("load", marks=pytest.mark.long), "both"],
    ids=str,
)
def known(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Known:
    case = CASES[request.param]

    def figures(joint: ServoJoint) -> Mapping[str, float]:
        own = dict(case.figures)
        if "breakaway_Nm" in own:
            own["breakaway_Nm"] *= joint.coulomb_Nm.value
        return own | (TRUE if own.keys() - {"load_friction"} else {})

    path = configs.CELLS_DIR / "identify_wx200.toml"
    cell, late = (load_cell(path, (*SHORTER, *more)) for more in ((), (f"simulation.effects.delay_s={case.delay_s}",)))
    true = with_figures(late, tmp_path_factory.mktemp(request.param), figures)
    recording = recorded(true, cell)
    return Known(case, true, recording, fit(recording, Options()))


def test_the_model_that_made_the_data_is_chosen(known: Known) -> None:
    assert set(known.fit.choice.keys) == set(known.case.figures)
    shape = known.fit.choice.shape
    assert (shape is not None) is ("breakaway_Nm" in known.case.figures)
    if shape is not None:
        assert shape.stribeck_exponent == TRUE["stribeck_exponent"]
        assert abs(shape.stribeck_rad_per_s - TRUE["stribeck_rad_per_s"]) < 3.0 * known.fit.speed_sigma
        assert known.fit.speed_sigma < 0.2 * TRUE["stribeck_rad_per_s"]


def test_its_figures_are_the_true_ones_within_their_standard_errors(known: Known) -> None:
    joints, base = range(known.recording.arm.n), known.fit.base
    assert set(known.fit.sticking) == {(key, j) for key in known.case.figures for j in joints}
    truth = {(key, j): getattr(known.true.arms[0].servos[j], key).value for key, j in known.fit.sticking}
    own = slice(len(base.kept), None)
    for term, value, sigma in zip(known.fit.sticking, known.fit.value[own], known.fit.sigma[own], strict=True):
        assert abs(value - truth[term]) < 3.5 * sigma, term
        assert value == pytest.approx(truth[term], rel=0.15), term
    for j in joints:
        coulomb = known.true.arms[0].servos[j].coulomb_Nm.value
        assert known.fit.value[base.coulomb(j)] == pytest.approx(coulomb, rel=0.05)


def test_the_loops_delay_is_found_to_a_part_of_a_cycle(known: Known) -> None:
    """Or to about half of one, where joints stick at every turn."""
    delay = known.fit.delay
    assert delay is not None
    assert delay.believed_s == PERIOD
    assert delay.sigma_s < (0.8 if known.case.figures else 0.1) * PERIOD
    assert abs(delay.value_s - known.case.delay_s) < 3.0 * delay.sigma_s


@pytest.mark.parametrize("believed_s", [*(pytest.param(s, marks=pytest.mark.long) for s in (0.001, 0.005)), 0.008])
def test_another_delay_in_the_cell_file_costs_viscous_friction_no_more_than_its_standard_errors(
    known: Known, believed_s: float
) -> None:
    """What is found beyond doubt is taken instead; what is not is part of the standard errors."""
    wrong = known.recording.delayed(believed_s)
    found = fit(wrong, Options())
    assert found.delay is not None
    assert found.delay.believed_s == believed_s
    assert found.delay.is_taken
    surely_wrong = abs(found.delay.value_s - believed_s) > 3.0 * found.delay.sigma_s
    assert surely_wrong or believed_s == PERIOD or known.case.figures, "half a cycle of doubt where joints stick"
    assert (found.delay.taken_s != believed_s) is surely_wrong
    if surely_wrong:
        assert delay_line(identified(wrong, Options(), found)).endswith(
            f"; the figures are those of {found.delay.taken_s:.4g} s: set loop_delay_s to it"
        )
    for j, servo in enumerate(known.true.arms[0].servos):
        i, true = found.base.viscous(j), servo.viscous_Nm_s_per_rad.value
        assert abs(found.value[i] - true) < 3.0 * found.sigma[i], servo.name
        assert found.value[i] == pytest.approx(true, rel=0.1 if known.case.figures else 0.02), servo.name


def test_the_held_out_torque_is_predicted_by_the_chosen_model(known: Known) -> None:
    assert np.all(known.fit.residual < 0.02 * known.fit.torque + 2e-3)


def test_model_and_figures_stand_in_arm_file_and_words(known: Known) -> None:
    result = identified(known.recording, Options(), known.fit)
    text = (configs.ARMS_DIR / "wx200.toml").read_text()
    new = {joint["name"]: joint for joint in tomllib.loads(result.arm_toml(text))["joints"]}
    keys = {*known.case.figures, *(TRUE if "breakaway_Nm" in known.case.figures else ())}
    for servo in known.true.arms[0].servos:
        for key in keys:
            entry = new[servo.name][key]
            assert entry["value"] == pytest.approx(getattr(servo, key).value, rel=0.15), (servo.name, key)
            assert entry["status"] == "measured"
        assert not ({"breakaway_Nm", "load_friction", "breakaway_load_friction"} - keys) & new[servo.name].keys()
    assert known.fit.choice.name in friction_lines(result)[0]
    assert len(friction_lines(result)) == 5  # and four candidates beside the first, each with its reason
    summary = result.summary()
    assert summary["friction_model"]["name"] == known.fit.choice.name
    assert known.fit.delay is not None
    assert delay_line(result).startswith(f"loop delay: {known.fit.delay.value_s:.4f} s ±")
    assert summary["loop_delay"] == known.fit.delay._asdict()


def test_what_is_the_best_of_a_few_has_no_standard_error(known: Known) -> None:
    result = identified(known.recording, Options(), known.fit)
    chosen = [figure for figure in result.figures if figure.key == "stribeck_exponent"]
    assert len(chosen) == (3 if "breakaway_Nm" in known.case.figures else 0)
    assert {figure.sigma for figure in result.figures if figure not in chosen}.isdisjoint({None, 0.0})
    table = estimates_table(result)
    spread = dict(zip(*(table.columns[i].cells for i in (0, 2)), strict=True))
    said = result.arm_toml((configs.ARMS_DIR / "wx200.toml").read_text())
    for figure in chosen:
        assert (figure.sigma, spread[f"{figure.key}, {figure.joint}"]) == (None, "best of a few")
        assert f'{figure.key} = {{ value = {figure.value!r}, status = "measured"' in said
    assert said.count("best of a few") == len(chosen)


def test_what_the_file_has_and_the_model_has_not_is_written_as_zero(known: Known, tmp_path: Path) -> None:
    """Coulomb friction was fitted without it, so it may not stay."""
    if known.case.figures:
        pytest.skip("the simple plant alone has less than such a file says")
    believed = with_figures(known.recording.cell, tmp_path, lambda _: {"load_friction": 0.1})
    recording = Recording(**{**vars(known.recording), "cell": believed, "arm": believed.arms[0]})
    text = (tmp_path / "wx200.toml").read_text()
    new = {j["name"]: j for j in tomllib.loads(identified(recording, Options(), known.fit).arm_toml(text))["joints"]}
    assert [new[s.name]["load_friction"]["value"] for s in believed.arms[0].servos] == [0.0] * 3
