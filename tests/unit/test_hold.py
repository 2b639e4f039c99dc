"""What a hold does with states that come too rarely, and an arm with none: pure functions of its memory."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import configs
from agent.calm import BRAKE, JOINTS, LAW
from agent.config.cell import load_cell
from agent.control.joint_hold import torque, weight
from agent.control.law import Offline
from agent.control.memory import Memory
from agent.cycles import Patience
from agent.loop import Agent, Outcome, blind, initial_memory, step
from agent.modes import Mode
from agent.process.build import build_agent
from agent.process.schedule import patience_of
from agent.safety import Flag, Limits, limit
from agent.standing import afresh, hold_here
from drivers.interface import JointState, Vector
from tests.unit.test_step_rules import arm, start

T = 0.7
GENTLE = JOINTS + 100  # half a second at 200 Hz


def holding(agent: Agent, **more: Any) -> Memory:
    q = start()
    return hold_here(agent, q, initial_memory(agent))._replace(primed=True, q=q, t=T, **more)


def tick(
    agent: Agent,
    memory: Memory,
    after: float,
    q: Vector | None = None,
    dq: Any = (0.0, 0.0, 0.0),
    mode: Mode = Mode.HOLD,
) -> Outcome:
    """A tick so many periods after the last one."""
    state = JointState(0, start() if q is None else q, np.array(dq), np.zeros(3))
    return step(agent, state, T + after * agent.period_s, mode, memory)


# --- starved ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("after", "before", "known", "calm", "knows"),
    [
        (1.0, LAW, 0, LAW, 0), (3.0, LAW, 0, LAW, 0), (3.49, LAW, 0, LAW, 0), (3.49, LAW, 20, LAW, 19),
        (1.0, LAW, 1, LAW, 0),
        # missed once: it goes on as it was
        (3.51, LAW, 0, LAW, 20), (4.0, JOINTS, 0, JOINTS, 20), (30.0, LAW, 0, LAW, 20),
        # and again before that is forgotten
        (3.51, LAW, 1, GENTLE, 20), (4.0, BRAKE, 20, GENTLE, 20), (4.0, JOINTS, 7, GENTLE, 20),
        (4.0, JOINTS + 3, 0, GENTLE, 20), (4.0, JOINTS + 1, 0, GENTLE, 20),
        (1.0, GENTLE, 0, GENTLE - 1, 0), (1.0, GENTLE, 20, GENTLE - 1, 19), (1.0, JOINTS + 1, 0, JOINTS, 0),
    ],
)  # fmt: skip
def test_a_hold_that_misses_states_again_and_again_is_gentle_for_a_hundred_ticks(
    after: float, before: int, known: int, calm: int, knows: int
) -> None:
    outcome = tick(arm(), holding(arm(), calm=before, missed=known), after)
    assert (outcome.memory.calm, outcome.memory.missed) == (calm, knows)
    assert (Flag.GENTLE in outcome.flags) is (calm >= JOINTS)
    assert Flag.DAMPED not in outcome.flags


def test_a_brake_that_missed_states_brakes_on_until_it_is_nearly_at_rest() -> None:
    agent = arm(damp_above_rad_per_s=1.0)
    for dq, calm in ((0.21, BRAKE), (0.19, JOINTS)):
        assert tick(agent, holding(agent, calm=BRAKE), 4.0, dq=(dq, 0.0, 0.0)).memory.calm == calm


@pytest.mark.parametrize("mode", [Mode.READY, Mode.TRACK])
def test_other_modes_are_not_gentle(mode: Mode) -> None:
    outcome = tick(arm(), holding(arm(), calm=GENTLE, missed=20), 10.0, mode=mode)
    assert (outcome.memory.calm, outcome.memory.missed, Flag.GENTLE in outcome.flags) == (LAW, 0, False)


@pytest.mark.parametrize(
    ("calm", "rate", "reach", "period_s"),
    [(GENTLE, 5.0, 0.1, 0.005), (GENTLE, 1.0 / 0.6, 0.1, 0.02), (JOINTS + 1, 20.0, np.inf, 0.005)],
)
def test_a_gentle_hold_is_one_of_the_joints(calm: int, rate: float, reach: float, period_s: float) -> None:
    agent, dq = arm(hold_rate_rad_per_s=20.0, period_s=period_s), np.array([0.2, -0.1, 0.3])
    q = start() + np.array([0.05, -0.3, 0.02])
    memory = holding(agent, calm=calm)
    outcome = tick(agent, memory, 1.0, q, dq)
    assert memory.q_hold is not None
    wanted = torque(agent.model, agent.offline, q, dq, memory.q_hold, rate, reach)
    np.testing.assert_array_equal(outcome.tau, wanted.tau_cmd)
    assert Flag.ADAPTATION_SATURATED not in outcome.flags
    assert np.abs(q - start()).max() > 0.1, "so that the reach counts"


def test_a_gentle_hold_with_nothing_to_go_back_to_is_one_of_the_law() -> None:
    terms = tick(arm(), holding(arm(), calm=GENTLE)._replace(q_hold=None), 1.0).terms
    assert terms is not None
    assert terms.J_inv_P is not None


def test_a_joint_beyond_the_reach_is_pulled_as_one_at_it() -> None:
    agent, q_hold, dq = arm(), start(), np.array([0.2, -0.1, 0.3])
    terms = torque(agent.model, agent.offline, q_hold + np.array([0.05, -0.3, 0.4]), dq, q_hold, 5.0, 0.1)
    np.testing.assert_allclose(terms.ddq_ref, -10.0 * dq - 25.0 * np.array([0.05, -0.1, 0.1]))


def test_what_was_measured_counts_after_a_long_time_and_not_what_was_expected() -> None:
    cell = load_cell(configs.CELLS_DIR / "paper.toml", ['controller.velocity="observer"'])
    agent = arm(observer=build_agent(cell, cell.arms[0]).observer)
    moved = start() + 0.02
    for after, seen in ((4.0, True), (1.0, False)):
        outcome = tick(agent, holding(agent), after, moved, (0.1, 0.1, 0.1))
        assert np.array_equal(outcome.q, moved) is seen
    followed = tick(agent, holding(agent), 4.0, moved, (0.1, 0.1, 0.1), Mode.TRACK)
    assert not np.array_equal(followed.q, moved), "a hold alone"


def test_three_periods_and_a_half_are_not_too_long() -> None:
    agent = arm()
    memory = holding(agent)._replace(t=0.0)
    state = JointState(0, start(), np.zeros(3), np.zeros(3))
    for t, missed in ((3.5 * agent.period_s, 0), (np.nextafter(3.5 * agent.period_s, 1.0), 20)):
        assert step(agent, state, float(t), Mode.HOLD, memory).memory.missed == missed


def test_a_hold_that_brakes_on_goes_back_to_where_it_began() -> None:
    agent = arm(damp_above_rad_per_s=0.5)
    memory = holding(agent, calm=BRAKE)
    outcome = tick(agent, memory, 1.0, start() + 0.3, (0.4, 0.0, 0.0))
    assert outcome.memory.calm == BRAKE
    assert outcome.memory.q_hold is memory.q_hold


def test_a_hold_that_has_braked_with_nothing_to_go_back_to_goes_nowhere() -> None:
    agent = arm(damp_above_rad_per_s=0.5)
    outcome = tick(agent, holding(agent, calm=BRAKE)._replace(q_hold=None), 1.0)
    assert (outcome.memory.calm, outcome.memory.q_hold) == (JOINTS, None)


def test_a_hold_that_has_braked_goes_back_a_little_way_only() -> None:
    agent = arm(damp_above_rad_per_s=0.5)
    q = start() + np.array([0.03, -0.3, 0.3])
    outcome = tick(agent, holding(agent, calm=BRAKE), 1.0, q)
    assert outcome.memory.calm == JOINTS
    assert outcome.memory.q_hold is not None
    np.testing.assert_allclose(outcome.memory.q_hold - q, [-0.03, 0.04, -0.04], atol=1e-15)


def test_brakes_are_weaker_in_slow_loops() -> None:
    dq = np.array([0.0, 2.0, 0.0])
    for period_s, brake in ((0.005, 30.0), (0.01, 25.0), (0.02, 12.5)):
        agent = arm(damp_above_rad_per_s=0.5, period_s=period_s)
        outcome = tick(agent, holding(agent), 1.0, dq=dq)
        terms = outcome.terms
        assert terms is not None
        k = terms.kinematics
        np.testing.assert_allclose(outcome.tau, terms.tau_object + k.g - brake * k.B @ dq, rtol=1e-12)
        np.testing.assert_allclose(outcome.memory.ddq, -brake * dq)


# --- blind -----------------------------------------------------------------------------------------------------------


def test_the_weight_is_what_holds_the_arm_still() -> None:
    agent, q = arm(), start()
    wanted = torque(agent.model, agent.offline, q, np.zeros(3), q, 7.0).tau_cmd
    np.testing.assert_allclose(weight(agent.model, agent.offline, q, carries=True), wanted, rtol=1e-12)
    offline: Offline = agent.offline
    assert offline.load_share > 0.0
    g = agent.model.evaluate(q, 0.0 * q).g
    assert np.abs(wanted - g).max() > 1e-3
    np.testing.assert_array_equal(weight(agent.model, offline, q, carries=False), g)


def test_a_blind_tick_goes_to_the_weights_torque_within_the_step_limit() -> None:
    agent = arm(limits=Limits((1e3,) * 3, (0.1, 0.2, 0.3)))
    before = np.array([3.0, -2.0, 0.5])
    memory = holding(agent, tau=before)
    wanted = weight(agent.model, agent.offline, memory.q, carries=True)
    outcome = blind(agent, Mode.TRACK, memory)
    np.testing.assert_allclose(outcome.tau, before + np.clip(wanted - before, [-0.1, -0.2, -0.3], [0.1, 0.2, 0.3]))
    assert outcome.flags == Flag.STALE | Flag.BLIND | Flag.RATE_LIMITED
    assert np.isnan(outcome.q).all()
    np.testing.assert_array_equal(outcome.memory.tau, outcome.tau)
    np.testing.assert_array_equal(outcome.memory.tau_before, before)
    assert (outcome.memory.primed, outcome.memory.calm) == (False, LAW)
    for _ in range(60):
        outcome = blind(agent, Mode.TRACK, outcome.memory)
    np.testing.assert_array_equal(outcome.tau, wanted)
    assert outcome.flags == Flag.STALE | Flag.BLIND


def test_an_arm_that_was_never_seen_gets_no_torque() -> None:
    agent = arm()
    outcome = blind(agent, Mode.TRACK, initial_memory(agent))
    np.testing.assert_array_equal(outcome.tau, 0.0)


def test_an_arm_that_was_seen_gets_its_weights_torque_though_it_had_none() -> None:
    agent = arm()
    np.testing.assert_array_equal(
        blind(agent, Mode.TRACK, holding(agent)).tau,
        limit_of(agent, weight(agent.model, agent.offline, start(), carries=True)),
    )


def limit_of(agent: Agent, tau_Nm: Vector) -> Vector:
    """What goes out of a torque behind none."""
    return np.array(limit(tau_Nm.tolist(), [0.0] * 3, agent.limits)[0])


@pytest.mark.parametrize(
    ("marks", "gone", "calm"), [(Flag.GAP, False, JOINTS), (Flag.RESUMED, True, GENTLE + 1), (Flag.NONE, False, JOINTS)]
)
def test_a_hold_that_begins_afresh_forgets_where_it_was(marks: Flag, gone: bool, calm: int) -> None:
    agent, tau = arm(), np.array([1.0, 0.0, 3.0])
    memory = holding(agent, tau=tau, tau_before=2.0 * tau, calm=JOINTS)
    after = afresh(memory, marks)
    assert after.calm == calm
    np.testing.assert_array_equal(after.tau, 0.0 * tau if gone else tau)
    np.testing.assert_array_equal(after.tau_before, 0.0 * tau if gone else 2.0 * tau)
    kept = not marks
    assert ((after.hold is not None), (after.q_hold is not None), after.primed) == (kept, kept, kept)


# --- patience --------------------------------------------------------------------------------------------------------


def test_the_patience_with_real_arms_follows_the_cell() -> None:
    cell = load_cell(configs.CELLS_DIR / "paper.toml")
    assert patience_of(cell, emulated=False) == Patience(
        hold=3, repeat=3, blind=40, quiet=50, recover=400, retry=20, gap=10, success_min=0.9
    )
    other = load_cell(configs.CELLS_DIR / "paper.toml", ["rate_hz=100", "safety.blind_s=0.5", "safety.recover_s=0"])
    assert patience_of(other, emulated=False) == Patience(
        hold=3, repeat=3, blind=50, quiet=25, recover=0, retry=10, gap=10, success_min=0.9
    )


def test_emulated_arms_get_more_time_but_not_the_laws_torque_for_longer() -> None:
    cell = load_cell(configs.CELLS_DIR / "paper.toml")
    assert patience_of(cell, emulated=True) == Patience(
        hold=100, repeat=3, blind=100, quiet=50, recover=400, retry=20, gap=100, success_min=0.0
    )
