"""What an arm learns of its own friction: from which power, how far, in which modes, and what it is for."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agent.config.cell import load_cell
from agent.config.coordination import friction_factor
from agent.config.schema.reality import ArmReality, Reality
from agent.control.friction import Friction, JointFriction
from agent.control.friction_factor import FrictionFactor
from agent.control.memory import restore
from agent.faults.rehearse import rehearse
from agent.loop import initial_memory, step
from agent.modes import Mode
from agent.study.lab import Laboratory, Run
from agent.study.measure import measure
from agent.verify.noticing import learned as told_of
from drivers.interface import JointState
from tests.support.arm_files import with_true_arms
from tests.support.session_script import made, q_grasp
from tests.unit.test_step_rules import arm, start

T = 5e-3
LAW = FrictionFactor(0.2, 0.6, 1.5, 0.04)
DQ = np.array([0.2, -0.1])
BY_FILE = np.array([0.1, -0.1])  # N·m that the friction takes at DQ by the file: 0.03 W
TAKEN_W = 0.03


def after(factor: float, truth: float, law: FrictionFactor = LAW) -> float:
    """The factor a tick later of an arm that has so many times the file's friction, at DQ."""
    return law.advance(factor, (factor - truth) * BY_FILE, factor * BY_FILE, DQ, T)


# --- from which power, and how far -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("factor", "truth"), [(1.0, 1.3), (1.0, 0.7), (1.2, 0.9), (0.8, 1.1)])
def test_it_goes_towards_the_friction_that_is_felt_and_back_to_the_file_by_a_tenth_of_that(
    factor: float, truth: float
) -> None:
    s = (truth - factor - 0.1 * (factor - 1.0)) * TAKEN_W / (0.04 + TAKEN_W)
    assert after(factor, truth) == pytest.approx(factor + 0.2 * T * s, rel=1e-12)


def test_it_comes_to_rest_at_ten_elevenths_of_what_the_file_is_off_by() -> None:
    assert after(1.4, 1.44) == pytest.approx(1.4, abs=1e-12)
    assert after(0.8, 0.78) == pytest.approx(0.8, abs=1e-12)


def test_an_arm_at_rest_learns_nothing_and_neither_does_one_that_is_pulled_at_right_angles() -> None:
    still, tau = np.zeros(2), np.array([0.3, 0.6])
    assert LAW.advance(1.2, tau, tau, still, T) == 1.2
    assert LAW.advance(1.0, tau, BY_FILE, DQ, T) == 1.0, "(0.3, 0.6) · (0.2, −0.1) is no power"


def test_a_feed_forward_against_the_motion_takes_power_all_the_same() -> None:
    """A reference that has turned round before the joint: the file is believed neither more nor less for it."""
    nothing = np.zeros(2)
    assert LAW.advance(1.2, nothing, -1.2 * BY_FILE, DQ, T) == LAW.advance(1.2, nothing, 1.2 * BY_FILE, DQ, T) < 1.2


def test_no_surprise_teaches_more_than_a_tenth_in_a_second_and_none_leads_out_of_the_bounds() -> None:
    much = 100.0 * BY_FILE
    assert LAW.advance(1.0, -much, BY_FILE, DQ, 1.0) == pytest.approx(1.1)
    assert LAW.advance(1.0, much, BY_FILE, DQ, 1.0) == pytest.approx(0.9)
    assert LAW.advance(1.499, -much, BY_FILE, DQ, 1.0) == 1.5
    assert LAW.advance(0.601, much, BY_FILE, DQ, 1.0) == 0.6


def test_what_is_no_number_teaches_nothing() -> None:
    assert LAW.advance(1.2, np.full(2, math.nan), BY_FILE, DQ, T) == 1.2


def test_its_usual_power_is_that_of_all_joints_at_a_tenth_of_a_radian_per_second() -> None:
    friction = Friction((JointFriction(0.2, 5.0), JointFriction(0.1, 5.0, breakaway_Nm=0.05)), 0.05)
    assert FrictionFactor.of(friction, 0.3, 0.5, 2.0) == FrictionFactor(0.3, 0.5, 2.0, pytest.approx(0.035))


# --- who learns ------------------------------------------------------------------------------------------------------


def learned(name: str, *changes: str) -> tuple[float, float, float] | None:
    cell = load_cell(Path(name), list(changes))
    found = friction_factor(cell, cell.arms[0])
    return found and (found.per_s, found.least, found.most)


def test_an_arm_learns_within_what_the_cell_states_of_its_friction() -> None:
    assert learned("two_wx200") == (0.3, 0.6, 1.5)
    assert learned("two_wx200", "tolerance.friction=[0.0, 2.0]", "tolerance.breakaway=0.5") == (0.3, 0.1, 3.0)
    assert learned("two_wx200", "controller.friction_learning_per_s=0.05") == (0.05, 0.6, 1.5)
    one_sided = ("tolerance.friction=[1.0, 1.5]", "tolerance.friction=[0.6, 1.0]")
    assert [learned("two_wx200", change) for change in one_sided] == [(0.3, 1.0, 1.5), (0.3, 0.6, 1.0)]


@pytest.mark.parametrize(
    "change",
    [
        "controller.friction_learning_per_s=0.0",
        "controller.friction_feedforward=false",
        'controller.kind="adaptive"',
        "safety.noticing.enabled=false",
        "tolerance.friction=[1.0, 1.0]",
    ],
)
def test_an_arm_that_feeds_nothing_forward_feels_nothing_or_knows_all_learns_nothing(change: str) -> None:
    assert learned("two_wx200", change) is None


def said(name: str, *changes: str) -> list[tuple[str, str]]:
    return [(f.where, f.found) for f in told_of(load_cell(Path(name), list(changes)))]


def test_check_says_who_learns_and_how_far() -> None:
    assert said("two_wx200") == [("left, right", "0.6 to 1.5 times its file's")]
    assert said("two_wx200", "controller.friction_feedforward=false") == said("paper_adaptive") == []


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ("safety.noticing.enabled=false", "safety.noticing is off"),
        ("controller.friction_learning_per_s=0.0", "controller.friction_learning_per_s is 0"),
        ("tolerance.friction=[1.0, 1.0]", "tolerance.friction says that the arm's file is exact"),
    ],
)
def test_check_says_why_nobody_learns(change: str, why: str) -> None:
    assert said("two_wx200", change) == [("left, right", f"none: {why}")]


def test_an_arm_of_viscous_friction_alone_is_named_beside_one_that_learns(tmp_path: Path) -> None:
    cell = load_cell(Path("two_models"))
    no_dry = {servo.name: {"coulomb_Nm": 0.0} for servo in cell.arms[0].file.joints}
    oiled = with_true_arms(cell, tmp_path, factors=no_dry).arms[0]
    assert [(f.where, f.found) for f in told_of(replace(cell, arms=(oiled, cell.arms[1])))] == [
        (oiled.name, "none: the arm's file has no dry friction"),
        (cell.arms[1].name, "0.6 to 1.5 times its file's"),
    ]


def test_it_is_learned_while_the_arm_follows_alone_kept_in_every_mode_and_fed_forward() -> None:
    lab = Laboratory(load_cell(Path("two_wx200"), ["simulation.ready_s=0.5"]))
    run = Run(lab, Reality(arms={a.name: ArmReality(friction=1.4) for a in lab.cell.arms}))
    while run.t < 4.0:
        run.advance()
    place = run.places[0]
    assert place.agent.offline.friction is not None
    assert place.memory.friction_factor > 1.02
    q, dq, tau = (values[place.joints] for values in run.plant.reported())
    state, kept = JointState(0, q, dq, tau), place.memory
    for mode in (Mode.TRACK, Mode.HOLD, Mode.READY):
        found = step(place.agent, state, run.t, mode, kept).memory.friction_factor
        assert (found == kept.friction_factor) == (mode is not Mode.TRACK)
    deaf = step(replace(place.agent, residual=None), state, run.t, Mode.TRACK, kept)
    assert deaf.memory.friction_factor == kept.friction_factor
    for mode in (Mode.TRACK, Mode.HOLD):
        once, twice = (
            step(place.agent, state, run.t, mode, kept._replace(friction_factor=k)).terms for k in (1.0, 2.0)
        )
        assert once is not None
        assert twice is not None
        viscous = np.array([j.viscous_Nm_s_per_rad for j in place.agent.offline.friction.joints]) * once.dq_ref
        more = twice.tau_friction - once.tau_friction
        assert np.abs(more).max() > 0.01
        assert more.tolist() == pytest.approx((once.tau_friction - viscous).tolist(), rel=1e-9)
        assert twice.tau_cmd.tolist() == pytest.approx((once.tau_cmd + more).tolist(), rel=1e-12)


@pytest.mark.parametrize("mode", [Mode.TRACK, Mode.READY])
@pytest.mark.parametrize("load", [0.0, 0.1])
def test_an_arm_that_takes_up_its_load_and_one_whose_joints_stick_feed_it_forward_too(mode: Mode, load: float) -> None:
    """Half of its load, in READY."""
    plain = made()
    assert plain.session is not None
    friction = Friction((JointFriction(0.1, 0.0, load=load),) * 3, 0.05)
    agent = replace(plain, offline=replace(plain.offline, friction=friction))
    memory = initial_memory(agent)._replace(q_hold=q_grasp(), age=0.5 * plain.session.life.take_up_s)
    state = JointState(0, q_grasp() + 0.01, np.array([0.2, -0.3, 0.2]), np.zeros(3))
    once, twice = (step(agent, state, 0.02, mode, memory._replace(friction_factor=k)).terms for k in (1.0, 2.0))
    assert once is not None
    assert twice is not None
    assert np.abs(twice.tau_friction - once.tau_friction).min() > 1e-3
    if mode is Mode.TRACK:
        doubled = Friction((JointFriction(0.2, 0.0, load=2.0 * load),) * 3, 0.05)  # load at the torque that is sent
        other = replace(agent, offline=replace(agent.offline, friction=doubled))
        by_file = step(other, state, 0.02, mode, memory).terms
        assert by_file is not None
        assert twice.tau_friction.tolist() == pytest.approx(by_file.tau_friction.tolist(), rel=1e-12)


def test_what_hangs_on_the_object_is_told_from_the_friction_that_the_arm_has_learned() -> None:
    lab = Laboratory(load_cell(Path("three_wx250s"), ["simulation.ready_s=0.5"]))
    run = Run(lab, None)
    while run.t < 1.5:
        run.advance()
    place = run.places[0]
    q, dq, tau = (values[place.joints] for values in run.plant.reported())
    kept = place.memory._replace(friction_factor=1.4)
    found = step(place.agent, JointState(0, q, dq, tau), run.t, Mode.TRACK, kept)
    sense, terms, residual = found.memory.sense, found.terms, place.agent.residual
    assert terms is not None
    assert terms.J_inv_P is not None
    assert residual is not None
    assert residual.bearing is not None
    given = kept.sense.borne, sense.pull.weight_N, terms.J_inv_P, terms.tau_friction, found.dq
    learned_so, by_file = (residual.bearing.advance(*given, factor, ready=False) for factor in (1.4, 1.0))
    assert sense.borne == learned_so != by_file


def test_joints_that_stick_are_fed_so_many_times_what_they_take_and_viscous_friction_is_the_files() -> None:
    dq, tau = np.array([0.2, -0.3]), np.array([1.0, -0.5])
    dry = (JointFriction(0.1, 0.0, 0.05, load=0.1), JointFriction(0.2, 0.0))
    more = Friction((JointFriction(0.13, 0.0, 0.065, load=0.13), JointFriction(0.26, 0.0)), 0.05)
    fed = Friction(dry, 0.05).torque(dq, dq, tau, 1.3)
    assert fed.tolist() == pytest.approx(more.torque(dq, dq, tau).tolist(), rel=1e-12)
    glides = Friction((JointFriction(0.1, 0.0), JointFriction(0.2, 0.0)), 0.05)
    assert glides.gliding([0.2, -0.3], 1.3) == pytest.approx([1.3 * x for x in glides.gliding([0.2, -0.3])])
    assert glides.torque(dq, dq, tau, 1.3).tolist() == pytest.approx(glides.gliding([0.2, -0.3], 1.3))
    oiled = Friction((JointFriction(0.0, 0.4), JointFriction(0.0, 0.5)), 0.05)
    assert oiled.gliding([0.2, -0.3], 1.3) == pytest.approx([0.08, -0.15])
    sticky = Friction((JointFriction(0.0, 0.4, load=1e-9), JointFriction(0.0, 0.5)), 0.05)
    assert sticky.torque(dq, dq, tau, 1.3).tolist() == pytest.approx([0.08, -0.15], abs=1e-6)


def test_it_goes_through_a_row_and_a_row_that_is_older_has_none() -> None:
    memory = initial_memory(arm())._replace(q=start(), friction_factor=1.25)
    flat = np.array(memory.flatten())
    assert flat[-7] == 1.25
    assert restore(flat, 3).friction_factor == 1.25
    assert restore(flat[:-7], 3).friction_factor == 1.0


# --- what it is for --------------------------------------------------------------------------------------------------

QUICK = "controller.friction_learning_per_s=1.0"  # three times as shipped, so that a shorter motion tells


def carrying(*changes: str) -> Laboratory:
    """Two arms; what they do counts from 7 s on."""
    settings = ["simulation.ready_s=0.5", "duration_s=12.0", "report.transient_s=7.0"]
    return Laboratory(load_cell(Path("two_wx200"), [*settings, *changes]))


@pytest.fixture(scope="module")
def lab() -> Laboratory:
    return carrying(QUICK)


def rubbing(lab: Laboratory, times: float) -> Reality:
    return Reality(arms={a.name: ArmReality(friction=times) for a in lab.cell.arms})


def test_arms_whose_friction_is_off_find_it_and_keep_the_object_where_it_should_be(lab: Laboratory) -> None:
    without, reality = carrying("controller.friction_learning_per_s=0.0"), rubbing(lab, 1.5)
    learning, as_filed = (measure(which, reality).position_beyond_anchor_m for which in (lab, without))
    assert as_filed > 1e-3
    assert learning < 0.5 * as_filed


@pytest.mark.parametrize(
    ("times", "low", "high", "until_s"),
    [
        (1.0, 0.98, 1.05, 6.0),
        (1.4, 1.2, 1.4, 6.0),
        pytest.param(0.7, 0.75, 0.96, 8.0, marks=pytest.mark.long),  # too much of it is hardly felt
    ],
)
def test_what_they_find_is_their_friction(
    lab: Laboratory, times: float, low: float, high: float, until_s: float
) -> None:
    run = Run(lab, rubbing(lab, times))
    while run.t < until_s:
        run.advance()
    found = [place.memory.friction_factor for place in run.places]
    assert all(low < factor < high for factor in found), found


def test_the_real_drivers_and_loops_find_it_on_emulated_servos_and_their_rows_have_it() -> None:
    rubs = [f"simulation.reality.arms.{name}.friction=1.4" for name in ("left", "right")]
    found = rehearse(load_cell(Path("two_wx200"), ["duration_s=2.5", QUICK, *rubs]), [])
    for arm_run in found.arms.values():
        rows = arm_run.rows
        follows = rows["mode"] == Mode.TRACK
        assert (rows["friction_factor"][~follows] == 1.0).all()
        assert rows["friction_factor"][-1] > 1.05
        assert rows["memory"][-1, -7] == rows["friction_factor"][-1]
        assert follows.sum() > 400
