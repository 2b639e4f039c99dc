"""The adaptive agent tick by tick: what it carries, logs and reports, and that a log continues from any row."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.control.adaptation import Estimate, from_row
from agent.control.memory import Memory, initial, restore
from agent.loop import Agent, Outcome, initial_memory, step
from agent.modes import Mode
from agent.process.build import build_agent
from agent.safety import Flag
from agent.standing import hold_here
from agent.telemetry.row.fill import AgentRow
from agent.telemetry.row.sample import AGENT_STATE
from drivers.interface import BusCounters, JointState

PERIOD = 0.004
SLOW = ("controller.adaptive.gamma=1e-9", "controller.adaptive.gamma_object=1e-9")  # far from every bound
ADAPTIVE = configs.CELLS_DIR / "paper_adaptive.toml"


def agent_of(*overrides: str) -> tuple[Agent, np.ndarray]:
    cell = load_cell(ADAPTIVE, overrides)
    return build_agent(cell, cell.arms[0]), np.array(cell.arms[0].entry.q_near_rad)


def states_of(q: np.ndarray, count: int) -> list[JointState]:
    """Joints that move, and miss a cycle now and then."""
    stamps = np.cumsum([PERIOD * (2 if k % 7 == 5 else 1) for k in range(count)])
    return [
        JointState(round(t * 1e9), q + 0.02 * np.sin(9 * t + np.arange(3)), 0.1 * np.cos(9 * t + np.arange(3)), 0 * q)
        for t in stamps
    ]


def run(agent: Agent, states: list[JointState], hold_from: int) -> tuple[list[Outcome], list[Memory], np.ndarray]:
    """Outcomes, the memories the ticks began with, and the log rows."""
    memory, outcomes, memories, rows = initial_memory(agent), [], [], np.zeros(len(states), AGENT_STATE.dtype)
    for k, state in enumerate(states):
        mode = Mode.TRACK if k < hold_from else Mode.HOLD
        if k == hold_from:
            memory = hold_here(agent, outcomes[-1].q, memory)
        memories.append(memory)
        outcomes.append(step(agent, state, state.stamp_ns * 1e-9, mode, memory))
        row = AgentRow(rows[k : k + 1], agent.model.n, 1)
        row.fill(k, state.stamp_ns * 1e-9, 0, mode, state, memory, outcomes[-1], outcomes[-1].tau)
        row.fill_timing(0.0, 0.0, 0.0, 0.0, BusCounters())
        memory = outcomes[-1].memory
    return outcomes, memories, rows


@pytest.mark.parametrize("velocity", ["servo", "observer"])
def test_from_any_log_row_the_run_goes_on_bit_for_bit(velocity: str) -> None:
    agent, q = agent_of(f'controller.velocity="{velocity}"', "controller.adaptive.coulomb=true")
    states = states_of(q, 40)
    outcomes, _, rows = run(agent, states, hold_from=30)
    for first in (0, 1, 6, 17, 29, 30, 39):
        row = rows[first]
        memory = restore(row["memory"], 3, from_row(row["theta_arm"], row["theta_object"], 3))
        for k in range(first, len(states)):
            if k == 30 and first < 30:
                memory = hold_here(agent, outcomes[k - 1].q, memory)
            again = step(agent, states[k], states[k].stamp_ns * 1e-9, Mode(int(rows[k]["mode"])), memory)
            assert np.array_equal(again.tau, outcomes[k].tau)
            memory = again.memory
        assert memory.estimate is not None
        assert np.array_equal(memory.estimate.arm, outcomes[-1].memory.estimate.arm)
        assert np.array_equal(memory.estimate.object, outcomes[-1].memory.estimate.object)


def test_a_row_holds_the_estimate_from_before_its_tick() -> None:
    agent, q = agent_of()
    _, memories, rows = run(agent, states_of(q, 12), hold_from=99)
    for memory, row in zip(memories, rows, strict=True):
        assert memory.estimate is not None
        assert np.array_equal(row["theta_arm"][:48], memory.estimate.arm)
        assert np.array_equal(row["theta_object"], memory.estimate.object)
        assert not row["theta_arm"][48:].any()
    assert not rows[0]["theta_object"].any()
    assert rows[-1]["theta_object"].any()


def test_the_adaptation_integrates_over_the_time_that_really_passed() -> None:
    agent, q = agent_of('controller.adaptive.start="nominal"', 'controller.velocity="servo"', *SLOW)
    adaptation = agent.offline.adaptation
    assert adaptation is not None
    state = JointState(0, q, np.array([0.2, -0.1, 0.1]), np.zeros(3))
    first = step(agent, state, 1.0, Mode.TRACK, initial_memory(agent)).memory
    assert first.estimate is adaptation.start  # no time has passed before the first tick
    once, twice = (step(agent, state, 1.0 + k * PERIOD, Mode.TRACK, first).memory.estimate for k in (1, 2))
    assert once is not None
    assert twice is not None
    change_once, change_twice = once.arm - adaptation.start.arm, twice.arm - adaptation.start.arm
    assert np.abs(change_once).max() > 0.0
    # the desired pose differs a little between the two instants
    assert np.linalg.norm(change_twice - 2.0 * change_once) < 0.02 * np.linalg.norm(change_twice)


def test_an_arm_that_waits_for_the_start_learns_what_it_holds() -> None:
    agent, q = agent_of()
    states = states_of(q, 2)
    memory = step(agent, states[0], -1.0, Mode.READY, initial_memory(agent)).memory
    learnt = step(agent, states[1], PERIOD - 1.0, Mode.READY, memory).memory.estimate
    assert np.abs(learnt.arm - memory.estimate.arm).max() > 0.0


@pytest.mark.parametrize("mode", [Mode.OFF, Mode.HOLD, Mode.LOWER, Mode.FAULT])
def test_nothing_is_learnt_while_the_arm_only_holds_or_is_off(mode: Mode) -> None:
    agent, q = agent_of()
    states = states_of(q, 3)
    memory = step(agent, states[0], 0.0, Mode.TRACK, initial_memory(agent)).memory
    after = step(agent, states[1], PERIOD, mode, memory).memory
    assert after.estimate is memory.estimate


def test_an_estimate_held_at_its_bound_is_reported() -> None:
    tight = ('controller.adaptive.start="nominal"', "controller.adaptive.bounds.relative_max=1.0")
    agent, q = agent_of(*tight, "controller.adaptive.bounds.slack_m=0.0")
    outcomes, _, _ = run(agent, states_of(q, 20), hold_from=99)
    assert any(o.flags & Flag.ADAPTATION_SATURATED for o in outcomes)
    upper = agent.offline.adaptation.upper.arm
    assert (outcomes[-1].memory.estimate.arm <= upper).all()
    wide, q = agent_of('controller.adaptive.start="nominal"', *SLOW)
    outcomes, _, _ = run(wide, states_of(q, 2), hold_from=99)
    assert not any(o.flags & Flag.ADAPTATION_SATURATED for o in outcomes)


def test_a_tick_without_numbers_leaves_the_estimate_as_it_was() -> None:
    agent, q = agent_of()
    states = states_of(q, 6)
    memory = step(agent, states[0], 0.0, Mode.TRACK, initial_memory(agent)).memory
    bad = step(agent, replace(states[1], dq=np.array([0.0, np.nan, 0.0])), PERIOD, Mode.TRACK, memory)
    assert bad.memory.estimate is memory.estimate
    good = step(agent, states[2], 2 * PERIOD, Mode.TRACK, bad.memory)
    assert np.isfinite(good.memory.estimate.arm).all()


def test_an_adaptive_agent_without_an_estimate_is_a_mistake_of_the_caller() -> None:
    agent, q = agent_of()
    with pytest.raises(TypeError, match="needs the estimate"):
        step(agent, states_of(q, 1)[0], 0.0, Mode.TRACK, initial(3))


def test_what_is_off_keeps_its_configured_value() -> None:
    agent, q = agent_of("controller.adaptive.viscous=true")
    outcomes, memories, _ = run(agent, states_of(q, 30), hold_from=99)
    start, end = memories[0].estimate.arm, outcomes[-1].memory.estimate.arm
    rotor, viscous, coulomb = slice(30, 33), slice(33, 36), slice(36, 39)
    cell = load_cell(ADAPTIVE)
    assert start[rotor] == pytest.approx(cell.arms[0].rotor_inertia)
    assert start[coulomb] == pytest.approx([s.coulomb_Nm.value for s in cell.arms[0].servos])
    assert not start[viscous].any()
    assert np.array_equal(end[rotor], start[rotor])
    assert np.array_equal(end[coulomb], start[coulomb])
    assert end[viscous].any()


@pytest.mark.parametrize(("changes", "expected"), [((), False), (("controller.adaptive.coulomb=true",), True)])
def test_without_feed_forward_and_columns_there_is_no_friction_term(changes: tuple[str, ...], expected: bool) -> None:
    agent, q = agent_of("controller.friction_feedforward=false", *changes)
    memory = initial_memory(agent)
    assert memory.estimate is not None
    rubbing = Estimate(np.full_like(memory.estimate.arm, 0.1), memory.estimate.object)
    outcome = step(agent, states_of(q, 1)[0], 0.0, Mode.TRACK, memory._replace(estimate=rubbing))
    assert outcome.terms is not None
    assert outcome.terms.tau_friction.any() == expected
