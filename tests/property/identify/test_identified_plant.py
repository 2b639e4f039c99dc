"""Identification from runs of the simulated plant with all servo effects: the truth within its standard errors."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.config.schema.arm import Provenance
from agent.identify.equations import Options
from agent.identify.fit import Fit, fit
from agent.identify.recording import Recording
from agent.identify.result import Outcome, identified
from agent.identify.show import estimates_table, residual_lines, scale_lines, validation_figure
from drivers.interface import Vector
from tests.support.identify_rig import from_plant, recorded

KEYS = ("rotor_inertia_kg_m2", "coulomb_Nm", "viscous_Nm_s_per_rad")


@dataclass(frozen=True)
class Known:
    """A run of the real plant whose friction and rotors are not what the agents believe."""

    recording: Recording
    factors: Mapping[str, Mapping[str, float]]  # true over believed
    truth: Vector
    fit: Fit

    @property
    def friction(self) -> list[int]:
        base, joints = self.fit.base, range(self.recording.arm.n)
        return [i for j in joints for i in (base.viscous(j), base.coulomb(j))]

    @property
    def rotors(self) -> list[int]:
        return [self.fit.base.rotor(j) for j in range(self.recording.arm.n)]


SHORTER = ("duration_s=20.0", "trajectory.motion_s=20.0")  # one of the three periods
RUNS = [
    ("identify_wx200", 1, SHORTER),
    *(
        pytest.param((*run, ()), marks=pytest.mark.long)
        for run in (("identify_wx250s", 4), ("identify_wx200", 2), ("identify_mk2", 3))
    ),
]


@pytest.fixture(scope="module", params=RUNS, ids=lambda run: f"{run[0]}-{run[1]}")
def known(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Known:
    name, seed, settings = request.param
    cell, random = load_cell(configs.CELLS_DIR / f"{name}.toml", settings), np.random.default_rng(seed)
    factors = {j: {key: float(random.uniform(0.5, 1.6)) for key in KEYS} for j in cell.arms[0].entry.controlled}
    recording, truth = from_plant(cell, tmp_path_factory.mktemp(name), factors)
    return Known(recording, factors, truth, fit(recording, Options()))


def test_friction_is_found_within_five_per_cent(known: Known) -> None:
    for i in known.friction:
        assert known.fit.value[i] == pytest.approx(known.truth[i], rel=0.05), known.fit.base.names[i]


def test_gravity_parameters_are_found_within_five_per_cent(known: Known) -> None:
    """Those that bend the arm: a first moment of 1e-4 kg·m is a torque of a millinewton metre and counts as none."""
    gravity = known.fit.base.gravity()
    assert len(gravity) >= 6
    for i in gravity:
        assert known.fit.value[i] == pytest.approx(known.truth[i], rel=0.05, abs=1e-4), known.fit.base.names[i]


def test_standard_errors_cover_the_truth(known: Known) -> None:
    judged = [*known.friction, *known.rotors, *known.fit.base.gravity()]
    z = np.abs(known.fit.value - known.truth)[judged] / known.fit.sigma[judged]
    assert z.max() < 3.0
    assert (z < 2.0).mean() >= 0.9


def test_the_loops_delay_is_found_whatever_rubs_and_turns(known: Known) -> None:
    delay = known.fit.delay
    assert delay is not None
    assert delay.taken_s == delay.believed_s, "the loop has the believed one"
    assert abs(delay.value_s - known.recording.cell.file.delay_s) < min(3.0 * delay.sigma_s, 1e-3)


def test_standard_errors_of_friction_are_small_enough_to_be_of_use(known: Known) -> None:
    for i in known.friction:
        assert known.fit.sigma[i] < 0.05 * known.truth[i], known.fit.base.names[i]


def test_held_out_torque_is_predicted_better_than_by_the_arm_file(known: Known) -> None:
    assert np.all(known.fit.residual < 0.5 * known.fit.residual_described)
    assert np.all(known.fit.residual < 0.02 * known.fit.torque + 2e-3)


def test_the_new_arm_file_has_the_true_figures(known: Known) -> None:
    arm = known.recording.arm
    text = (configs.ARMS_DIR / f"{arm.entry.model}.toml").read_text()
    new = {joint["name"]: joint for joint in tomllib.loads(_result(known).arm_toml(text))["joints"]}
    for servo in arm.servos:
        for key in KEYS:
            entry = new[servo.name][key]
            true = getattr(servo, key).value * known.factors[servo.name][key]
            assert entry["value"] == pytest.approx(true, rel=0.06), (servo.name, key)
            assert entry["status"] == Provenance.MEASURED
            assert known.recording.cell.fingerprint[:12] in entry["source"]
            assert known.recording.day in entry["source"]


def test_only_figures_of_the_identified_joints_change_in_the_arm_file(known: Known) -> None:
    arm = known.recording.arm
    text = (configs.ARMS_DIR / f"{arm.entry.model}.toml").read_text()
    pairs = list(zip(text.splitlines(), _result(known).arm_toml(text).splitlines(), strict=True))
    changed = [(old, new) for old, new in pairs if old != new]
    assert len(changed) == 3 * arm.n
    for old, new in changed:
        assert old.split(" = ")[0] == new.split(" = ")[0]
        assert old.split(" = ")[0] in KEYS


def test_an_uncertain_or_impossible_figure_keeps_its_old_value(known: Known) -> None:
    base = known.fit.base
    value, sigma = known.fit.value.copy(), known.fit.sigma.copy()
    value[base.coulomb(0)] = -0.01
    sigma[base.viscous(0)] = 0.5 * value[base.viscous(0)]
    result = identified(known.recording, Options(), replace(known.fit, value=value, sigma=sigma))
    outcome = {(f.joint, f.key): f.outcome for f in result.figures}
    joint = known.recording.arm.entry.controlled[0]
    assert outcome[joint, "coulomb_Nm"] is Outcome.NOT_POSITIVE
    assert outcome[joint, "viscous_Nm_s_per_rad"] is Outcome.UNCERTAIN
    text = (configs.ARMS_DIR / f"{known.recording.arm.entry.model}.toml").read_text()
    for document in (text, result.arm_toml(text)):
        entry = next(j for j in tomllib.loads(document)["joints"] if j["name"] == joint)
        assert entry["coulomb_Nm"]["status"] != "measured"
        assert entry["viscous_Nm_s_per_rad"]["status"] != "measured"


def test_what_is_shown_names_every_figure_and_every_gravity_parameter(known: Known) -> None:
    result = _result(known)
    arm = known.recording.arm
    rows = list(estimates_table(result).columns[0].cells)
    assert rows[: 3 * arm.n] == [f"{key}, {joint}" for joint in arm.entry.controlled for key in KEYS]
    assert rows[3 * arm.n :] == [f"{known.fit.base.names[i]}, kg·m" for i in known.fit.base.gravity()]
    assert [line.split(":")[0] for line in residual_lines(result)] == arm.entry.controlled
    panels = validation_figure(result).axes
    assert [ax.get_title(loc="left") for ax in panels[::2]] == arm.entry.controlled
    summary = result.summary()
    assert [p["name"] for p in summary["base_parameters"]] == list(known.fit.base.names)


UNLIKE = (0.97, 1.08, 1.0)


@pytest.fixture(scope="module")
def unlike() -> tuple[Recording, Fit]:
    """A run of servos whose torque constants are off by different factors, as those of no two servos are alike."""
    name, heavy = configs.CELLS_DIR / "identify_wx200.toml", (*SHORTER, "object.mass_kg=0.25")
    real = load_cell(name, [*heavy, f"simulation.reality.arms.arm.torque_constant={list(UNLIKE)}"])
    recording = recorded(real, load_cell(name, heavy))
    return recording, fit(recording, Options())


def test_servos_of_unlike_torque_constants_are_told_apart_and_no_friction_is_made_up(
    unlike: tuple[Recording, Fit],
) -> None:
    """Breakaway was, and no friction was certain enough to be written; the elbow bears most."""
    recording, found = unlike
    assert found.choice.name == "Coulomb and viscous"
    scales = found.scales
    assert scales.sigma[1] == 0.0
    assert scales.taken == pytest.approx([1.08 / 0.97, 1.0, 1.08], abs=4e-3)
    assert np.all(np.abs(scales.value - [1.08 / 0.97, 1.0, 1.08]) <= 3.5 * scales.sigma)
    for j, servo in enumerate(recording.arm.servos):
        for i, true in (
            (found.base.coulomb(j), servo.coulomb_Nm.value),
            (found.base.viscous(j), servo.viscous_Nm_s_per_rad.value),
        ):
            assert found.value[i] == pytest.approx(true / UNLIKE[j], rel=0.02), "in the torque that is commanded"
            assert abs(found.value[i] - true / UNLIKE[j]) < 3.0 * found.sigma[i]
        rotor = found.base.rotor(j)
        assert found.value[rotor] == pytest.approx(found.described[rotor] / UNLIKE[j], rel=0.08)
    part = found.held_out
    rest = np.where(part.used, part.tau - part.columns @ found.value, 0.0)
    assert np.sqrt((rest**2).sum(axis=0) / part.used.sum(axis=0)) == pytest.approx(found.residual)
    assert np.all(found.residual < 0.02 * found.torque + 2e-3)


def test_unlike_torque_constants_are_said_and_alike_ones_are_not(unlike: tuple[Recording, Fit], known: Known) -> None:
    recording, found = unlike
    result = identified(recording, Options(), found)
    lines = scale_lines(result)
    assert [line.split()[1] for line in lines] == ["shoulder", "wrist_angle"]
    assert "is asked for 1.11" in lines[0]
    told = result.summary()["torque_scales"]
    assert [scale["joint"] for scale in told] == ["shoulder", "elbow", "wrist_angle"]
    assert [scale["taken"] for scale in told] == found.scales.taken.tolist()
    assert scale_lines(_result(known)) == []


def _result(known: Known):  # type: ignore[no-untyped-def]
    return identified(known.recording, Options(), known.fit)
