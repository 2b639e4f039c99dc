"""Identification on exact equations: base parameters, standard errors, and what a motion must have to be of use."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import configs
from agent.config.cell import Cell, load_cell
from agent.control.models import ArmModel
from agent.identify.columns import all_columns, base_of, described_parameters, object_torque
from agent.identify.equations import Options, low_pass
from agent.identify.fit import fit
from agent.identify.recording import IdentifyError
from agent.identify.solve import Part, least_squares
from drivers.interface import Vector
from tests.support.identify_rig import exact

CELLS = ("identify_wx200", "identify_mk2", "identify_wx250s")


def cell_of(name: str) -> Cell:
    return load_cell(configs.CELLS_DIR / f"{name}.toml")


def model_of(name: str) -> ArmModel:
    cell = cell_of(name)
    return cell.model(cell.arms[0])


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
    left = 0.901  # of 1 Hz by a raised cosine over 0.2 s to both sides
    assert np.abs(filtered - left * slow)[400:-400].max() < 1e-3


def test_the_low_pass_ends_so_that_a_stuck_joint_is_in_no_equation_away_from_it() -> None:
    values = np.zeros((400, 1))
    values[200] = 1.0
    filtered = low_pass(values, 5.0, 0.005)
    assert filtered.sum() == pytest.approx(1.0)
    assert np.all(filtered[161:240] > 0.0)
    assert not filtered[:161].any()
    assert not filtered[240:].any()


@pytest.mark.parametrize("name", [CELLS[0], *(pytest.param(name, marks=pytest.mark.long) for name in CELLS[1:])])
def test_exact_equations_give_the_exact_parameters(name: str) -> None:
    """No grid, no delay, no loop: what remains is what the window of the positions takes off fast motion."""
    recording = exact(cell_of(name), 0.5, (0.1, 0.37, 0.9), 60.0)
    found = fit(recording, Options())
    for i in [*found.base.gravity(), *(found.base.coulomb(j) for j in range(recording.arm.n))]:
        assert found.value[i] == pytest.approx(found.described[i], rel=2e-3, abs=5e-5), found.base.names[i]


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


def test_a_recording_is_the_same_equations_however_it_is_cut_into_stretches(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = exact(cell_of("identify_wx200"), 0.6, (0.3, 0.7), 25.0)
    monkeypatch.setattr("agent.identify.equations.STRETCH_S", 1e6)
    whole = fit(recording, Options())
    monkeypatch.setattr("agent.identify.equations.STRETCH_S", 3.0)
    monkeypatch.setattr("agent.identify.solve.BLOCK_ROWS", 37)
    cut = fit(recording, Options())
    np.testing.assert_allclose(cut.held_out.columns, whole.held_out.columns, rtol=0, atol=1e-10)
    np.testing.assert_allclose(cut.held_out.tau, whole.held_out.tau, rtol=0, atol=1e-10)
    assert np.array_equal(cut.held_out.used, whole.held_out.used)
    assert np.array_equal(cut.held_out.t, whole.held_out.t)
    np.testing.assert_allclose(cut.value, whole.value, rtol=0, atol=1e-9)
    np.testing.assert_allclose(cut.sigma, whole.sigma, rtol=1e-6, atol=1e-12)


def test_a_recording_that_a_slow_filter_leaves_nothing_of_is_refused() -> None:
    recording = exact(cell_of("identify_wx200"), 0.6, (0.3, 0.7), 20.0)
    with pytest.raises(IdentifyError, match="at least 10 s"):
        fit(recording, Options(cutoff_hz=0.4))
