"""The pull back of an arm that holds and is carried on: who has it, how it grows and fades, and what it is for."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.calm import BRAKE, JOINTS, LAW
from agent.config.agent import build_agent
from agent.config.cell import load_cell
from agent.config.noticing import brace
from agent.config.schema.driver import DriverKind
from agent.config.schema.fault import Fault, FaultKind
from agent.control.alignment import Alignment
from agent.control.brace import NOT_BRACED, Brace, Braced, begun, braced_of
from agent.control.errors import attitude_angle
from agent.control.memory import Memory, restore
from agent.faults.plan import Injection
from agent.faults.rehearse import rehearse
from agent.loop import Agent, Outcome, initial_memory, step
from agent.modes import Mode
from agent.process.describe import run_info
from agent.safety import Flag
from agent.standing import afresh, hold_after, hold_here
from agent.study.lab import Laboratory, Run
from agent.verify.noticing import noticed
from drivers.interface import JointState
from tests.support.branched import branched, ways
from tests.unit.test_step_rules import arm, start, tick

PERIOD = 5e-3
LAW_2N = Brace(PERIOD, 2.0)
AHEAD = Braced(0.6, 0.0, -0.8)
NOWHERE = (0.0, 0.0, 0.0)


def carried(metres: float, across: float = 0.0) -> tuple[float, float, float]:
    """An error so far ahead along `AHEAD`, and so far across."""
    return 0.6 * metres + 0.8 * across, 0.0, -0.8 * metres + 0.6 * across


# --- how it grows ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("metres", "grows_N_per_s"), [(2e-4, 0.0), (3e-4, 6.0), (5e-4, 18.0), (6e-4, 20.0), (9.0, 20.0), (-9.0, 0.0)]
)
def test_it_grows_with_how_far_the_object_is_carried_on_beyond_a_slack_and_no_quicker_than_its_rate(
    metres: float, grows_N_per_s: float
) -> None:
    found = LAW_2N.advance(AHEAD, carried(metres, across=0.3))
    assert found.force_N == pytest.approx(PERIOD * grows_N_per_s, abs=1e-12)
    assert found[:3] == AHEAD[:3]


def test_a_force_that_nothing_asks_for_fades_and_none_is_above_the_limit() -> None:
    assert LAW_2N.advance(AHEAD._replace(force_N=1.0), NOWHERE).force_N == pytest.approx(1.0 - 2.0 * PERIOD)
    assert LAW_2N.advance(AHEAD._replace(force_N=1.99), carried(1e-2)).force_N == 2.0


def test_what_is_usual_is_followed_and_only_what_is_beyond_it_counts() -> None:
    usual = AHEAD._replace(usual_m=1e-3)
    assert LAW_2N.advance(usual, carried(1.3e-3)).force_N == pytest.approx(PERIOD * 6.0)
    assert LAW_2N.advance(usual, carried(1.3e-3)).usual_m == pytest.approx(1e-3 + PERIOD * 2.0 * 3e-4)
    assert LAW_2N.advance(usual, carried(5e-4)).usual_m == pytest.approx(1e-3 - PERIOD * 2.0 * 5e-4)


def test_an_arm_that_was_not_following_never_pulls() -> None:
    assert LAW_2N.advance(NOT_BRACED, carried(1.0)) is NOT_BRACED
    for along in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)):
        assert LAW_2N.advance(Braced(*along), along).force_N == pytest.approx(PERIOD * 20.0)


def test_it_begins_with_the_direction_of_the_motion_and_the_error_of_that_moment() -> None:
    found = begun((0.006, 0.0, -0.008, 9.0, 9.0, 9.0), carried(4e-4, across=0.1))
    assert found == pytest.approx((0.6, 0.0, -0.8, 4e-4, 0.0))
    found = begun((0.0, 0.01, 0.0, 0.0, 0.0, 0.0), (0.1, 0.2, 0.3))
    assert found == pytest.approx((0.0, 1.0, 0.0, 0.2, 0.0))
    assert begun((2e-3, 0.0, 0.0, 1.0, 1.0, 1.0), NOWHERE) is NOT_BRACED, "hardly a direction"
    assert begun((np.nextafter(2e-3, 1.0), 0.0, 0.0, 0.0, 0.0, 0.0), NOWHERE).x == 1.0
    assert begun((math.nan,) * 6, NOWHERE) is NOT_BRACED


def test_the_pull_is_against_that_direction() -> None:
    assert Braced(0.6, 0.0, -0.8, force_N=1.5).pull == pytest.approx((-0.9, 0.0, 1.2))
    assert Braced(0.0, 0.6, 0.8, force_N=0.5).pull == pytest.approx((0.0, -0.3, -0.4))


def test_its_state_goes_through_a_row() -> None:
    braced = Braced(0.6, 0.0, -0.8, 1e-4, 1.5)
    memory = initial_memory(arm())._replace(braced=braced)
    assert braced_of([*braced, 9.0]) == braced
    assert braced_of([]) == NOT_BRACED, "a row of a log that is older than this"
    flat = np.array(memory.flatten())
    assert flat[-12:-7].tolist() == list(braced)
    assert restore(flat, 3).braced == braced
    assert restore(flat[:-12], 3).braced == NOT_BRACED
    assert restore(flat[:-11], 3).sense.struck == restore(flat, 3).sense.struck


# --- who has it ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "changes", "limit_N"),
    [
        ("paper_real", [], None),
        ("two_wx200", [], None),
        ("two_wx200", ["safety.noticing.brace_N=1.5"], 1.5),
        ("three_wx250s", [], 2.0),
        ("four_wx250s", [], 2.0),
        ("four_wx250s", ["safety.noticing.brace_N=0.0"], None),
        ("four_wx250s", ["safety.noticing.enabled=false"], None),
    ],
)
def test_three_and_more_arms_have_it_and_two_where_it_is_asked_for(
    name: str, changes: list[str], limit_N: float | None
) -> None:
    cell = load_cell(Path(name), changes)
    expected = None if limit_N is None else Brace(PERIOD, limit_N)
    assert brace(cell) == expected
    assert all(build_agent(cell, one).brace == expected for one in cell.arms)
    assert json.loads(run_info(cell, DriverKind.SIM, 0))["noticing_brace_N"] == limit_N
    told = [finding.found for finding in noticed(cell) if finding.what == "an arm that holds pulls back"]
    assert told == ([] if limit_N is None else [f"up to {limit_N:g} N where it is carried on"])


def test_a_hold_that_began_in_the_motion_is_braced_and_one_that_begins_anew_is_not() -> None:
    aligned = arm(alignment=Alignment(True))
    outcome = tick(aligned, start(), t=0.7)
    assert outcome.terms is not None
    held = hold_after(aligned, outcome)
    assert held.braced == begun(outcome.terms.desired.v, outcome.terms.errors.e_p) != NOT_BRACED
    assert hold_after(arm(), outcome).braced == NOT_BRACED, "an arm that holds the object where it is"
    assert hold_after(aligned, outcome._replace(terms=None)).braced == NOT_BRACED
    assert afresh(held, Flag.GAP).braced == afresh(held, Flag.RESUMED).braced == NOT_BRACED
    assert afresh(held, Flag.NONE).braced == held.braced


# --- what it does in a tick ------------------------------------------------------------------------------------------

PULLS = Braced(0.6, 0.0, -0.8, 0.0, 1.5)


def holding(agent: Agent, *aside: float, **more: Any) -> Memory:
    return hold_here(agent, start(*aside), initial_memory(agent))._replace(braced=PULLS, **more)


def hold(agent: Agent, memory: Memory, mode: Mode = Mode.HOLD, dq: float = 0.0) -> Outcome:
    q = start() if memory.q_hold is None else memory.q_hold
    return step(agent, JointState(0, q, np.array([0.0, dq, 0.0]), np.zeros(3)), 0.7, mode, memory)


def test_a_hold_pulls_the_object_back_with_that_force() -> None:
    """−F d about the object's centre, whatever its attitude, beside the internal wrench that the cell asks for."""
    plain = arm(brace=LAW_2N)
    for agent, aside in ((plain, ()), (with_internal(plain), ()), (plain, (0.1, -0.1, 0.3))):
        with_it = hold(agent, holding(agent, *aside)).terms
        without = hold(agent, holding(agent, *aside)._replace(braced=NOT_BRACED)).terms
        assert with_it is not None
        assert without is not None
        turned_rad = attitude_angle(*with_it.kinematics.quat_object[:1], with_it.kinematics.quat_object[1:])
        assert (turned_rad > 0.1) is bool(aside)
        pull = np.array([-0.9, 0.0, 1.2, 0.0, 0.0, 0.0])
        expected = (agent.model.task_basis.T @ with_it.kinematics.J).T @ pull
        assert np.abs(expected).max() > 0.05
        np.testing.assert_allclose(with_it.tau_internal - without.tau_internal, expected, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(with_it.tau_cmd - without.tau_cmd, expected, rtol=0.0, atol=1e-9)


def with_internal(agent: Agent) -> Agent:
    return replace(agent, offline=replace(agent.offline, internal_wrench=(0.3, -0.2, 0.1, 0.01, 0.02, 0.03)))


@pytest.mark.parametrize("mode", [Mode.READY, Mode.TRACK])
def test_nothing_but_a_hold_pulls(mode: Mode) -> None:
    agent = arm(brace=LAW_2N)
    found, plain = hold(agent, holding(agent), mode), hold(agent, holding(agent)._replace(braced=NOT_BRACED), mode)
    assert found.tau.tolist() == plain.tau.tolist()
    assert found.memory.braced == NOT_BRACED


def test_a_hold_goes_on_with_it_by_the_law_alone() -> None:
    agent = arm(brace=LAW_2N, damp_above_rad_per_s=0.5)
    found = hold(agent, holding(agent))
    assert found.terms is not None
    assert found.memory.braced == LAW_2N.advance(PULLS, found.terms.errors.e_p) != PULLS
    assert found.memory.calm == LAW
    assert hold(agent, holding(agent), dq=0.6).memory.braced == NOT_BRACED
    for calm in (BRAKE, JOINTS, JOINTS + 5):
        assert hold(agent, holding(agent, calm=calm)).memory.braced == NOT_BRACED
    assert hold(arm(), holding(arm())).memory.braced == NOT_BRACED, "a cell that does not ask for it"
    singular = arm(brace=LAW_2N, sigma_min=10.0)
    assert hold(singular, holding(singular)).memory.braced == NOT_BRACED, "by its joints"


# --- what it is for --------------------------------------------------------------------------------------------------


@cache
def laboratory(name: str, *changes: str) -> Laboratory:
    return Laboratory(load_cell(Path(name), ["simulation.ready_s=0.4", *changes]))


@cache
def way(name: str) -> Callable[[float], Run]:
    """As long as nobody holds, a cell with the pull does what one without it does."""
    return ways(laboratory(name))


def until(end_s: float, name: str, *changes: str, holds: Sequence[str], at_s: float) -> Run:
    faults = [Fault(kind=FaultKind.HOLD, arm=arm_name, at_s=at_s) for arm_name in holds]
    run = branched(way(name)(at_s), laboratory(name, *changes), *faults)
    while run.t < end_s:
        run.advance()
    return run


@pytest.mark.parametrize(
    ("name", "arm_name", "at_s"),
    [("four_wx250s", "back", 2.2), pytest.param("three_wx250s", "left", 6.2, marks=pytest.mark.long)],
)
def test_neighbours_notice_a_hold_in_a_slow_motion_which_they_do_not_without_it(
    name: str, arm_name: str, at_s: float
) -> None:
    run = until(at_s + 0.5, name, holds=[arm_name], at_s=at_s)
    assert [trip.arm for trip in run.trips].count(arm_name) == 0
    assert len(run.trips) == len(run.places) - 1, "all of the others"
    assert until(at_s + 0.5, name, "safety.noticing.brace_N=0.0", holds=[arm_name], at_s=at_s).trips == []


@pytest.mark.long
@pytest.mark.parametrize(("name", "arm_name", "at_s"), [("four_wx250s", "back", 2.2), ("three_wx250s", "left", 6.2)])
def test_so_they_do_with_the_real_driver_and_loop_on_emulated_servos(name: str, arm_name: str, at_s: float) -> None:
    def held_s(*changes: str) -> list[float]:
        cell = load_cell(Path(name), [f"duration_s={at_s + 0.6}", *changes])
        found = rehearse(cell, [Injection(fault="operator-off", arm=arm_name, at_s=at_s)])
        others = [arm_run for other, arm_run in found.arms.items() if other != arm_name]
        return [t for other in others for t, mode in other.modes if mode is Mode.HOLD]

    assert [at_s < t < at_s + 0.5 for t in held_s()] == [True] * (2 if name == "three_wx250s" else 3)
    assert held_s("safety.noticing.brace_N=0.0") == []


def test_a_tick_of_a_braced_hold_goes_on_from_its_row_bit_for_bit() -> None:
    run = until(2.8, "three_wx250s", holds=["left"], at_s=2.5)
    place = run.places[0]
    assert place.memory.braced.force_N > 0.1
    q, dq, tau = (values[place.joints] for values in run.plant.reported())
    state = JointState(0, q, dq, tau)
    restored = restore(np.array(place.memory.flatten()), place.agent.model.n)
    one, two = (step(place.agent, state, run.t, Mode.HOLD, memory) for memory in (place.memory, restored))
    assert one.tau.tobytes() == two.tau.tobytes()
    assert one.memory.flatten() == two.memory.flatten()


def test_arms_that_hold_together_hardly_pull_and_keep_the_object() -> None:
    """At 9 mm/s; what friction lets go comes to rest, and the pull fades."""
    run = until(4.5, "three_wx250s", holds=["left", "back", "front"], at_s=4.5)
    before, most = run.observe().p_object, 0.0
    while run.t < 6.5:
        run.advance()
        most = max(most, *(place.memory.braced.force_N for place in run.places))
    assert np.linalg.norm(run.observe().p_object - before) < 1e-3
    assert 0.0 < most < 2.0
    assert max(place.memory.braced.force_N for place in run.places) < 0.2
