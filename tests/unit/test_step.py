"""One tick when something is wrong with its inputs: the torque stays, and nothing bad lives on in the memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.control.friction import Friction, JointFriction
from agent.control.models import ArmModel, Kinematics
from agent.loop import Agent, Outcome, initial_memory, step
from agent.modes import Mode
from agent.process.build import build_agent
from agent.safety import Flag, Limits
from agent.standing import hold_here
from drivers.interface import JointState

PERIOD = 0.005
VARIANTS = [
    [],
    ['controller.velocity="observer"'],
]


def agent_of(overrides: Sequence[str]) -> tuple[Agent, np.ndarray]:
    cell = load_cell(configs.CELLS_DIR / "paper.toml", overrides)
    return build_agent(cell, cell.arms[0]), np.array(cell.arms[0].entry.q_near_rad)


def ticks(agent: Agent, states: Sequence[JointState], mode: Mode = Mode.TRACK) -> list[Outcome]:
    memory, outcomes = initial_memory(agent), []
    for k, state in enumerate(states):
        outcomes.append(step(agent, state, PERIOD * k, mode, memory))
        memory = outcomes[-1].memory
    return outcomes


@pytest.mark.parametrize("bounds", [((1.0,) * 2, (1.0,) * 3), ((1.0,) * 3, (1.0,) * 4)])
def test_an_arm_with_a_wrong_number_of_bounds_is_refused_before_its_first_tick(
    bounds: tuple[tuple[float, ...], tuple[float, ...]],
) -> None:
    agent, _ = agent_of([])
    with pytest.raises(ValueError, match="3 joints, but"):
        replace(agent, limits=Limits(*bounds))


def still(q: np.ndarray, count: int) -> list[JointState]:
    return [JointState(k, q, np.zeros(3), np.zeros(3)) for k in range(count)]


@pytest.mark.parametrize("field", ["q", "dq"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("overrides", VARIANTS)
def test_one_tick_without_numbers_keeps_the_torque_and_is_forgotten(
    overrides: list[str], value: float, field: str
) -> None:
    agent, q = agent_of(overrides)
    states = still(q, 8)
    states[4] = replace(states[4], **{field: np.array([0.1, value, 0.2])})
    outcomes = ticks(agent, states)
    bad = outcomes[4]
    assert bad.flags is Flag.NOT_FINITE
    assert bad.terms is None
    assert np.array_equal(bad.tau, outcomes[3].tau)
    assert np.isfinite(bad.memory.flatten()).all()
    for after in outcomes[5:]:
        assert not after.flags & (Flag.NOT_FINITE | Flag.SINGULAR)
        assert np.isfinite(after.terms.tau_cmd).all()


@pytest.mark.parametrize("overrides", VARIANTS)
def test_hold_waits_for_a_pose_that_is_a_number(overrides: list[str]) -> None:
    agent, q = agent_of(overrides)
    memory = ticks(agent, still(q, 3))[-1].memory
    unknown = hold_here(agent, np.array([np.nan, 0.0, 0.0]), memory)
    assert unknown.hold is None
    known = hold_here(agent, q, unknown)
    assert known.hold is not None
    assert np.allclose(known.hold[:3], agent.model.object_pose(q).translation, atol=1e-12)


def test_holding_asks_for_no_motion() -> None:
    """At rest on the held pose only gravity and friction at rest are left: no feedback, no inertia."""
    agent, q = agent_of([])
    memory = hold_here(agent, q, initial_memory(agent))
    outcome = step(agent, still(q, 1)[0], 3.0, Mode.HOLD, memory)
    assert outcome.terms is not None
    assert np.abs(outcome.terms.tau_feedback).max() < 1e-12
    assert np.abs(outcome.terms.tau_inertia).max() < 1e-10
    assert np.array_equal(outcome.terms.desired.v, np.zeros(6))


def test_a_law_without_numbers_keeps_the_torque_and_is_forgotten() -> None:
    """Finite joints and no finite torque, here by a friction coefficient that is none."""
    agent, q = agent_of(['controller.velocity="observer"'])
    good = ticks(agent, still(q, 3))[-1]
    no_number = Friction((JointFriction(np.nan, 0.0),) * 3, 1.0)
    broken = replace(agent, offline=replace(agent.offline, friction=no_number))
    outcome = step(broken, still(q, 1)[0], 0.015, Mode.TRACK, good.memory)
    assert Flag.NOT_FINITE in outcome.flags
    assert np.array_equal(outcome.tau, good.tau)
    assert np.isfinite(outcome.memory.flatten()).all()
    assert not outcome.memory.primed


def test_a_jacobian_without_inverse_gives_no_terms_and_keeps_the_torque() -> None:
    agent, q = agent_of([])
    good = ticks(agent, still(q, 2))[-1]
    flat = replace(agent, model=FlatArm(agent.model))
    outcome = step(flat, still(q, 1)[0], 0.01, Mode.TRACK, good.memory)
    assert outcome.terms is None
    assert outcome.flags is Flag.SINGULAR
    assert np.array_equal(outcome.tau, good.tau)
    assert not outcome.memory.primed


class FlatArm:
    """An arm whose object Jacobian has no inverse."""

    def __init__(self, model: ArmModel) -> None:
        self.model = model
        self.n = model.n
        self.task_basis = model.task_basis

    def evaluate(self, q: np.ndarray, dq: np.ndarray) -> Kinematics:
        return self.model.evaluate(q, dq)._replace(J=np.zeros((3, 3)))


def test_a_nearly_singular_arm_is_flagged() -> None:
    agent, _ = agent_of([])
    bends = [np.array([0.3, bend, 0.1]) for bend in np.linspace(-1.5, 1.5, 301)]
    near = min(bends, key=lambda q: np.linalg.svd(agent.model.jacobian(q), compute_uv=False)[-1])
    outcome = step(agent, still(near, 1)[0], 0.0, Mode.TRACK, initial_memory(agent))
    assert Flag.SINGULAR in outcome.flags
