"""Thresholds of noticing that follow from the cell: against what studies showed, and by each tolerance."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import configs
from agent.config import coordination, usual
from agent.config.cell import Cell, ConfigError, load_cell
from agent.config.friction import all_at_rest_Nm, at_rest_Nm, joint_friction, lifting_Nm, unfiled
from agent.config.noticing import derived, thresholds
from agent.config.schema.arm import Figure, Provenance
from agent.config.statics import held_Nm
from agent.control.residual import Channels, Residual
from agent.verify.check import examine
from agent.verify.finding import Verdict
from agent.verify.noticing import noticed, rested, unstated
from tests.support.arm_files import pressed_on, with_figures

# largest channels over realities without a fault; of two_models, the slow ones, over 200
SEEN = {
    "paper_real": (1.7, 0.31, 0.5, 0.08),
    "two_wx200": (1.0, 0.19, 0.74, 0.13),
    "two_models": (1.2, 0.25, 0.95, 0.207),
    "three_wx250s": (0.84, 0.2, 0.35, 0.12),
    "four_wx250s": (1.1, 0.24, 0.86, 0.2),
}
# and with 2 N on the object for half a second, in any direction
PUSHED = {
    "paper_real": (3.1, 0.1),
    "two_wx200": (1.67, 0.34),
    "three_wx250s": (1.37, 0.24),
    "four_wx250s": (0.98, 0.18),
}
# slow ones over 40 s of a few realities whose friction is the file's to a fifth or better
KNOWN = {
    "paper_real": (0.255, 0.065),
    "two_wx200": (0.228, 0.054),
    "two_models": (0.37, 0.104),
    "paper_adaptive": (0.145, 0.056),
    "three_wx250s": (0.369, 0.068),
    "four_wx250s": (0.45, 0.076),
}
TYPED = ("fast_N=3.0", "fast_Nm=0.5", "slow_N=2.0", "slow_Nm=0.3")


def cell(name: str = "paper_real", *overrides: str) -> Cell:
    return load_cell(Path(name), overrides)


@pytest.mark.parametrize("name", SEEN)
def test_thresholds_are_above_what_is_usual_and_no_higher_than_a_push(name: str) -> None:
    found = derived(cell(name))
    assert (np.array(found) >= (1.3, 1.3, 1.2, 1.2) * np.array(SEEN[name])).all(), found
    assert (np.array(found[:2]) <= 2.1 * np.array(SEEN[name][:2])).all(), found
    assert found.fast_N >= 1.75 * 2.0 / len(cell(name).arms), "2 N on the object are no trip"
    assert (np.array(found[:2]) > np.array(PUSHED.get(name, (0.0, 0.0)))).all(), "nor in realities"
    assert found.slow_N <= 1.25
    assert found.slow_Nm <= 0.3


@pytest.mark.parametrize("name", KNOWN)
def test_friction_counts_with_a_fifth_however_well_it_is_known(name: str) -> None:
    """It sticks and turns round all the same: limits without it were below what came in cells without any error."""
    exact, fifth, quarter = (derived(cell(name, f"tolerance.friction={x}")) for x in ([1, 1], [0.8, 1.2], [0.75, 1.2]))
    assert exact == fifth
    assert (np.array(exact[2:]) < np.array(quarter[2:])).all()
    assert (np.array(exact[2:]) >= 1.19 * np.array(KNOWN[name])).all(), exact


@pytest.mark.parametrize(
    ("override", "larger"),
    [
        ("tolerance.friction=[0.6, 2.5]", (True, True, True, True)),
        ("tolerance.friction=[0.1, 1.5]", (True, True, True, True)),
        ("controller.friction_feedforward=false", (True, True, True, True)),
        ("controller.observer.position_gain=0.5", (True, True, True, True)),
        ("safety.noticing.rate_per_s=60.0", (True, True, True, True)),
        ("tolerance.breakaway=0.5", (True, True, True, True)),
        ("tolerance.load_friction=0.05", (True, True, True, True)),
        ("tolerance.masses=0.9", (False, False, True, True)),
        ("tolerance.torque_constant=0.5", (False, False, True, True)),
        ("tolerance.zeros_rad=0.2", (False, False, True, False)),
        ("tolerance.base_rad=0.2", (False, False, True, False)),
        ("tolerance.grasp_m=0.1", (False, False, True, False)),
        ("tolerance.skew_s=0.2", (False, False, True, True)),
        ("safety.noticing.slow_per_s=10.0", (False, False, True, True)),
    ],
)
def test_each_tolerance_counts_where_it_acts(override: str, larger: tuple[bool, ...]) -> None:
    before, after = derived(cell()), derived(cell("paper_real", override))
    assert tuple(bool(x) for x in np.array(after) > np.array(before)) == larger


def test_without_feed_forward_all_friction_counts_at_its_most() -> None:
    off = "controller.friction_feedforward=false"
    most, usual = (derived(cell("paper_real", off, f"tolerance.friction=[0.6, {x}]")) for x in (1.5, 1.2))
    assert (np.array(most) > np.array(usual)).all()


def test_friction_that_sticks_and_grows_with_the_load_counts_as_it_is_at_rest(tmp_path: Path) -> None:
    """Above 1.3 times the largest of three realities; without breakaway and load in it the slow ones were below."""
    found = derived(with_figures(cell(), tmp_path, pressed_on))
    assert (np.array(found) >= 1.3 * np.array((2.51, 0.392, 1.09, 0.248))).all(), found
    shoulder, held_Nm = with_figures(cell(), tmp_path, pressed_on).arms[0].servos[0], -0.5
    wanted = 1.39 * shoulder.coulomb_Nm.value + 0.469 * 0.5
    assert at_rest_Nm(shoulder, held_Nm) == pytest.approx(wanted)
    assert lifting_Nm(shoulder, held_Nm) == pytest.approx(wanted / (1.0 - 0.469))
    as_shipped = cell().arms[0].servos[0]
    none = joint_friction(as_shipped)
    assert (none.stribeck_rad_per_s, none.stribeck_exponent) == (1.0, 1.0), "which say nothing without breakaway"
    assert at_rest_Nm(as_shipped, held_Nm) == lifting_Nm(as_shipped, held_Nm) == as_shipped.coulomb_Nm.value


def test_friction_that_grows_with_the_load_is_that_of_arm_and_object_together(tmp_path: Path) -> None:
    heavy = with_figures(cell("two_wx200", "object.mass_kg=0.4"), tmp_path, pressed_on)
    known = usual._known(heavy, heavy.arms[1])
    at = usual._places(known)[4]
    held = at.k.g + at.k.Jt[:, :3] @ np.array([0.0, 0.0, 0.5 * 0.4 * 9.81])
    friction = [at_rest_Nm(s, tau) for s, tau in zip(known.arm.servos, held.tolist(), strict=True)]
    wanted = np.linalg.inv(at.k.J).T * np.array(friction)
    np.testing.assert_allclose(_rubbing(known, at), known.model.task_basis.T @ wanted, atol=1e-12)


def _rubbing(known: usual._Arm, at: usual._Place) -> np.ndarray:
    """(6, n) J⁻ᵀ of the friction of each joint at rest."""
    return at.to_wrench * all_at_rest_Nm(known.arm.servos, held_Nm(known.cell, known.arm, at.k))


def test_friction_that_no_file_has_counts_beside_what_may_be_wrong_with_the_files(tmp_path: Path) -> None:
    rubbing = ("tolerance.breakaway=0.5", "tolerance.load_friction=0.05")
    stated = cell("two_wx200", *rubbing)
    known = usual._known(stated, stated.arms[1])
    at = usual._places(known)[4]
    held, coulomb = held_Nm(known.cell, known.arm, at.k), np.array([s.coulomb_Nm.value for s in known.arm.servos])
    wanted = 0.5 * coulomb + (0.5 * coulomb + 0.05 * np.abs(held))
    np.testing.assert_allclose(usual._unknown_Nm(known, at), wanted, atol=1e-12)
    first, *others = known.arm.servos
    figure = Figure(value=0.02, status=Provenance.ESTIMATED, source="a test")
    for key, wanted_of in (
        ("coulomb_Nm", (0.5, 0.05)), ("breakaway_Nm", (0.0, 0.05)), ("load_friction", (0.5, 0.0)),
        ("breakaway_load_friction", (0.0, 0.0)),
    ):  # fmt: skip
        assert unfiled(stated.tolerance, [first.model_copy(update={key: figure}), *others]) == wanted_of, key
    filed = with_figures(stated, tmp_path, pressed_on)
    as_filed = with_figures(cell("two_wx200"), tmp_path, pressed_on)
    assert derived(filed) == derived(as_filed), "a file that has such friction says how much there is"


def test_errors_of_base_and_grasp_shift_the_object_as_a_turn_and_a_slip_do() -> None:
    """Columns of the three turns about the base's origin, and of slips along the object's axes."""
    three = cell("three_wx250s")
    arm = three.arms[1]
    known = usual._known(three, arm)
    at = usual._places(known)[4]
    R = np.reshape(at.k.R_world_object, (3, 3))
    reach = np.array(at.k.p_object) - arm.T_world_base.translation
    turns = [three.tolerance.base_rad * np.cross(axis, reach) for axis in np.eye(3)]
    slips = [three.tolerance.grasp_m * R[:, axis] for axis in range(3)]
    wanted = [known.S @ known.model.task_basis[:, :3] @ shift / np.sqrt(3.0) for shift in (*turns, *slips)]
    torques = 1 + arm.n
    np.testing.assert_allclose(usual._errors(known, at)[:, torques : torques + 6].T, wanted, atol=1e-12)
    assert np.abs(reach).min() > 0.01


def test_sizes_are_those_of_twelve_places_of_the_run_against_the_first() -> None:
    short = cell("three_wx250s", "duration_s=3.0")
    arm = short.arms[0]
    known = usual._known(short, arm)
    gains, half = known.offline.gains, np.array([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])
    feedback = np.array([*gains.k_p, *gains.k_eps]) * half
    np.testing.assert_allclose(known.S, np.diag(np.array(gains.k_v) * feedback + known.offline.load_share * half))
    np.testing.assert_allclose(known.KH, np.diag(feedback))
    places = usual._places(known)
    desired = [short.trajectory().at(t) for t in np.arange(12) * 0.25]
    np.testing.assert_allclose([at.k.p_object for at in places], [d.p for d in desired], atol=1e-7)
    np.testing.assert_allclose([at.v for at in places], [d.v for d in desired], atol=1e-12)
    errors = [usual._errors(known, at) for at in places]
    changes = [
        np.column_stack([e - errors[0], known.S @ (short.tolerance.skew_s * at.v)])
        for e, at in zip(errors, places, strict=True)
    ]
    wanted = [
        [max(np.linalg.norm(columns[rows]) for columns in of) for rows in (slice(3), slice(3, 6))]
        for of in (
            [0.5 * _rubbing(known, at) for at in places],
            [usual._noise(known, at) for at in places],
            changes,
        )
    ]
    steps = [[*map(norms, (usual._noise(known, at), usual._speeds(known, at)))] for at in places]
    wanted.append(np.max(np.sum(steps, axis=1), axis=0))
    np.testing.assert_allclose(usual._sizes(known, places), wanted)
    each = [usual._known(short, one) for one in short.arms]
    found = usual.usual(short)
    largest = np.max([usual._sizes(one, usual._places(one)) for one in each], axis=0)
    np.testing.assert_allclose(found[:4], largest)
    turned = [np.abs(_rubbing(one, at)[2]).sum() for one in each for at in usual._places(one)]
    assert found.turned_N == pytest.approx(max(turned))


def test_what_a_feed_forward_that_turned_round_may_bear_is_along_gravity_alone() -> None:
    up, tilted, nowhere = (
        usual.usual(cell("three_wx250s", f"world.gravity_m_per_s2={g}"))
        for g in ("[0.0, 0.0, -9.81]", "[0.0, 6.0, 0.0]", "[0.0, 0.0, 0.0]")
    )
    assert up.turned_N == pytest.approx(1.37, abs=0.01)
    assert tilted.turned_N != pytest.approx(up.turned_N, rel=0.05)
    assert nowhere.turned_N == 0.0


def norms(columns: np.ndarray) -> list[float]:
    return [float(np.linalg.norm(columns[rows])) for rows in (slice(3), slice(3, 6))]


def test_half_a_step_of_a_measured_speed_is_that_much_momentum_times_the_rate() -> None:
    one = cell("three_wx250s", "safety.noticing.rate_per_s=20.0", "controller.observer.velocity_gain=0.5")
    known = usual._known(one, one.arms[1])
    at = usual._places(known)[3]
    half = 0.5 * 0.229 * 2.0 * np.pi / 60.0
    wanted = np.linalg.inv(at.k.J).T @ (20.0 * at.k.B * 0.5 * half)
    np.testing.assert_allclose(usual._speeds(known, at), known.model.task_basis.T @ wanted, atol=1e-12)


def test_of_a_move_behind_a_long_wait_errors_count_all_the_same(tmp_path: Path) -> None:
    """Where the twelve places were those before it alone, nothing changed along the motion."""
    motion = (
        '[trajectory]\nkind = "rest_to_rest"\np_from_m = [0.27, 0.0, 0.25]\np_to_m = [0.32, 0.0, 0.27]\nmove_s = 2.0\n'
    )
    text, found = (configs.CELLS_DIR / "two_wx200.toml").read_text(), []
    for wait_s in (0.5, 60.0):
        (tmp_path / "cell.toml").write_text(re.sub(r"\[trajectory\]\n(.+\n)+", f"{motion}wait_s = {wait_s}\n", text))
        found.append(derived(load_cell(tmp_path / "cell.toml", ["duration_s=100.0"])))
    assert found[0] == pytest.approx(found[1], rel=0.02)
    assert found[1].slow_N > 1.05 * derived(load_cell(tmp_path / "cell.toml", ["duration_s=50.0"])).slow_N


def test_a_squeeze_makes_something_of_torque_constants_that_are_off() -> None:
    pressed = [
        f"arms.{arm}.internal_wrench_N_Nm=[{N}, 0.0, 0.0, 0.0, 0.0, 0.0]" for arm, N in (("left", 9.0), ("right", -9.0))
    ]
    exact = ("tolerance.torque_constant=0.0",)
    more = [derived(cell("paper_real", *own)).slow_N for own in ((), pressed, exact, (*exact, *pressed))]
    assert more[1] > 1.005 * more[0]
    assert more[3] == pytest.approx(more[2], rel=0.01), "but for friction that grows with load"


def test_without_an_observer_all_of_an_encoders_step_comes_through() -> None:
    direct, observed = cell("paper_real", 'controller.velocity="servo"'), cell("paper_real")
    noise, speeds = [], []
    for one in (direct, observed):
        known = usual._known(one, one.arms[0])
        at = usual._places(known)[0]
        noise.append(usual._noise(known, at))
        speeds.append(usual._speeds(known, at))
    gains = observed.file.controller.observer
    np.testing.assert_allclose(noise[0] * max(0.2, gains.position_gain), noise[1])
    np.testing.assert_allclose(speeds[0] * gains.velocity_gain, speeds[1])


def test_what_does_not_change_along_the_motion_is_usual() -> None:
    still = ("trajectory.p_amplitude_m=[0.0, 0.0, 0.0]", "trajectory.angle_rad=0.0", "tolerance.friction=[1.0, 1.0]")
    rough = ("tolerance.masses=0.5", "tolerance.zeros_rad=0.1", "tolerance.base_rad=0.1", "tolerance.skew_s=0.5")
    assert derived(cell("paper_real", *still)) == derived(cell("paper_real", *still, *rough))


def test_an_observer_slower_than_those_of_the_studies_lowers_nothing() -> None:
    slow, usual = (derived(cell("paper_real", f"controller.observer.position_gain={g}")) for g in (0.02, 0.2))
    assert slow == usual
    assert derived(cell("paper_real", "controller.observer.position_gain=0.4")).fast_Nm > usual.fast_Nm


@pytest.mark.parametrize(("name", "fast"), [("paper_real", (1.75, 0.35)), ("four_wx250s", (0.875, 0.175))])
def test_the_floors_hold_where_nothing_is_uncertain(name: str, fast: tuple[float, float], tmp_path: Path) -> None:
    exact = ("masses=0.0", "torque_constant=0.0", "zeros_rad=0.0", "base_rad=0.0", "grasp_m=0.0")
    no_noise = ("safety.noticing.rate_per_s=0.01", "safety.noticing.slow_per_s=0.001")
    quiet = (*no_noise, "tolerance.skew_s=0.0", *(f"tolerance.{x}" for x in exact))
    without_friction = with_figures(cell(name, *quiet), tmp_path, lambda _: {"coulomb_Nm": 0.0})
    assert derived(without_friction) == Channels(*fast, 0.3, 0.03)


def test_what_the_file_gives_counts_and_the_rest_is_derived() -> None:
    found = thresholds(cell("paper_real", "safety.noticing.fast_N=7.0"))
    assert found == derived(cell())._replace(fast_N=7.0)
    assert thresholds(cell("paper_real", *(f"safety.noticing.{x}" for x in TYPED))) == Channels(3.0, 0.5, 2.0, 0.3)


def sensed_by(found: Cell) -> Residual | None:
    return coordination.residual(found, found.arms[1])


def test_the_agents_sense_with_them() -> None:
    planar, spatial = sensed_by(cell()), sensed_by(cell("three_wx250s"))
    assert planar is not None
    assert spatial is not None
    assert planar.limits == derived(cell())
    assert (planar.slow_per_s, spatial.slow_per_s) == (2.0, 4.0)
    given = sensed_by(cell("paper_real", "safety.noticing.slow_per_s=3.0"))
    assert given is not None
    assert given.slow_per_s == 3.0
    assert sensed_by(cell("paper")) is None


def test_a_pose_out_of_reach_names_the_arm_and_the_way_out() -> None:
    far = cell("paper_real", "trajectory.p_amplitude_m=[0.5, 0.0, 0.0]")
    with pytest.raises(ConfigError, match=r"arm left at t = .*give fast_N"):
        derived(far)
    typed = tuple(f"safety.noticing.{x}" for x in TYPED)
    assert thresholds(cell("paper_real", "trajectory.p_amplitude_m=[0.5, 0.0, 0.0]", *typed)).fast_N == 3.0
    (finding,) = noticed(far)
    assert finding.verdict == "refused"


def test_check_warns_of_arms_on_whose_friction_at_rest_nobody_says_anything(tmp_path: Path) -> None:
    real = 'driver="dynamixel"'
    (found,) = unstated(cell("paper_real", real))
    assert (found.where, found.verdict) == ("left, right", "warning")
    assert "tolerance.breakaway and tolerance.load_friction" in found.remedy
    for other in ("tolerance.breakaway=0.5", "tolerance.load_friction=0.05", "safety.noticing.enabled=false"):
        assert unstated(cell("paper_real", real, other)) == []
    assert unstated(cell("paper_real")) == [], "a simulated arm has what its file says"
    loaded = with_figures(cell("paper_real", real), tmp_path, lambda _: {"load_friction": 0.05})
    assert unstated(loaded) == []
    real_cell = cell("paper_real", real)
    measured = [
        s.model_copy(update={"coulomb_Nm": s.coulomb_Nm.model_copy(update={"status": Provenance.MEASURED})})
        for s in real_cell.arms[0].servos
    ]
    identified = replace(real_cell, arms=(replace(real_cell.arms[0], servos=tuple(measured)), real_cell.arms[1]))
    (left,) = unstated(identified)
    assert left.where == "right", "identify has looked for it on the other"
    assert found in examine(cell("paper_real", real), thorough=False).findings


def test_check_says_them() -> None:
    (finding,) = noticed(cell())
    fast = derived(cell()).fast_N
    assert finding.found.startswith(f"{fast:g} N, ")
    assert finding.found.endswith("(derived from the cell)")
    assert "partly given" in noticed(cell("paper_real", "safety.noticing.fast_N=7.0"))[0].found
    assert "(given)" in noticed(cell("paper_real", *(f"safety.noticing.{x}" for x in TYPED)))[0].found
    assert noticed(cell("paper")) == []


@pytest.mark.parametrize("key", Channels._fields)
def test_a_limit_below_what_comes_without_a_fault_is_warned_of(key: str) -> None:
    usual = getattr(derived(cell()), key) / 1.4
    above, below = (noticed(cell("paper_real", f"safety.noticing.{key}={part * usual:g}"))[1:] for part in (1.01, 0.99))
    assert not above
    (low,) = below
    assert (low.what, low.verdict, low.found) == (f"safety.noticing.{key}", Verdict.WARNING, f"{0.99 * usual:g}")
    assert low.wanted.startswith(f"≥ {usual:.3g}, ")


@pytest.mark.parametrize(
    ("settings", "found"),
    [
        (("simulation.ready_s=0.99",), "not looked at: simulated arms are READY for 0.99 s alone"),
        (("simulation.ready_s=1.0",), "looked at while READY"),
        (('driver="dynamixel"', "simulation.ready_s=0.0"), "looked at while READY"),
        (
            ("simulation.ready_s=1.24", "session.take_up_s=0.25"),
            "not looked at: simulated arms are READY for 1.24 s alone",
        ),
        (("simulation.ready_s=1.25", "session.take_up_s=0.25"), "looked at while READY"),
        (('safety.monitors.off=["gravity"]',), None),
    ],
)
@pytest.mark.fault("G6")
def test_the_check_says_where_the_torque_at_rest_is_not_looked_at(settings: tuple[str, ...], found: str | None) -> None:
    assert [finding.found for finding in rested(cell("paper_real", *settings))] == ([] if found is None else [found])
