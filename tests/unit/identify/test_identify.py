"""Identification: the truth within its standard errors, base parameters, and what a motion must have to be of use."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import pytest

import configs
from agent.config.cell import Cell, load_cell
from agent.config.schema.cell import Provenance
from agent.control.models import ArmModel
from agent.identify.columns import all_columns, base_of, described_parameters, object_torque
from agent.identify.fit import Fit, Options, Part, fit, least_squares, low_pass
from agent.identify.recording import IdentifyError, Recording
from agent.identify.result import Outcome, identified
from agent.identify.show import estimates_table, residual_lines, validation_figure
from drivers.interface import Vector
from tests.support.identify_rig import exact, from_plant

KEYS = ("rotor_inertia_kg_m2", "coulomb_Nm", "viscous_Nm_s_per_rad")
CELLS = ("identify_wx200", "identify_mk2", "identify_wx250s")


def cell_of(name: str) -> Cell:
    return load_cell(configs.CELLS_DIR / f"{name}.toml")


def model_of(name: str) -> ArmModel:
    cell = cell_of(name)
    return cell.model(cell.arms[0])


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


RUNS = [("identify_wx200", 1), ("identify_wx200", 2), ("identify_mk2", 3), ("identify_wx250s", 4)]


@pytest.fixture(scope="module", params=RUNS, ids=lambda run: f"{run[0]}-{run[1]}")
def known(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Known:
    name, seed = request.param
    cell, random = cell_of(name), np.random.default_rng(seed)
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


def _result(known: Known):  # type: ignore[no-untyped-def]
    return identified(known.recording, Options(), known.fit)


@pytest.mark.parametrize("name", CELLS)
def test_base_parameters_make_the_same_torque_as_all_parameters(name: str) -> None:
    model, random = model_of(name), np.random.default_rng(7)
    base = base_of(model)
    columns = all_columns(model, *random.normal(size=(3, 50, model.n)), 0.05)
    theta = random.normal(size=columns.shape[2])
    assert np.allclose(columns @ theta, columns[:, :, base.kept] @ (base.combination @ theta), atol=1e-9)


@pytest.mark.parametrize("name", CELLS)
def test_no_base_parameter_can_be_left_out(name: str) -> None:
    model, random = model_of(name), np.random.default_rng(7)
    columns = all_columns(model, *random.normal(size=(3, 300, model.n)), 0.05)[:, :, base_of(model).kept]
    flat = columns.reshape(-1, columns.shape[2])
    singular = np.linalg.svd(flat / np.linalg.norm(flat, axis=0), compute_uv=False)
    assert singular[-1] > 1e-4


def test_a_planar_arm_has_the_base_parameters_of_the_textbook() -> None:
    """Three links in a vertical plane: per joint two of friction, a rotor, two first moments, and two inertias."""
    base = base_of(model_of("identify_wx200"))
    assert base.names[6:] == (
        "rotor(shoulder) + I_yy(shoulder) + 0.0425 m(elbow) + 0.0425 m(wrist_angle)",
        "rotor(elbow)",
        "rotor(wrist_angle)",
        "h_x(shoulder) + 0.05 m(elbow) + 0.05 m(wrist_angle)",
        "h_z(shoulder) + 0.2 m(elbow) + 0.2 m(wrist_angle)",
        "h_x(elbow) + 0.2 m(wrist_angle)",
        "h_z(elbow)",
        "h_x(wrist_angle)",
        "h_z(wrist_angle)",
        "I_yy(elbow) + 0.04 m(wrist_angle)",
        "I_yy(wrist_angle)",
    )
    assert base.units[:2] == ("N·m·s/rad",) * 2
    assert base.units[-1] == "kg·m²"


@pytest.mark.parametrize("name", CELLS)
def test_columns_times_parameters_are_the_torque_of_the_model_and_its_friction(name: str) -> None:
    cell = cell_of(name)
    arm, model, random = cell.arms[0], cell.model(cell.arms[0]), np.random.default_rng(3)
    q, dq, ddq = random.normal(size=(3, model.n))
    columns = all_columns(model, q[None], dq[None], ddq[None], 0.05)
    tau = columns @ described_parameters(arm, model)
    viscous = np.array([s.viscous_Nm_s_per_rad.value for s in arm.servos])
    coulomb = np.array([s.coulomb_Nm.value for s in arm.servos])
    friction = coulomb * np.tanh(dq / 0.05) + viscous * dq
    assert np.allclose(tau[0], pin.rnea(model.model, model.data, q, dq, ddq) + friction, atol=1e-12)


@pytest.mark.parametrize("name", CELLS)
def test_the_objects_share_is_what_it_adds_to_the_arms_torque(name: str) -> None:
    cell = cell_of(name)
    model, random = cell.model(cell.arms[0]), np.random.default_rng(3)
    q, dq, ddq = random.normal(size=(3, model.n))
    share = object_torque(cell, model, all_columns(model, q[None], dq[None], ddq[None], 0.05))[0]
    carrying = model.model.copy()
    frame, obj = carrying.frames[model.object_id], cell.file.object
    body = pin.Inertia(obj.mass_kg, np.zeros(3), np.array(obj.inertia_kg_m2.matrix()))
    carrying.appendBodyToJoint(frame.parentJoint, body, frame.placement)
    added = pin.rnea(carrying, carrying.createData(), q, dq, ddq) - pin.rnea(model.model, model.data, q, dq, ddq)
    assert np.allclose(share, added, atol=1e-12)


def white_part(random: np.random.Generator, truth: Vector, noise: Vector, k: int = 4000) -> Part:
    columns = random.normal(size=(k, len(noise), len(truth)))
    tau = columns @ truth + noise * random.normal(size=(k, len(noise)))
    return Part(0.01 * np.arange(k), columns, tau, np.ones((k, len(noise)), dtype=np.bool_))


def test_standard_errors_are_those_of_repeated_experiments() -> None:
    truth, noise, random = np.array([1.0, -2.0, 0.5, 3.0]), np.array([0.1, 1.0]), np.random.default_rng(5)
    results = [least_squares(white_part(random, truth, noise)) for _ in range(60)]
    z = np.array([(value - truth) / sigma for value, sigma, _ in results])
    assert z.std() == pytest.approx(1.0, abs=0.2)
    assert abs(z.mean()) < 0.3


def test_standard_errors_know_that_neighbouring_residuals_are_alike() -> None:
    """Residuals that stay the same for a third of a second tell less than their number says."""
    truth, noise, random = np.array([1.0, -2.0, 0.5, 3.0]), np.zeros(2), np.random.default_rng(5)
    z = []
    for _ in range(60):
        part = white_part(random, truth, noise)
        columns = np.repeat(part.columns[::33], 33, axis=0)[: len(part.t)]
        held = np.repeat(random.normal(size=(len(part.t[::33]), 2)), 33, axis=0)[: len(part.t)]
        value, sigma, _ = least_squares(replace(part, columns=columns, tau=columns @ truth + held))
        z.append((value - truth) / sigma)
    assert np.std(z) == pytest.approx(1.0, abs=0.25)


def test_a_joint_that_fits_badly_weighs_little() -> None:
    truth, random = np.array([1.0, -2.0, 0.5]), np.random.default_rng(5)
    good = least_squares(white_part(random, truth, np.array([0.01, 0.01])))[1]
    bad = least_squares(white_part(random, truth, np.array([0.01, 100.0])))[1]
    assert np.all(bad < 2.0 * good)


def test_what_is_not_used_has_no_effect() -> None:
    truth, random = np.array([1.0, -2.0, 0.5]), np.random.default_rng(5)
    part = white_part(random, truth, np.array([0.1, 0.1]))
    used = part.used.copy()
    used[1000:2000, 1] = False
    spoilt = part.tau.copy()
    spoilt[1000:2000, 1] = 1e6
    a, b = (least_squares(replace(part, tau=tau, used=used))[0] for tau in (part.tau, spoilt))
    assert np.allclose(a, b, rtol=1e-12)


def test_the_low_pass_keeps_slow_motion_in_phase_and_takes_fast_noise_out() -> None:
    t = np.arange(4000)[:, None] * 0.005
    slow, fast = np.sin(2 * np.pi * 1.0 * t), np.sin(2 * np.pi * 40.0 * t)
    filtered = low_pass(slow + fast, 5.0, 0.005)
    assert np.abs(filtered - slow)[400:-400].max() < 1e-3


@pytest.mark.parametrize("name", CELLS)
def test_exact_equations_give_the_exact_parameters(name: str) -> None:
    """No grid, no delay, no loop: what remains is the filter's own error."""
    recording = exact(cell_of(name), 0.5, (0.1, 0.37, 0.9), 60.0)
    found = fit(recording, Options())
    for i in [*found.base.gravity(), *(found.base.coulomb(j) for j in range(recording.arm.n))]:
        assert found.value[i] == pytest.approx(found.described[i], rel=2e-3, abs=2e-5), found.base.names[i]


def test_slow_motion_is_refused_with_the_joint_and_its_speed() -> None:
    recording = exact(cell_of("identify_wx200"), 0.05, (0.1, 0.2), 60.0)
    with pytest.raises(
        IdentifyError, match=r"joint shoulder: found faster than 0\.2 rad/s forward in 0%.*both directions"
    ):
        fit(recording, Options())


def test_motion_one_way_only_is_refused() -> None:
    recording = exact(cell_of("identify_wx200"), 0.5, (0.1, 0.37, 0.9), 60.0)
    turning = recording.q.copy()
    turning[:, 1] = 0.3 * recording.period_s * np.arange(len(turning))
    with pytest.raises(IdentifyError, match=r"joint elbow: found faster than 0\.2 rad/s backward in 0%"):
        fit(replace(recording, q=turning), Options())


def test_motion_of_all_joints_together_is_refused_by_its_condition() -> None:
    recording = exact(cell_of("identify_wx200"), 0.5, (0.3,), 60.0)
    together = np.repeat(recording.q[:, :1], 3, axis=1)
    with pytest.raises(IdentifyError, match=r"excitation: found columns with a condition number.*more frequencies"):
        fit(replace(recording, q=together), Options())


def test_a_short_motion_is_refused() -> None:
    recording = exact(cell_of("identify_wx200"), 0.5, (0.1, 0.37, 0.9), 16.0)
    with pytest.raises(IdentifyError, match=r"motion to identify from.*record a longer motion"):
        fit(recording, Options(held_out=0.5))


def test_a_cut_off_above_the_sampling_is_refused() -> None:
    recording = exact(cell_of("identify_wx200"), 0.5, (0.1, 0.37, 0.9), 20.0)
    with pytest.raises(IdentifyError, match=r"cut-off of the low-pass: found 150 Hz, expected below 100 Hz"):
        fit(recording, Options(cutoff_hz=150.0))
