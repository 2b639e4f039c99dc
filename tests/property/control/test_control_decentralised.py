"""An agent's torque is a function of its own joints, the time and its offline data, bit for bit (identity 9)."""

from __future__ import annotations

import copy
import pickle
import tomllib
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

import configs
from agent.config.cell import cell_from_toml
from agent.control.memory import Memory
from agent.control.residual import nothing_sensed
from agent.loop import Agent, Outcome, step
from agent.modes import Mode
from agent.process.build import build_agent
from drivers.interface import JointState
from tests.support.control.strategies import examples

SEEDS = st.integers(0, 2**32 - 1)
STILL = (0.0,) * 6


def document() -> dict[str, Any]:
    return tomllib.loads((configs.CELLS_DIR / "paper.toml").read_text())


def agent_of(content: dict[str, Any], name: str) -> Agent:
    cell = cell_from_toml(tomli_w.dumps(content).encode(), "test")
    return build_agent(cell, cell.arm(name))


def random_tick(seed: int) -> tuple[JointState, float, Memory]:
    rng = np.random.default_rng(seed)
    state = JointState(1, rng.uniform(-1.0, 1.0, 3), rng.normal(size=3), np.zeros(3))
    memory = Memory(*rng.normal(size=(6, 3)), primed=True, sense=nothing_sensed(3))
    return state, float(rng.uniform(0.0, 100.0)), memory


def bits(value: Any) -> bytes:
    """Every number of an outcome, in order."""
    if is_dataclass(value):
        return b"".join(bits(getattr(value, f.name)) for f in fields(value))
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if isinstance(value, tuple):
        return b"".join(bits(v) for v in value)
    return pickle.dumps(value)


def other_name(content: dict[str, Any]) -> None:
    content["arms"][1]["name"] = "somebody"


def other_base(content: dict[str, Any]) -> None:
    content["arms"][1]["p_world_base_m"] = [3.0, 2.0, 1.0]


def other_grasp(content: dict[str, Any]) -> None:
    content["arms"][1]["p_object_ee_m"] = [0.05, 0.01, 0.0]


def other_kind(content: dict[str, Any]) -> None:
    content["arms"][1]["model"] = "wx200"


def other_angles(content: dict[str, Any]) -> None:
    content["arms"][1]["q_near_rad"] = [0.1, 0.2, 0.3]


def other_gain(content: dict[str, Any]) -> None:
    content["arms"][1]["k_v_N_s_per_m"] = 7.0


def another_arm(content: dict[str, Any]) -> None:
    """A third arm shares the right arm's part of the load."""
    content["arms"].append({**copy.deepcopy(content["arms"][1]), "name": "third"})
    content["arms"][1]["load_share"] = content["arms"][2]["load_share"] = 0.25


CHANGES = [other_name, other_base, other_grasp, other_kind, other_angles, other_gain, another_arm]


@pytest.mark.parametrize("change", CHANGES, ids=lambda c: c.__name__)
def test_nothing_about_the_other_arms_reaches_the_torque(change: Callable[[dict[str, Any]], None]) -> None:
    content = document()
    before = agent_of(content, "left")
    change(content)
    after = agent_of(content, "left")
    for seed in range(20):
        state, t, memory = random_tick(seed)
        assert bits(step(before, state, t, Mode.TRACK, memory)) == bits(step(after, state, t, Mode.TRACK, memory))


def test_what_is_offline_data_does_reach_the_torque() -> None:
    """The counter-proof: the comparison above would see a change."""
    content = document()
    before = agent_of(content, "left")
    content["object"]["mass_kg"] *= 1.001
    state, t, memory = random_tick(0)
    after = agent_of(content, "left")
    assert bits(step(before, state, t, Mode.TRACK, memory)) != bits(step(after, state, t, Mode.TRACK, memory))


@given(SEEDS, st.sampled_from([Mode.TRACK, Mode.HOLD]))
@examples(60)
def test_step_has_no_memory_but_the_one_it_is_given(seed: int, mode: Mode) -> None:
    """Two calls give the same bits, whatever the same agent and another one computed in between."""
    agent, other = agent_of(document(), "left"), agent_of(document(), "right")
    state, t, memory = random_tick(seed)
    first = bits(step(agent, state, t, mode, memory))
    for between in range(3):
        strange_state, strange_t, strange_memory = random_tick(seed + 1 + between)
        step(agent, strange_state, strange_t, mode, strange_memory)
        step(other, strange_state, strange_t, mode, strange_memory)
    assert bits(step(agent, state, t, mode, memory)) == first


@given(SEEDS)
@examples(30)
def test_step_leaves_its_inputs_as_they_are(seed: int) -> None:
    agent = agent_of(document(), "right")
    state, t, memory = random_tick(seed)
    before = bits(state), bits(memory)
    outcome = step(agent, state, t, Mode.TRACK, memory)
    assert (bits(state), bits(memory)) == before
    assert not shares_memory(outcome, agent)


def shares_memory(outcome: Outcome, agent: Agent) -> bool:
    """Whether a result is a view of the model's scratch memory, which the next tick overwrites."""
    data = agent.model.data
    room = agent.model.scratch
    scratch = (data.M, data.C, data.g, data.J, data.dJ, *room.two(STILL, STILL), room.three(STILL, STILL, STILL))
    k, kept = outcome.terms.kinematics, outcome.terms.joints
    return any(np.shares_memory(a, b) for a in (k.J, k.dJ, k.B, k.C, k.g, kept, outcome.tau) for b in scratch)
