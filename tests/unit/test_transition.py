"""What a change of mode does to the memory of an arm that follows, of one in a session and of one that floats."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import configs
from agent import session
from agent.config.cell import load_cell
from agent.control.memory import Memory
from agent.loop import Agent, Outcome, initial_memory, step
from agent.modes import Mode
from agent.process.build import build_agent
from agent.standing import hold_after, wait_here
from agent.transition import entered
from drivers.interface import JointState

FOLLOWS = ("paper",)
IN_SESSION = ("two_wx200", "session.take_up_s=0.02", "session.lower_s=0.02")
FLOATS = ("three_wx250s", 'floating.arms=["left"]')


@cache
def last_of(name: str, *changes: str) -> tuple[Agent, Outcome]:
    """An arm that moves slowly, on its trajectory or before it, and the outcome of that tick."""
    cell = load_cell(configs.CELLS_DIR / f"{name}.toml", list(changes))
    agent = build_agent(cell, cell.arms[0])
    q = np.full(agent.model.n, 0.4)
    state = JointState(0, q, np.full(agent.model.n, 0.08), np.zeros(agent.model.n))
    memory = initial_memory(agent)._replace(age=3.0)
    if agent.session is None and agent.floating is None:
        return agent, step(agent, state, 1.0, Mode.TRACK, memory)
    return agent, step(agent, state, -1.0, Mode.READY, wait_here(agent, q, memory))


def same(a: Memory, b: Memory) -> bool:
    return all(np.array_equal(x, y) if isinstance(x, np.ndarray) else x == y for x, y in zip(a, b, strict=True))


def test_an_arm_that_follows_holds_where_it_was_wanted_and_forgets_it_when_it_tracks() -> None:
    agent, last = last_of(*FOLLOWS)
    held = entered(agent, Mode.HOLD, last.memory, last)
    assert held.hold is not None
    assert same(held, hold_after(agent, last))
    tracking = entered(agent, Mode.TRACK, held, last)
    assert (tracking.hold, tracking.q_hold) == (None, None)


@pytest.mark.parametrize("mode", [Mode.HOLD, Mode.OFF, Mode.FAULT, Mode.FLOAT])
def test_without_a_fresh_state_and_in_other_modes_it_remembers_what_it_did(mode: Mode) -> None:
    agent, last = last_of(*FOLLOWS)
    assert entered(agent, mode, last.memory, None) is last.memory
    if mode is not Mode.HOLD:
        assert entered(agent, mode, last.memory, last) is last.memory


@pytest.mark.parametrize("mode", [Mode.HOLD, Mode.LOWER, Mode.HALT, Mode.READY])
@pytest.mark.parametrize("seen", [True, False])
def test_an_arm_of_a_session_enters_a_mode_as_its_session_says(mode: Mode, seen: bool) -> None:
    agent, last = last_of(*IN_SESSION)
    found = entered(agent, mode, last.memory, last if seen else None)
    assert same(found, session.entered(agent, mode, last.memory, last if seen else None))
    assert found.age == 0.0


def test_an_arm_that_floats_stands_where_it_comes_to_rest_or_where_it_is_seen_next() -> None:
    agent, last = last_of(*FLOATS)
    assert agent.floating is not None
    standing = entered(agent, Mode.STAND, last.memory, last)
    assert standing.q_hold == pytest.approx(agent.floating.came_to_rest(last.q, last.dq))
    assert standing.age == 0.0
    followed = last.memory._replace(hold=None, q_hold=None)
    assert entered(agent, Mode.STAND, followed, last).q_hold == pytest.approx(standing.q_hold), "a motion before it"
    elsewhere = (9.0, 9.0, 9.0, 1.0, 0.0, 0.0, 0.0)
    assert entered(agent, Mode.STAND, last.memory._replace(hold=elsewhere), last).hold == elsewhere
    unseen = entered(agent, Mode.STAND, last.memory, None)
    assert (unseen.hold, unseen.q_hold) == (None, None)
    unseen = entered(agent, Mode.STAND, followed, None)
    assert (unseen.hold, unseen.q_hold) == (None, None)
    assert same(entered(agent, Mode.HOLD, last.memory, last), hold_after(agent, last)), "it does not float there"
