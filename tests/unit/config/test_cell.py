"""The cell file: every wrong value is refused with the key, what was found, what is allowed and what to do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config.cell import Cell, ConfigError, cell_from_toml, load_cell
from agent.control import ik
from agent.control.trajectory import Sinusoid
from agent.process.simulated import plant_spec
from agent.verify.check import Verdict, examine

PAPER = configs.CELLS_DIR / "paper.toml"
TEXT = PAPER.read_text()


def changed(old: str, new: str) -> bytes:
    assert old in TEXT
    return TEXT.replace(old, new, 1).encode()


def refusal(raw: bytes) -> str:
    with pytest.raises(ConfigError) as caught:
        examine(cell_from_toml(raw, "paper.toml")).require()
    text = str(caught.value)
    assert "found " in text
    assert "expected " in text
    assert "\n" not in text
    return text


@pytest.fixture(scope="module")
def paper() -> Cell:
    return load_cell(PAPER)


def test_every_shipped_cell_passes_its_checks() -> None:
    cells = sorted(configs.CELLS_DIR.glob("*.toml"))
    assert len(cells) >= 3
    for path in cells:
        assert examine(load_cell(path)).ok, path.name


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("mass_kg = 0.062", "mas_kg = 0.062", "did you mean mass_kg"),
        ("mass_kg = 0.062\n", "", "object.mass_kg in paper.toml: found nothing"),
        ("mass_kg = 0.062", "mass_kg = -1.0", "greater than or equal to 0.000001"),
        ("mass_kg = 0.062", "mass_kg = nan", "object.mass_kg"),
        ("mass_kg = 0.062", 'mass_kg = "62 g"', "object.mass_kg"),
        ("rate_hz = 200.0", "rate_hz = 5.0", "greater than or equal to 20"),
        ("quat_start = [1.0, 0.0, 0.0, 0.0]", "quat_start = [1.0, 0.1, 0.0, 0.0]", "norm 1 to 1e-6"),
        ("axis = [0.0, 0.0, 1.0]", "axis = [0.0, 0.0, 2.0]", "an axis of norm 1"),
        ("load_share = 0.5", "load_share = 0.6", "load shares that sum to 1"),
        ("xx = 2.0005e-5", "xx = 2.0005e-3", "largest not above the sum of the others"),
        ('model = "widowx_mk2"', 'model = "widowx_mk3"', "widowx_mk2"),
        ('controlled = ["shoulder"', 'controlled = ["sholder"', "sholder"),
        ('kind = "sinusoid"', 'kind = "sinusoidal"', "trajectory"),
        ("q_near_rad = [-0.4, 0.8, -0.4] ", "q_near_rad = [-0.4, 0.8] ", "one q_near_rad per controlled joint"),
        ("locked_rad = { waist = 0.0, wrist_rotate = 0.0 }", "locked_rad = { waist = 0.0 }", "wrist_rotate"),
        ('name = "right"', 'name = "left"', "names that differ"),
        (
            "[controller.alignment]",
            '[controller.alignment]\nanchor = "middle"',
            "found 'middle', expected left or right",
        ),
        ('driver = "sim"', 'driver = "simulator"', "sim"),
        (
            "duration_s",
            "loop_delay_s = 0.006\nduration_s",
            "loop_delay_s in paper.toml: found 0.006, expected at most one control period, 0.005 s at 200 Hz; lower",
        ),
        ("duration_s", "loop_delay_s = -0.001\nduration_s", "loop_delay_s in paper.toml: found -0.001"),
        ("saturation = true", "saturation = true\ndelay_s = 0.6", "simulation.effects.delay_s"),
        (
            "saturation = true",
            "saturation = true\ndelay_cycles = 1",
            "delay_cycles in paper.toml: found a key of an earlier version, expected keys of this one; write loop_d",
        ),
        ("format = 1", "format = 2", "format"),
    ],
)
@pytest.mark.fault("G1")
def test_wrong_values_are_refused_with_the_key(old: str, new: str, expected: str) -> None:
    assert expected in refusal(changed(old, new))


@pytest.mark.parametrize(
    ("loop_delay_s", "periods"),
    [(0.0, 0.0), (1e-9, 0.0), (0.002, 0.4), (0.005, 1.0), (0.0049999999, 1.0), (0.005000001, 1.0), (None, 1.0)],
)
def test_the_delay_is_one_fact_of_the_cell(loop_delay_s: float | None, periods: float) -> None:
    file = load_cell(PAPER, [] if loop_delay_s is None else [f"loop_delay_s={loop_delay_s!r}"]).file
    assert file.delay_periods == pytest.approx(periods, abs=1e-12)
    assert (file.delay_periods in {0.0, 1.0}) == (periods in {0.0, 1.0})
    assert file.delay_s == file.simulated_delay_s == pytest.approx(periods / 200.0)


def test_the_simulated_delay_may_differ_and_only_the_plant_takes_it() -> None:
    cell = load_cell(PAPER, ["simulation.effects.delay_s=0.0123"])
    assert (cell.file.delay_s, cell.file.simulated_delay_s) == (0.005, 0.0123)
    assert {arm.actuator.delay_s for arm in plant_spec(cell, examine(cell).q_start).arms} == {0.0123}
    own = load_cell(PAPER, ["loop_delay_s=0.001"])
    assert {arm.actuator.delay_s for arm in plant_spec(own, examine(own).q_start).arms} == {0.001}


def test_a_cell_is_planar_where_every_arm_is() -> None:
    flat, spatial = (load_cell(configs.CELLS_DIR / f"{name}.toml") for name in ("two_wx200", "three_wx250s"))
    assert (flat.planar, spatial.planar) == (True, False)
    assert not replace(flat, arms=(flat.arms[0], spatial.arms[0])).planar


def test_text_that_is_not_toml_is_refused_with_the_line() -> None:
    assert "line 1" in refusal(b"format = = 1")


def test_missing_file_names_the_cells_that_ship(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"No such file.*by name: .*paper, "):
        load_cell(tmp_path / "none.toml")


def test_unreachable_grasp_says_by_how_much() -> None:
    text = refusal(changed("p_start_m = [0.301, 0.123, 0.0]", "p_start_m = [0.9, 0.123, 0.0]"))
    assert "grasp of arm left at the start" in text
    assert "unreachable by" in text


def test_a_grasp_out_of_the_plane_is_told_apart_from_one_out_of_reach() -> None:
    assert "outside the plane" in refusal(
        changed("p_start_m = [0.301, 0.123, 0.0]", "p_start_m = [0.301, 0.123, 0.05]")
    )


def test_attitude_error_of_half_a_turn_is_refused_and_names_the_rotation() -> None:
    raw = changed("axis = [0.0, 0.0, 1.0]", "quat_centre = [0.0, 0.0, 0.0, 1.0]\naxis = [0.0, 0.0, 1.0]")
    # the desired attitude along the path is out of reach as well; the start is judged first
    cell = cell_from_toml(raw, "paper.toml")
    with pytest.raises(ConfigError):
        examine(cell).require()
    from agent.verify.check import _start

    e_eta = next(f for f in _start(cell) if f.what == "e_η(0)")
    assert e_eta.verdict is Verdict.REFUSED
    assert "180.0°" in e_eta.remedy


def test_singular_start_is_refused() -> None:
    """A floor that the start pose does not reach is the same refusal as a stretched arm, without its IK failing."""
    assert "smallest singular value of J (left)" in refusal(
        changed("[report]", "[safety]\nsigma_min = 0.2\n\n[report]")
    )


def test_stretched_arm_has_a_singular_jacobian(paper: Cell) -> None:
    model = paper.model(paper.arms[0])
    elbow_straight = np.arctan2(0.04825, 0.14203) - np.pi / 2
    along = np.linalg.svd(model.jacobian(np.array([0.9, elbow_straight, 0.0])), compute_uv=False)[-1]
    bent = np.linalg.svd(model.jacobian(np.array([0.9, elbow_straight + 0.8, 0.0])), compute_uv=False)[-1]
    assert along < 1e-3 < 0.02 < bent


@pytest.mark.fault("S7")
def test_a_servo_without_torque_cannot_be_controlled() -> None:
    raw = TEXT.replace('"wrist_angle"]', '"wrist_angle", "wrist_rotate"]', 1).replace(", wrist_rotate = 0.0", "", 1)
    raw = raw.replace("q_near_rad = [-0.4, 0.8, -0.4]", "q_near_rad = [-0.4, 0.8, -0.4, 0.0]", 1)
    assert "AX-12A" in refusal(raw.encode())


def test_unstable_rate_is_refused_with_the_radius() -> None:
    text = refusal(changed("rate_hz = 200.0", "rate_hz = 120.0"))
    assert "spectral radius at 120 Hz, 8.33 ms delay" in text
    assert "raise rate_hz" in text


@pytest.mark.fault("G4")
def test_too_much_torque_is_refused() -> None:
    text = refusal(changed("[report]", "[safety]\ntau_max_fraction_of_stall = 0.05\n\n[report]"))
    assert "torque along the trajectory" in text
    assert "% of stall" in text


def test_unknown_arm_names_the_arms(paper: Cell) -> None:
    with pytest.raises(ConfigError, match="left or right"):
        paper.arm("middle")


def test_overrides_change_values_and_the_fingerprint(paper: Cell) -> None:
    other = load_cell(PAPER, ["duration_s=20", "arms.left.load_share=0.3", "arms.right.load_share=0.7"])
    assert other.file.duration_s == 20
    assert [a.entry.load_share for a in other.arms] == [0.3, 0.7]
    assert other.fingerprint != paper.fingerprint
    again = cell_from_toml(other.toml, "again")
    assert again.fingerprint == other.fingerprint


@pytest.mark.parametrize("text", ["duration_s", "arms.middle.load_share=1"])
def test_wrong_overrides_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="override"):
        load_cell(PAPER, [text])


def test_start_configuration_holds_the_object_at_its_start_pose(paper: Cell) -> None:
    for arm, q in zip(paper.arms, examine(paper).q_start, strict=True):
        pose = paper.model(arm).object_pose(q)
        np.testing.assert_allclose(pose.homogeneous, paper.T_world_object_start.homogeneous, atol=1e-9)


def test_the_paper_cell_is_the_papers_experiment(paper: Cell) -> None:
    trajectory = paper.trajectory()
    assert isinstance(trajectory, Sinusoid)
    t = 2.3
    s = np.sin(2 * np.pi * t / 15)
    desired = trajectory.at(t)
    np.testing.assert_allclose(desired.p, [0.3 + 0.05 * s, 0.12, 0.0], atol=1e-15)
    a = np.pi / 60 * s
    np.testing.assert_allclose(desired.quat, [np.cos(a), 0.0, 0.0, -np.sin(a)], atol=1e-15)
    gains = [paper.offline(arm).gains for arm in paper.arms]
    assert all(g.k_p == (150.0,) * 3 and g.k_eps == (100.0,) * 3 and g.k_v == (2.5,) * 6 for g in gains)


def test_ik_reports_how_near_it_came(paper: Cell) -> None:
    target = paper.T_world_object_start.copy()
    target.translation = np.array([2.0, 0.0, 0.0])
    with pytest.raises(ik.Unreachable) as caught:
        ik.solve(paper.model(paper.arms[0]), target, np.zeros(3))
    assert caught.value.distance_m > 1.0


def with_internal(force: str, extra: str = "") -> bytes:
    raw = TEXT
    for place in ("p_object_ee_m = [-0.04", "p_object_ee_m = [0.04"):
        sign = "-" if "[-0" in place else ""
        raw = raw.replace(place, f"internal_wrench_N_Nm = {force.replace('F', sign + '1')}\n{extra}{place}", 1)
    return raw.encode()


def test_internal_wrenches_reach_the_agents_and_move_nothing() -> None:
    cell = cell_from_toml(with_internal("[F.0, 0.0, 0.0, 0.0, 0.0, 0.0]"), "paper.toml")
    examine(cell).require()
    wrenches = np.array([cell.offline(arm).internal_wrench for arm in cell.arms])
    np.testing.assert_allclose(wrenches[0], [-1.0, 0, 0, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(wrenches.sum(axis=0), 0.0, atol=1e-12)


def test_internal_wrench_above_the_grip_is_refused() -> None:
    text = refusal(with_internal("[F.0, 0.0, 0.0, 0.0, 0.0, 0.0]", "grip_force_max_N = 0.5\n"))
    assert "force on the grasp, object and internal" in text
    assert "grip harder" in text


def test_internal_wrench_above_the_torques_is_refused() -> None:
    text = refusal(with_internal("[F00.0, 0.0, 0.0, 0.0, 0.0, 0.0]"))
    assert "torque along the trajectory" in text
    assert text.endswith("or squeeze less")


def test_internal_wrench_out_of_the_plane_is_a_warning() -> None:
    report = examine(cell_from_toml(with_internal("[0.0, 0.0, F.0, 0.0, 0.0, 0.0]"), "paper.toml"))
    assert any(f.what.startswith("internal wrench out of the plane") for f in report.findings)
