"""A tick of an arm that goes from its rest to the object and back: which law, which bounds, and what it says of it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import configs
from agent import phases
from agent.config.cell import load_cell
from agent.control import adaptive, known
from agent.control.alignment import NO_SHIFT, Shift, shifted
from agent.control.borne import Borne
from agent.control.cause import Cause
from agent.control.memory import Memory
from agent.control.residual import Channels
from agent.control.terms import CMD
from agent.control.trajectory import Desired
from agent.loop import Agent, Outcome, blind, explained, initial_memory, step
from agent.modes import Mode
from agent.process.build import build_agent
from agent.safety import Flag, Limits
from drivers.interface import JointState, Vector
from tests.support.session_script import made, q_grasp

SHIFT = (0.01, -0.02, 0.005, 0.0, 0.03, 0.0)
TAKE_UP_S = 0.02  # of the cell
CARRIES = [Mode.READY, Mode.TRACK, Mode.HOLD, Mode.LOWER, Mode.RELEASE]
FREE = Limits((1e3,) * 3, (1e3,) * 3)


def arm(**changes: Any) -> Agent:
    return replace(made(), **{"observer": None, "limits": FREE} | changes)


def limited(Nm: float) -> phases.Session:
    session = made().session
    assert session is not None
    return replace(session, limits=Limits((Nm,) * 3, (1e3,) * 3))


def life() -> Any:
    session = made().session
    assert session is not None
    return session.life


def memory(agent: Agent, age: float = 1e3, **more: Any) -> Memory:
    """Of an arm that holds what it sees at its grasp."""
    k = agent.model.evaluate(q_grasp(), np.zeros(3))
    begun = initial_memory(agent)._replace(hold=(*k.p_object, *k.quat_object), q_hold=q_grasp(), age=age, primed=True)
    return begun._replace(**more)


def tick(agent: Agent, mode: Mode, of: Memory, aside: float = 0.0, t: float = 0.0) -> Outcome:
    return step(agent, JointState(0, q_grasp() + aside, np.zeros(3), np.zeros(3)), t, mode, of)


def tau(outcome: Outcome) -> Vector:
    assert outcome.terms is not None
    found: Vector = outcome.terms.joints[CMD]
    return found


@pytest.mark.parametrize("mode", [*phases.ALONE, *CARRIES])
def test_an_arm_that_holds_nothing_has_bounds_of_its_own(mode: Mode) -> None:
    agent = arm(session=limited(0.01))
    bounded = np.abs(tick(agent, mode, memory(agent)).tau).max() <= 0.01 + 1e-12
    assert bool(bounded) is (mode in phases.ALONE)


@pytest.mark.parametrize("mode", [*phases.ALONE, *CARRIES])
def test_an_arm_that_holds_nothing_is_off_its_track_beyond_its_joints_bound(mode: Mode) -> None:
    agent = arm(error_max_m=math.inf, error_max_rad=math.inf)
    at_bound = memory(agent, age=0.0)
    alone = mode in phases.ALONE
    for aside, off in ((0.99 * life().off_max_rad, False), (1.01 * life().off_max_rad, alone)):
        flags = tick(agent, mode, at_bound, aside).flags
        assert (Flag.OFF_TRACK in flags) is off, aside


def test_the_joints_bound_itself_is_on_the_track() -> None:
    agent = arm()
    of = memory(agent)
    off_rad = phases.off(life(), Mode.HALT, of, q_grasp() + 0.1)
    for bound_rad, flagged in ((off_rad, False), (math.nextafter(off_rad, 0.0), True)):
        session = replace(limited(1e3), life=replace(life(), off_max_rad=bound_rad))
        flags = tick(arm(session=session), Mode.HALT, of, 0.1).flags
        assert (Flag.OFF_TRACK in flags) is flagged


@pytest.mark.parametrize("mode", sorted(phases.ALONE))
def test_an_arm_that_holds_nothing_follows_its_joints(mode: Mode) -> None:
    agent = arm()
    of, zero = memory(agent, age=0.3), np.zeros(3)
    q = q_grasp() + 0.02
    terms = phases.alone(agent.model, agent.offline, life(), mode, of, q, zero)
    outcome = tick(agent, mode, of, 0.02)
    np.testing.assert_array_equal(tau(outcome), terms.joints[CMD])
    assert Flag.ADAPTATION_SATURATED not in outcome.flags


def law_at(agent: Agent, mode: Mode) -> Outcome:
    """With the load taken up, or held."""
    return tick(agent, mode, memory(agent, age=TAKE_UP_S if mode is Mode.READY else 0.0), 0.02)


@pytest.mark.parametrize("mode", [Mode.READY, Mode.RELEASE])
def test_torque_goes_over_between_the_joints_and_the_law(mode: Mode) -> None:
    agent = arm()
    alone = tick(agent, mode, memory(agent, age=0.0 if mode is Mode.READY else TAKE_UP_S), 0.02)
    half = tick(agent, mode, memory(agent, age=0.5 * TAKE_UP_S), 0.02)
    whole = law_at(agent, mode)
    assert np.abs(tau(alone) - tau(whole)).max() > 0.05
    np.testing.assert_allclose(tau(half), 0.5 * (tau(alone) + tau(whole)), atol=1e-9)
    for outcome, senses in ((alone, False), (half, False), (whole, True)):
        assert outcome.terms is not None
        assert (outcome.terms.J_inv_P is not None) is senses
    assert alone.terms is not None
    assert math.isnan(alone.terms.sigma_min), "no law of the object yet"


@pytest.mark.parametrize("mode", [*CARRIES, *phases.ALONE])
def test_an_arm_that_sees_nothing_carries_the_object_only_where_it_has_it(mode: Mode) -> None:
    agent = arm()
    of = memory(agent, q=q_grasp(), primed=False)
    g = agent.model.evaluate(q_grasp(), np.zeros(3)).g
    for found in (blind(agent, mode, of), tick(agent, mode, of, math.nan)):
        assert np.array_equal(found.tau, g) is (mode in phases.ALONE)


@pytest.mark.parametrize("mode", [Mode.HOLD, Mode.TRACK])
def test_other_modes_have_all_of_the_law_at_once(mode: Mode) -> None:
    agent = arm()
    np.testing.assert_array_equal(
        tau(tick(agent, mode, memory(agent, age=0.0))), tau(tick(agent, mode, memory(agent, age=1e3)))
    )


def test_an_arm_that_takes_its_load_up_learns_nothing_yet() -> None:
    cell = load_cell(configs.CELLS_DIR / "two_wx200.toml", ["session.take_up_s=0.02", 'controller.kind="adaptive"'])
    agent = replace(build_agent(cell, cell.arms[0]), observer=None, limits=FREE)
    adaptation, of = agent.offline.adaptation, memory(agent, age=0.5 * TAKE_UP_S)
    assert adaptation is not None
    assert of.estimate is not None
    learnt = of.estimate._replace(arm=1.5 * of.estimate.arm, object=2.0 * of.estimate.object)
    of = of._replace(estimate=learnt)
    assert of.estimate is not None
    half = tick(agent, Mode.READY, of, 0.02)
    alone = tick(agent, Mode.READY, of._replace(age=0.0), 0.02)
    assert half.memory.estimate == of.estimate == alone.memory.estimate
    assert Flag.ADAPTATION_SATURATED not in half.flags | alone.flags
    assert half.terms is not None
    q = q_grasp() + 0.02
    law = adaptive.torque(agent.model, agent.offline, adaptation, of.estimate, q, np.zeros(3), half.terms.desired)[0]
    np.testing.assert_allclose(tau(half), 0.5 * (tau(alone) + law.joints[CMD]), atol=1e-9)


def test_the_load_is_taken_up_by_the_law_of_what_is_desired() -> None:
    agent = arm()
    half = tick(agent, Mode.READY, memory(agent, age=0.5 * TAKE_UP_S), 0.02)
    alone = tick(agent, Mode.READY, memory(agent, age=0.0), 0.02)
    assert half.terms is not None
    law = known.torque(agent.model, agent.offline, q_grasp() + 0.02, np.zeros(3), half.terms.desired)
    np.testing.assert_allclose(tau(half), 0.5 * (tau(alone) + law.joints[CMD]), atol=1e-9)


def desired(agent: Agent, mode: Mode, of: Memory) -> Desired:
    terms = tick(agent, mode, of).terms
    assert terms is not None
    return terms.desired


def test_the_way_down_leads_from_what_was_held_to_the_place_of_the_object() -> None:
    agent = arm()
    still = (0.0,) * 6
    of = memory(agent, shift=SHIFT, age=0.0)
    assert of.hold is not None
    assert desired(agent, Mode.LOWER, of).p == pytest.approx(of.hold[:3], abs=1e-9)
    below = shifted(Desired(*life().place, still, still), SHIFT)
    end = desired(agent, Mode.LOWER, of._replace(age=1e3))
    assert (end.p, end.quat) == (pytest.approx(below.p), pytest.approx(below.quat))
    assert (*end.v, *end.a) == pytest.approx((0.0,) * 12)
    assert desired(agent, Mode.HOLD, of).p == of.hold[:3]


@pytest.mark.parametrize("mode", [Mode.READY, Mode.TRACK])
def test_a_start_beside_the_place_is_blended_away_while_the_arm_tracks(mode: Mode) -> None:
    agent = arm(alignment=None)
    session = agent.session
    assert session is not None
    t = 0.5 * session.start_blend_s
    after = tick(agent, mode, memory(agent, shift=SHIFT), t=t).memory.shift
    blended = phases.blended(SHIFT, t, agent.period_s, session.start_blend_s)
    assert blended != SHIFT
    assert after == (blended if mode is Mode.TRACK else SHIFT)
    assert tick(arm(alignment=None, session=None), mode, memory(agent, shift=SHIFT), t=t).memory.shift == SHIFT


def test_a_session_takes_away_what_the_start_left_and_arms_find_together_anew_behind_the_blend() -> None:
    agent, start = arm(), (0.001, 0.0, 0.0, 0.0, 0.0, 0.0)
    session = agent.session
    assert session is not None

    def left(since_s: float, settled: Shift) -> tuple[Shift, Shift]:
        of = memory(agent, shift=SHIFT, settled=settled)
        found = tick(agent, Mode.TRACK, of, t=session.start_blend_s + since_s).memory
        return found.settled, found.shift

    assert left(-0.01, start)[0] == NO_SHIFT
    settled, shift = left(4.0 / 0.3 - 0.01, NO_SHIFT)
    assert settled == NO_SHIFT
    settled, shift = left(4.0 / 0.3 + 0.01, NO_SHIFT)
    assert settled == shift != NO_SHIFT
    assert left(100.0, start)[0] == start


def test_time_in_a_mode_goes_on_by_a_period() -> None:
    agent = arm()
    assert tick(agent, Mode.HOLD, memory(agent, age=1.0)).memory.age == pytest.approx(1.0 + agent.period_s)


# --- what is told of an unexpected wrench ----------------------------------------------------------------------------


def unexpected(agent: Agent, force: tuple[float, ...], fast_N: float) -> Outcome:
    outcome = tick(agent, Mode.TRACK, memory(agent))
    sensed = (*force, 0.0, 0.0, 0.0, fast_N, 0.0, 0.0, 0.0)
    return outcome._replace(flags=outcome.flags | Flag.UNEXPECTED, sensed=sensed)


def test_a_blow_is_told_by_where_it_comes_from() -> None:
    agent = made()
    assert agent.residual is not None
    much = 3.0 * agent.residual.limits.fast_N
    told = explained(agent, unexpected(agent, (0.0, 0.0, -much), much))
    assert told.startswith(Cause.WEIGHT)
    assert told.endswith(f"({Channels(much, 0.0, 0.0, 0.0).fast_N:.2g} N, 0 N·m at once; 0 N, 0 N·m that stay)")
    assert explained(agent, unexpected(agent, (0.0, 0.0, much), much)).startswith(Cause.LIFT)


def test_a_pull_below_every_threshold_is_told_by_its_sizes() -> None:
    agent = made()
    outcome = unexpected(agent, (0.0, 0.0, 0.1), 0.0)
    sense = outcome.memory.sense
    pull = sense.pull._replace(level_N=0.0123, weight_N=4.56)
    outcome = outcome._replace(memory=outcome.memory._replace(sense=sense._replace(pull=pull)))
    told = explained(agent, outcome)
    assert told.endswith(", 0.012 N against the motion, 4.6 N down, 0 N of a blow")
    borne = outcome.memory.sense._replace(borne=Borne(0.1, 1.83, 0.2, 2.04))
    bears = explained(agent, outcome._replace(memory=outcome.memory._replace(sense=borne)))
    assert bears.endswith(", 4.6 N down (1.8 N with what friction bears, 2 N of joints that stick), 0 N of a blow")
    based = sense._replace(pull=pull, base=np.array([0.0, 0.0, 5.0, 0.0, 0.0, 0.0]))
    other = explained(agent, outcome._replace(memory=outcome.memory._replace(sense=based)))
    assert Cause.LIFT in told
    assert Cause.LIFT not in other, "of the wrench only what is new"


def test_what_was_expected_or_not_sensed_is_not_explained() -> None:
    agent = made()
    outcome = unexpected(agent, (0.0, 0.0, 9.0), 9.0)
    assert explained(agent, outcome)
    assert explained(replace(agent, residual=None), outcome) == ""
    for nothing in ({"sensed": None}, {"terms": None}, {"flags": Flag.NONE}):
        assert explained(agent, outcome._replace(**nothing)) == ""


@pytest.mark.parametrize("mode", [Mode.APPROACH, Mode.READY, Mode.LOWER, Mode.RELEASE, Mode.PARK])
@pytest.mark.parametrize(("passed", "older"), [(0.4, 1), (1, 1), (2, 2), (3, 3), (4, 1), (400, 1), (-5, 1)])
def test_what_goes_by_its_age_waits_for_no_single_state_and_through_every_pause(
    mode: Mode, passed: float, older: int
) -> None:
    agent, T = arm(), 0.005
    of = memory(agent, age=0.01, t=1.0)
    after = tick(agent, mode, of, t=1.0 + passed * T).memory
    assert after.age == pytest.approx(0.01 + older * T, abs=1e-12)


def test_a_tick_behind_a_missed_one_wants_what_is_due_now() -> None:
    agent, T = arm(), 0.005
    missed = tick(agent, Mode.PARK, memory(agent, age=0.3, t=1.0), t=1.0 + 2 * T)
    due = tick(agent, Mode.PARK, memory(agent, age=0.3 + T, t=1.0), t=1.0 + T)
    np.testing.assert_allclose(tau(missed), tau(due), rtol=1e-12)
    late = tick(agent, Mode.PARK, memory(agent, age=0.3, t=1.0), t=1.0 + T)
    assert np.abs(tau(late) - tau(due)).max() > 1e-6
