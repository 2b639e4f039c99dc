"""Realities drawn from a seed within a cell's tolerance, or given in its file, and the plant built from them."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import tomli_w

import configs
from agent.config.cell import Cell, _require_breakaway, load_cell
from agent.config.reality import draw, reality_of
from agent.config.schema.arm import Figure, Provenance
from agent.config.schema.driver import DriverKind
from agent.config.schema.reality import Reality
from agent.process.describe import run_info
from agent.process.simulated import plant_spec
from drivers.interface import Refusal
from drivers.substeps import fewest_substeps
from tests.support.starts import start_joints


def cell(name: str, *overrides: str) -> Cell:
    return load_cell(configs.CELLS_DIR / f"{name}.toml", list(overrides))


REAL = "simulation.reality."


@pytest.mark.parametrize("name", ["paper", "three_wx250s"])
def test_draws_stay_within_the_tolerance_and_reach_towards_it(name: str) -> None:
    c = cell(name)
    t, planar = c.file.tolerance, len(c.arms[0].entry.controlled) == 3
    drawn = [draw(t, seed, c) for seed in range(60)]
    for key, most in (("base_m", t.base_m), ("base_rad", t.base_rad), ("grasp_m", t.grasp_m)):
        sizes = [float(np.linalg.norm(getattr(a, key))) for r in drawn for a in r.arms.values()]
        assert max(sizes) <= most
        assert max(sizes) > 0.9 * most
        assert min(sizes) < 0.1 * most
    zeros = [z for r in drawn for a in r.arms.values() for z in a.zeros_rad]
    assert max(map(abs, zeros)) <= t.zeros_of(3 if planar else 6) < 1.2 * max(map(abs, zeros))
    assert min(zeros) < 0.0 < max(zeros)
    ranges = [
        ([a.masses for r in drawn for a in r.arms.values()], (0.9, 1.1)),
        ([r.object for r in drawn], (0.8, 1.2)),
        ([a.friction for r in drawn for a in r.arms.values()], t.friction),
        ([k for r in drawn for a in r.arms.values() for k in a.torque_constant], (0.9, 1.1)),
        ([a.skew_s for r in drawn for a in r.arms.values()], (0.0, t.skew_s)),
        ([r.delay_s / c.file.simulated_delay_s for r in drawn if r.delay_s], t.delay),
        ([np.log10(r.pads_N_per_m) for r in drawn if r.pads_N_per_m], np.log10(t.pads_N_per_m)),
        ([np.log10(r.pads_Nm_per_rad) for r in drawn if r.pads_Nm_per_rad], np.log10(t.pads_Nm_per_rad)),
    ]
    for values, (low, high) in ranges:
        assert len(values) >= 60
        assert low <= min(values) < low + 0.1 * (high - low)
        assert high >= max(values) > high - 0.1 * (high - low)
    assert {r.pads_damping_ratio for r in drawn} == {t.pads_damping_ratio}


def test_errors_of_arms_that_move_in_a_plane_stay_in_it() -> None:
    c = cell("paper")
    for seed in range(10):
        for arm in draw(c.file.tolerance, seed, c).arms.values():
            assert abs(arm.base_m[2]) + abs(arm.grasp_m[2]) < 1e-15
            assert abs(arm.base_rad[0]) + abs(arm.base_rad[1]) < 1e-15
            assert abs(arm.base_rad[2]) > 0.0


def test_a_seed_is_one_reality_and_a_tolerance_changes_its_own_value_alone() -> None:
    c = cell("paper", "tolerance.grasp_rad=0.01")
    t = c.file.tolerance
    assert draw(t, 7, c) == draw(t, 7, c)
    assert draw(t, 7, c) != draw(t, 8, c)
    other = draw(t.model_copy(update={"base_m": 0.0}), 7, c)
    assert other.arms["left"].base_m == (0.0, 0.0, 0.0)
    assert other.arms["left"].grasp_rad == draw(t, 7, c).arms["left"].grasp_rad != (0.0, 0.0, 0.0)
    assert other.delay_s == draw(t, 7, c).delay_s


WORN = ("tolerance.backlash_rad=0.006", "tolerance.delay_jitter_s=0.002")


@pytest.mark.parametrize(
    ("name", "known"),
    [
        ("paper", (1.0392736268828853, 0.006202182739925248, 0.001806320295070788, 1.0742678753385762)),
        ("three_wx250s", (0.9288653239120901, 0.005479961642586657, 0.0027381759960686766, 0.9935460433628193)),
    ],
)
def test_a_seed_draws_what_it_drew_before_there_was_backlash_and_jitter_stated_or_not(
    name: str, known: tuple[float, ...]
) -> None:
    plain, worn = (draw(c.file.tolerance, 7, c) for c in (cell(name), cell(name, *WORN)))
    last = list(plain.arms.values())[-1]
    assert (plain.object, plain.delay_s, last.skew_s, last.torque_constant[-1]) == known
    assert plain.delay_jitter_s == 0.0
    assert not any(arm.backlash_rad for arm in plain.arms.values())
    gapless = {k: arm.model_copy(update={"backlash_rad": ()}) for k, arm in worn.arms.items()}
    assert worn.model_copy(update={"delay_jitter_s": 0.0, "arms": gapless}) == plain


def test_backlash_and_jitter_are_drawn_up_to_what_is_stated_each_by_itself() -> None:
    c = cell("paper", *WORN)
    drawn = [draw(c.file.tolerance, seed, c) for seed in range(60)]
    gaps = [gap for r in drawn for arm in r.arms.values() for gap in arm.backlash_rad]
    jitters = [r.delay_jitter_s for r in drawn]
    assert len(gaps) == 60 * 6
    for values, most in ((gaps, 0.006), (jitters, 0.002)):
        assert 0.0 <= min(values) < 0.1 * most
        assert 0.9 * most < max(values) <= most
        assert len(set(values)) == len(values)
    assert jitters[3] != np.random.default_rng(3).uniform(0.0, 0.002), "not the numbers of the other errors"
    one = cell("paper", WORN[0])
    assert [draw(one.file.tolerance, s, one).arms for s in range(3)] == [r.arms for r in drawn[:3]]
    made = plant_spec(cell("paper", *WORN, "simulation.reality.seed=3"), start_joints(c)).arms[1].actuator
    assert made.backlash_rad.tolist() == list(drawn[3].arms["right"].backlash_rad)
    assert made.delay_jitter_s == jitters[3]


DRAWN = (0.002591812932216864, 0.02702433483322102, 1.1908067166587966, 0.0025957792674616066, 4964.9090777386145,
         0.6505855320952851, 0.9398740693942322)  # fmt: skip
RUBBING = ("tolerance.breakaway=0.8", "tolerance.load_friction=0.06")


def test_breakaway_and_load_are_drawn_up_to_what_is_stated_each_by_itself_and_change_no_other_error() -> None:
    c = cell("three_wx250s", *WORN, *RUBBING)
    drawn = [draw(c.file.tolerance, seed, c) for seed in range(40)]
    coulomb = {arm.name: [s.coulomb_Nm.value for s in arm.servos] for arm in c.arms}
    parts = [b / k for r in drawn for n, a in r.arms.items() for b, k in zip(a.breakaway_Nm, coulomb[n], strict=True)]
    loads = [load for r in drawn for arm in r.arms.values() for load in arm.load_friction]
    for values, most in ((parts, 0.8), (loads, 0.06)):
        assert len(set(values)) == len(values) == 40 * 3 * 6
        assert 0.0 <= min(values) < 0.1 * most
        assert 0.9 * most < max(values) <= most
    speeds = [arm.stribeck_rad_per_s for r in drawn for arm in r.arms.values()]
    assert 0.1 <= min(speeds) < 0.12
    assert 1.2 < max(speeds) <= 1.5
    one = cell("three_wx250s", *WORN, RUBBING[1])
    (alone, plain) = (draw(x.file.tolerance, 3, x) for x in (one, cell("three_wx250s", *WORN)))
    assert [a.load_friction for a in alone.arms.values()] == [a.load_friction for a in drawn[3].arms.values()]
    assert all(a.breakaway_Nm == () and a.stribeck_rad_per_s is None for a in alone.arms.values())
    free = {n: a.model_copy(update={"load_friction": ()}) for n, a in alone.arms.items()}
    assert alone.model_copy(update={"arms": free}) == plain
    made = plant_spec(cell("three_wx250s", *WORN, *RUBBING, "simulation.reality.seed=3"), start_joints(c)).arms[1]
    assert made.friction is not None
    assert made.friction.breakaway_Nm.tolist() == list(drawn[3].arms[made.name].breakaway_Nm)
    assert made.friction.load.tolist() == list(drawn[3].arms[made.name].load_friction)


def test_grasps_are_alike_unless_the_cell_says_that_each_is_its_own() -> None:
    alike, unlike = (cell("three_wx250s", *more) for more in ((), ("tolerance.pads_alike=false",)))
    drawn = [draw(unlike.file.tolerance, seed, unlike) for seed in range(40)]
    for key, (low, high) in (
        ("pads_N_per_m", alike.tolerance.pads_N_per_m),
        ("pads_Nm_per_rad", alike.tolerance.pads_Nm_per_rad),
    ):
        each = [getattr(arm, key) for r in drawn for arm in r.arms.values()]
        assert len(set(each)) == 40 * 3
        assert low <= min(each) < 1.3 * low
        assert 0.75 * high < max(each) <= high
    plain = draw(alike.file.tolerance, 3, alike)
    same = {n: a.model_copy(update={"pads_N_per_m": None, "pads_Nm_per_rad": None}) for n, a in drawn[3].arms.items()}
    assert drawn[3].model_copy(update={"arms": same}) == plain
    made = plant_spec(cell("three_wx250s", "tolerance.pads_alike=false", f"{REAL}seed=3"), start_joints(unlike))
    assert [arm.pads for arm in made.arms] == [(a.pads_N_per_m, a.pads_Nm_per_rad) for a in drawn[3].arms.values()]


def test_joints_of_an_arm_are_alike_unless_the_cell_says_that_each_is_its_own() -> None:
    alike, unlike = (cell("three_wx250s", *more) for more in ((), ("tolerance.joints_alike=false",)))
    drawn = [draw(unlike.file.tolerance, seed, unlike) for seed in range(40)]
    arms = [arm for r in drawn for arm in r.arms.values()]
    assert {(arm.friction, arm.masses) for arm in arms} == {(1.0, 1.0)}
    for key, (low, high) in (("joint_friction", alike.tolerance.friction), ("link_masses", (0.9, 1.1))):
        each = [factor for arm in arms for factor in getattr(arm, key)]
        assert len(set(each)) == 40 * 3 * 6
        near = 0.05 * (high - low)
        assert low <= min(each) < low + near
        assert high - near < max(each) <= high
    plain = draw(alike.file.tolerance, 3, alike)
    for name, arm in drawn[3].arms.items():
        own = {"friction", "masses", "joint_friction", "link_masses"}
        assert arm.model_dump(exclude=own) == plain.arms[name].model_dump(exclude=own)
        assert plain.arms[name].joint_friction == plain.arms[name].link_masses == ()
    made = plant_spec(cell("three_wx250s", "tolerance.joints_alike=false", f"{REAL}seed=3"), start_joints(unlike))
    for arm, given in zip(made.arms, drawn[3].arms.values(), strict=True):
        assert tuple(arm.masses.tolist()) == given.link_masses
        filed = np.array([servo.coulomb_Nm.value for servo in unlike.arms[0].servos])
        np.testing.assert_allclose(arm.actuator.coulomb_Nm, filed * given.joint_friction)


def test_joints_that_do_not_rub_and_files_that_have_such_friction_draw_none() -> None:
    smooth = cell("paper", *RUBBING, "simulation.effects.friction=false")
    c = cell("paper", *RUBBING)
    figure = Figure(value=0.02, status=Provenance.ESTIMATED, source="a test")
    left = c.arms[0]
    found = replace(left, servos=(*left.servos[:2], left.servos[2].model_copy(update={"breakaway_Nm": figure})))
    filed = replace(c, arms=(found, c.arms[1]))
    for drawn, arm in ((draw(x.file.tolerance, 5, x), x.arms[0].name) for x in (smooth, filed)):
        assert drawn.arms[arm].breakaway_Nm == ()
    assert draw(smooth.file.tolerance, 5, smooth).arms["right"].load_friction == ()
    assert len(draw(filed.file.tolerance, 5, filed).arms["left"].load_friction) == 3, "its file has no load friction"


def test_a_seed_draws_what_it_drew_of_what_is_drawn_where_it_is_stated() -> None:
    c = cell("paper", *WORN, *RUBBING, "tolerance.pads_alike=false", "tolerance.joints_alike=false")
    right = draw(c.file.tolerance, 7, c).arms["right"]
    assert (
        right.backlash_rad[0],
        right.breakaway_Nm[0],
        right.stribeck_rad_per_s,
        right.load_friction[0],
        right.pads_N_per_m,
        right.joint_friction[0],
        right.link_masses[0],
    ) == pytest.approx(DRAWN, rel=1e-12)


def test_an_arm_alone_has_its_reality_too() -> None:
    c = cell("identify_mk2", *RUBBING)
    (alone,) = draw(c.file.tolerance, 3, c).arms.values()
    assert len(alone.load_friction) == 3


def test_a_planar_arm_s_grasp_is_off_in_its_plane_however_the_object_lies() -> None:
    c = cell("paper", "object.quat_start=[0.7071067811865476, 0.7071067811865475, 0.0, 0.0]")
    R = c.T_world_object_start.rotation
    for seed in range(5):
        for arm in draw(c.file.tolerance, seed, c).arms.values():
            assert abs((R @ arm.grasp_m)[2]) < 1e-12
            assert float(np.linalg.norm(arm.grasp_m)) > 0.0


def test_a_delay_jitters_by_no_more_than_there_is_of_it() -> None:
    c = cell("paper", "loop_delay_s=0.0", WORN[1])
    assert {draw(c.file.tolerance, seed, c).delay_jitter_s for seed in range(5)} == {0.0}


def test_a_jitter_with_which_torques_overtake_each_other_is_refused() -> None:
    with pytest.raises(Refusal, match=r"tolerance\.delay_jitter_s.*found 0\.0025 s.*below half a period, 0\.0025 s"):
        cell("paper", "tolerance.delay_jitter_s=0.0025")


@pytest.mark.parametrize("rate_hz", [20.0, 36.0, 45.0, 120.0, 150.0, 179.9])
def test_a_cell_whose_steps_the_plant_does_not_take_is_refused_with_how_many_are_enough(rate_hz: float) -> None:
    enough = fewest_substeps(rate_hz)
    keys = ("loop_delay_s=0.0", f"rate_hz={rate_hz}", "simulation.substeps_per_cycle=")
    for fewer in (1, enough - 1):
        said = rf"simulation\.substeps_per_cycle.*found {fewer} at rate_hz = {rate_hz:g}, expected {enough} at least"
        with pytest.raises(Refusal, match=said):
            cell("paper_ideal", *keys[:2], f"{keys[2]}{fewer}")
        cell("paper_ideal", *keys[:2], f"{keys[2]}{fewer}", "driver=dynamixel")
    taken = cell("paper_ideal", *keys[:2], f"{keys[2]}{enough}")
    spec = plant_spec(taken, start_joints(taken))
    with pytest.raises(Refusal, match=r"shorten substep_s|substep_of"):
        replace(spec, substep_s=1.0 / rate_hz / (enough - 1))


def test_one_step_a_cycle_is_enough_from_180_hz_on() -> None:
    assert [fewest_substeps(rate_hz) for rate_hz in (60.0, 90.0, 179.0, 180.0, 2000.0)] == [3, 2, 2, 1, 1]


def test_values_that_are_given_lie_over_those_of_a_seed() -> None:
    drawn = reality_of(cell("paper", "simulation.reality.seed=3"))
    given = "simulation.reality={seed=3, object=1.5, arms={left={masses=1.2, grasp_m=[0.0, 0.0, 0.0]}}}"
    real = reality_of(cell("paper", given))
    assert drawn is not None
    assert real is not None
    assert (real.object, real.arms["left"].masses, real.arms["left"].grasp_m) == (1.5, 1.2, (0.0, 0.0, 0.0))
    assert drawn.arms["left"].grasp_m != (0.0, 0.0, 0.0)
    left = real.arms["left"].model_copy(update={k: getattr(drawn.arms["left"], k) for k in ("masses", "grasp_m")})
    assert real.model_copy(update={"object": drawn.object, "arms": real.arms | {"left": left}}) == drawn


def test_a_drawn_reality_and_its_values_written_down_are_one_plant() -> None:
    drawn = cell("paper", "simulation.reality.seed=3")
    real = reality_of(drawn)
    assert real is not None
    given = real.model_dump(mode="json", exclude_none=True)
    written = cell("paper", *(f"simulation.reality.{k}={_toml(v)}" for k, v in given.items()))
    assert reality_of(written) == real
    one, other = (plant_spec(c, start_joints(c)) for c in (drawn, written))
    for a, b in zip(one.arms, other.arms, strict=True):
        assert np.array_equal(a.q_start, b.q_start)
        assert np.array_equal(a.T_object_ee.homogeneous, b.T_object_ee.homogeneous)
    assert one.grasp == other.grasp
    assert one.object.mass_kg == other.object.mass_kg == real.object * drawn.file.object.mass_kg


def _toml(value: object) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k} = {_toml(v)}" for k, v in value.items()) + "}"
    return tomli_w.dumps({"v": value}).partition("=")[2].strip()


def test_the_agents_believe_what_the_file_says_and_the_run_tells_what_was_true() -> None:
    c = cell("paper", "simulation.reality.seed=3")
    believed = cell("paper")
    np.testing.assert_array_equal(c.arms[0].T_world_base.homogeneous, believed.arms[0].T_world_base.homogeneous)
    told = json.loads(run_info(c, DriverKind.SIM, 0))["reality"]
    real = reality_of(c)
    assert real is not None
    assert Reality.model_validate_json(json.dumps(told)) == real
    assert json.loads(run_info(believed, DriverKind.SIM, 0))["reality"] is None


def test_a_plant_may_stick_whose_agents_know_nothing_of_it() -> None:
    believed = cell("paper")
    sticks = cell("paper", "simulation.reality.arms.left={breakaway_Nm=[0.3, 0.3, 0.1], load_friction=[0.1, 0.1, 0.1]}")
    left, right = plant_spec(sticks, start_joints(sticks)).arms
    assert left.friction is not None
    assert left.friction.breakaway_Nm.tolist() == [0.3, 0.3, 0.1]
    assert left.friction.load.tolist() == [0.1, 0.1, 0.1]
    assert right.friction is None
    for one, other in zip(believed.arms, sticks.arms, strict=True):
        assert sticks.offline(other).friction == believed.offline(one).friction


@pytest.mark.parametrize("key", ["breakaway_Nm", "load_friction"])
def test_joints_that_do_not_rub_are_given_no_friction(key: str) -> None:
    smooth = "simulation.effects.friction=false"
    with pytest.raises(Refusal, match=rf"simulation\.reality\.arms\.left\.{key}.*effects\.friction = false"):
        cell("paper", smooth, f"simulation.reality.arms.left.{key}=[0.1, 0.1, 0.1]")
    cell("paper", smooth, f"simulation.reality.arms.left.{key}=[0.0, 0.0, 0.0]")


def test_a_stribeck_velocity_of_no_breakaway_is_refused() -> None:
    speed = "simulation.reality.arms.left.stribeck_rad_per_s=0.2"
    for without in ((), ("simulation.reality.seed=3",), ("tolerance.breakaway=0.5",)):
        with pytest.raises(Refusal, match=r"arms\.left\.stribeck_rad_per_s: found 0\.2, of no breakaway"):
            cell("paper", speed, *without)
    own = cell("paper", speed, "simulation.reality.arms.left.breakaway_Nm=[0.1, 0.1, 0.1]")
    drawn = cell("paper", speed, "simulation.reality.seed=3", "tolerance.breakaway=0.5")
    for one in (own, drawn):
        left = plant_spec(one, start_joints(one)).arms[0].friction
        assert left is not None
        assert left.stribeck_rad_s.tolist() == [0.2] * 3
    arm, figure = drawn.arms[0], drawn.arms[0].servos[2].coulomb_Nm
    sticking = arm.servos[2].model_copy(update={"breakaway_Nm": figure, "stribeck_rad_per_s": figure})
    _require_breakaway(drawn.file, replace(arm, servos=(*arm.servos[:2], sticking)))


@pytest.mark.parametrize(
    ("key", "value", "nothing"),
    [
        ("friction", "2.0", "1.0"),
        ("joint_friction", "[1.0, 0.9, 1.0]", "[1.0, 1.0, 1.0]"),
        ("stribeck_rad_per_s", "0.2", ""),
    ],
)
def test_factors_of_friction_that_is_switched_off_are_refused_as_well(key: str, value: str, nothing: str) -> None:
    smooth = "simulation.effects.friction=false"
    with pytest.raises(
        Refusal, match=rf"arms\.left\.{key}'.*: found simulation.effects.friction = false.*leave this out"
    ):
        cell("paper", smooth, f"simulation.reality.arms.left.{key}={value}")
    if nothing:
        cell("paper", smooth, f"simulation.reality.arms.left.{key}={nothing}")
        cell("paper", f"simulation.reality.arms.left.{key}={value}")


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("simulation.reality.arms.middle.masses=1.1", "left or right"),
        ("simulation.reality.arms.left.zeros_rad=[0.1, 0.1]", "one per controlled joint, 3"),
        ("simulation.reality.arms.right.torque_constant=[1.1]", "one per controlled joint, 3"),
        ("simulation.reality.arms.right.backlash_rad=[0.01]", "one per controlled joint, 3"),
        ("simulation.reality.arms.right.link_masses=[1.1]", "one per controlled joint, 3"),
        ("simulation.reality.arms.right.joint_friction=[1.1]", "one per controlled joint, 3"),
        ("simulation.reality.arms.right.breakaway_Nm=[0.01]", "one per controlled joint, 3"),
        ("simulation.reality.arms.right.load_friction=[0.01]", "one per controlled joint, 3"),
        ("simulation.reality.delay=1.1", "simulation.reality.delay"),
        (f"{REAL}pads_N_per_m=1e4", "found pads_N_per_m without pads_Nm_per_rad, expected both stiffnesses"),
        (f"{REAL}pads_Nm_per_rad=9.0", "; give pads_N_per_m as well, or add [simulation.grasp]"),
        (f"{REAL}pads_damping_ratio=0.3", "pads_damping_ratio without pads_N_per_m and pads_Nm_per_rad"),
        (f"{REAL}arms.left.pads_N_per_m=1e4", "found grasps that are welded, expected pads of the cell, of which this"),
        (f"{REAL}arms.left.pads_Nm_per_rad=9.0", "; give simulation.reality.pads_N_per_m and pads_Nm_per_rad as well"),
        (f"{REAL}delay_jitter_s=0.4", "found 0.4 s, expected below half a period, 0.0025 s"),
        (f"{REAL}delay_jitter_s=0.0025", "below half a period, 0.0025 s"),
    ],
)
def test_a_reality_that_cannot_be_is_refused(override: str, message: str) -> None:
    with pytest.raises(Refusal, match=r"simulation\.reality") as caught:
        cell("paper", override)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (["loop_delay_s=0.0"], "expected at most the delay, 0 s, that the cell is simulated with; lower it, or give"),
        (["simulation.effects.delay_s=0.001"], "at most the delay, 0.001 s, that the cell is simulated with"),
        ([f"{REAL}delay_s=0.0015"], "at most the delay, 0.0015 s, of simulation.reality.delay_s"),
        ([f"{REAL}seed=3", "tolerance.delay=[0.3, 1.2]"], "at most the delay, 0.0015 s, the shortest that tolerance"),
    ],
)
def test_a_delay_that_jitters_by_more_than_there_is_of_it_is_refused(changes: list[str], message: str) -> None:
    with pytest.raises(Refusal, match=r"simulation\.reality\.delay_jitter_s.*found 0\.002 s") as caught:
        cell("paper", f"{REAL}delay_jitter_s=0.002", *changes)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    "changes",
    [
        [f"{REAL}pads_N_per_m=1e4", f"{REAL}pads_Nm_per_rad=9.0"],
        [f"{REAL}pads_N_per_m=1e4", f"{REAL}seed=3"],
        [f"{REAL}pads_damping_ratio=0.3", "simulation.grasp={stiffness_N_per_m=1e4, stiffness_Nm_per_rad=50.0}"],
        [f"{REAL}delay_jitter_s=0.002"],
        [f"{REAL}delay_jitter_s=0.002", f"{REAL}delay_s=0.002", "loop_delay_s=0.0"],
        [f"{REAL}delay_jitter_s=0.002", f"{REAL}seed=3"],
        [f"{REAL}delay_s=0.0", f"{REAL}seed=3", "tolerance.delay_jitter_s=0.002"],
    ],
)
def test_pads_and_jitter_that_are_let_pass_make_a_plant(changes: list[str]) -> None:
    made = cell("paper", *changes)
    plant_spec(made, start_joints(made))
