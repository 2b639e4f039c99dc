"""Torques of an arm on its way to the object and back, by their formulas, and when each phase is done."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from agent import phases
from agent.control import joint_track, known
from agent.control.friction import Friction, JointFriction
from agent.control.joint_path import JointDesired
from agent.control.life import Life
from agent.control.memory import Memory
from agent.control.terms import Terms
from agent.control.trajectory import Desired
from agent.loop import Agent, initial_memory
from agent.modes import Mode
from tests.support.session_script import made, q_grasp

STILL = (0.0,) * 6
QUARTER = 0.103515625  # s(1/4) of the minimum-jerk law
Q, DQ = np.array([0.1, -0.2, 0.3]), np.array([0.4, -0.3, 0.2])
GLIDING = Friction((JointFriction(0.08, 0.03),) * 3, 0.05)
STICKING = Friction((JointFriction(0.08, 0.03, 0.05, load=0.2),) * 3, 0.05)


def life() -> Life:
    session = made().session
    assert session is not None
    return replace(session.life, take_up_s=0.8, lower_s=2.0, rate_rad_per_s=7.0, soft_rad=0.05)


def remembering(**more: Any) -> Memory:
    return initial_memory(made())._replace(**more)


def same(one: Terms, other: Terms) -> bool:
    return np.array_equal(one.joints, other.joints) and one.desired == other.desired


@pytest.mark.parametrize("friction", [None, GLIDING, STICKING])
def test_alone_an_arm_follows_its_joints_critically_damped_with_a_bounded_pull(friction: Friction | None) -> None:
    agent, w, soft = made(), 7.0, 0.05
    offline = replace(agent.offline, friction=friction)
    wanted = JointDesired(Q + np.array([0.02, 0.2, -0.2]), np.array([0.3, -0.1, 0.05]), np.array([1.0, -2.0, 3.0]))
    terms = joint_track.torque(agent.model, offline, Q, DQ, wanted, w, soft)
    k = agent.model.evaluate(Q, DQ)
    ddq = wanted.ddq - 2.0 * w * (DQ - wanted.dq) - w * w * np.array([-0.02, -soft, soft])
    tau = k.B @ ddq + k.C @ DQ + k.g
    assert terms.ddq_ref == pytest.approx(ddq)
    assert terms.dq_ref.tolist() == wanted.dq.tolist()
    rubs = np.zeros(3) if friction is None else friction.torque(wanted.dq, DQ, tau)
    assert terms.tau_friction == pytest.approx(rubs)
    assert terms.tau_cmd == pytest.approx(tau + rubs)
    pose = agent.model.object_pose(wanted.q)
    assert terms.desired.p == pytest.approx(pose.translation)
    x, y, z, turned = pin.Quaternion(pose.rotation).coeffs()
    assert terms.desired.quat == pytest.approx((turned, x, y, z))
    assert (*terms.desired.v, *terms.desired.a) == (0.0,) * 12
    assert np.isnan((*terms.wrench_cmd, *terms.wrench_internal, terms.lyapunov, terms.sigma_min)).sum() == 14
    assert terms.J_inv_P is None


def test_in_five_modes_an_arm_is_alone() -> None:
    assert {Mode.REST, Mode.APPROACH, Mode.GRASP, Mode.PARK, Mode.HALT} == phases.ALONE


@pytest.mark.parametrize("q_hold", [None, Q + 0.01])
@pytest.mark.parametrize("mode", sorted(phases.ALONE))
def test_where_the_joints_are_to_be_is_that_of_the_mode(mode: Mode, q_hold: Any) -> None:
    own, memory = life(), remembering(q_hold=q_hold, age=0.7)
    begun = Q if q_hold is None else q_hold
    at_rest = JointDesired(q_grasp() if mode is Mode.GRASP else begun, np.zeros(3), np.zeros(3))
    on_its_way = {
        Mode.APPROACH: own.journey(begun, forward=True).at(0.7), Mode.PARK: own.journey(begun, forward=False).at(0.7)
    }  # fmt: skip
    expected, found = on_its_way.get(mode, at_rest), phases.wanted(own, mode, memory, Q)
    for one, other in zip(found, expected, strict=True):
        assert one.tolist() == other.tolist()
    agent = made()
    terms = phases.alone(agent.model, agent.offline, own, mode, memory, Q, DQ)
    assert same(terms, joint_track.torque(agent.model, agent.offline, Q, DQ, expected, 7.0, 0.05))
    assert phases.off(own, mode, memory, Q) == np.abs(Q - expected.q).max()


def test_the_load_goes_over_by_minimum_jerk_in_two_modes() -> None:
    for age, part in ((0.0, 0.0), (0.2, QUARTER), (0.4, 0.5), (0.8, 1.0), (9.0, 1.0)):
        memory = remembering(age=age)
        assert phases.handing_over(life(), Mode.READY, memory) == pytest.approx(part)
        assert phases.handing_over(life(), Mode.RELEASE, memory) == pytest.approx(1.0 - part)
        assert phases.handing_over(life(), Mode.HOLD, memory) == 1.0


def law(agent: Agent) -> Terms:
    pose = agent.model.evaluate(Q, DQ)
    return known.torque(agent.model, agent.offline, Q, DQ, Desired(pose.p_object, pose.quat_object, STILL, STILL))


@pytest.mark.parametrize("q_hold", [None, Q + 0.01])
def test_between_the_joints_and_the_law_the_torque_is_a_mean_of_both(q_hold: Any) -> None:
    agent, own, memory = made(), life(), remembering(q_hold=q_hold)
    of = agent.model, agent.offline
    stands = joint_track.torque(*of, Q, DQ, joint_track.still(Q if q_hold is None else q_hold), 7.0, 0.05)
    assert same(phases.handed_over(*of, own, memory, 0.0, None, Q, DQ), stands)
    holds = law(agent)
    between = phases.handed_over(*of, own, memory, 0.25, holds, Q, DQ)
    np.testing.assert_allclose(between.joints, 0.75 * stands.joints + 0.25 * holds.joints, atol=1e-12)
    assert between.J_inv_P is None
    assert between.desired is holds.desired


def test_the_way_down_is_minimum_jerk_from_what_was_held() -> None:
    place = Desired((0.3, 0.1, 0.05), (1.0, 0.0, 0.0, 0.0), STILL, STILL)
    assert phases.lowering(life(), remembering(age=0.5), place) is place
    held = (0.32, 0.06, 0.15, math.cos(0.1), 0.0, math.sin(0.1), 0.0)
    found = phases.lowering(life(), remembering(hold=held, age=0.5), place)
    assert found.p == pytest.approx([h + QUARTER * (p - h) for h, p in zip(held[:3], place.p, strict=True)])
    angle = 0.1 * (1.0 - QUARTER)
    assert found.quat == pytest.approx((math.cos(angle), 0.0, math.sin(angle), 0.0))
    for age in (2.0, 9.0):
        below = phases.lowering(life(), remembering(hold=held, age=age), place)
        assert (below.p, below.v) == (pytest.approx(place.p), pytest.approx(STILL)), "and it stays there"
    assert found.v[2] == pytest.approx(-0.1 * 30.0 * (0.25 * 0.75) ** 2 / 2.0)


def test_a_start_beside_the_place_goes_away_as_one_less_minimum_jerk() -> None:
    shift = (0.01, -0.02, 0.03, 0.1, -0.2, 0.3)
    for t, left in ((0.0, 1.0 - QUARTER), (0.25, 0.5 / (1.0 - QUARTER)), (0.75, 0.0)):
        expected = [left * x for x in shift]
        assert phases.blended(shift, t, 0.25, 1.0) == pytest.approx(expected)
    for t in (math.nextafter(0.0, -1.0), 1.0, 9.0):
        assert phases.blended(shift, t, 0.25, 1.0) is shift
    for k in range(1, 60):  # at k = 16 s is one already
        assert phases.blended(shift, 1.0 - 2e-9 * k, 0.25, 1.0) == (0.0,) * 6, "nothing is left to divide by"


def test_a_phase_is_done_when_its_time_is_over() -> None:
    own = life()
    ways = {
        Mode.APPROACH: own.journey(Q, forward=True).seconds(), Mode.PARK: own.journey(Q, forward=False).seconds(),
        Mode.READY: 0.8, Mode.RELEASE: 0.8, Mode.LOWER: 2.0,
    }  # fmt: skip
    assert ways[Mode.APPROACH] != ways[Mode.PARK]
    for mode, seconds in ways.items():
        assert phases.arrived(own, mode, remembering(q_hold=Q, age=seconds))
        assert not phases.arrived(own, mode, remembering(q_hold=Q, age=math.nextafter(seconds, 0.0)))
    for mode in (Mode.APPROACH, Mode.PARK):
        assert not phases.arrived(own, mode, remembering(age=1e3)), "it has not begun"
    for mode in set(Mode) - set(ways):
        assert phases.arrived(own, mode, remembering(age=0.0))
