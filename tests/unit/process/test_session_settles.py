"""Whatever was said to an arm of a session, it comes to one mode and stays there until somebody says more.

Operator, session and table of modes together, as the loop has them, of agents and of guards in their places.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.modes import TABLE, Event, Mode
from agent.operator.session_table import MODES
from agent.operator.socket import Requests, Standing
from agent.operator.table import Verb
from agent.process.operated import Operator
from agent.session import SessionLoop, StartBound
from agent.session_modes import next_in_session
from tests.unit.test_session import AGENT, GRASP, PLAN, REST, Hand, memory

CYCLES = 60
CHANGES_MAX = 4  # after the last word: what a phase ends with by itself
WORDS = (Verb.STOP, Verb.RELEASE, Verb.APPROACH, Verb.GRASP, Verb.LOWER, Verb.PARK)
COMMANDING = [mode for mode in MODES if TABLE[mode].commands]
SIGNALS = ("SIGTERM", "SIGUSR1", "the host")
says = st.lists(st.sampled_from((*WORDS, *SIGNALS)), max_size=3)


class Arm:
    """One arm's decisions without its torque."""

    def __init__(self, mode: Mode, *, guard: bool, drops: bool, thick_m: float, arrived: bool) -> None:
        self.mode, self.changes = mode, list[Mode]()
        self._memory = memory(GRASP if mode is not Mode.REST else REST, age=1e3 if arrived else 0.0)
        self.session = SessionLoop(AGENT, Hand(thick_m), PLAN, StartBound(0.02, 0.1), leads_back_only=guard)
        self.session.resume(mode)
        self.signals: Any = SimpleNamespace(stopped=False, stops=0, released=False, why="")
        self.requests = Requests()
        standing = Standing("left", mode, session=self.session.not_yet)
        control: Any = SimpleNamespace(poll=lambda: None, requests=self.requests, standing=standing)
        clock: Any = SimpleNamespace(now_ns=lambda: 0, utc_offset_ns=0)
        self.operator = Operator(
            self.signals, control, clock, lambda *_, **__: None, drops_on_stop=drops, session=True, standing=standing
        )

    def say(self, what: Verb | str) -> None:
        if isinstance(what, Verb):
            self.requests.words.append(what)
        elif what == "SIGTERM":
            self.signals.stopped, self.signals.stops = True, self.signals.stops + 1
        elif what == "SIGUSR1":
            self.signals.released = True
        else:
            self.operator.hold("the clock may be off by 5.1 ms")

    def cycle(self, lasting: Event) -> None:
        events = self.session.judge(self.mode, self.operator.events() | lasting, self._memory)
        after = next_in_session(self.mode, events)
        if after is not self.mode:
            self.mode = after
            self.changes.append(after)
            self.session.entered(after)
            self.operator.mode(after)


@pytest.mark.parametrize("drops", [False, True])
@pytest.mark.parametrize("guard", [False, True])
@pytest.mark.parametrize("mode", COMMANDING)
@given(
    first=says, then=says, thick_m=st.sampled_from((0.0, PLAN.width_m)), arrived=st.booleans(),
    lasting=st.sampled_from((Event.NONE, Event.STOP, Event.TROUBLE, Event.STOP | Event.TROUBLE)),
)  # fmt: skip
def test_an_arm_of_a_session_comes_to_one_mode_whatever_it_was_told(
    *, mode: Mode, guard: bool, drops: bool, first: list[Verb | str], then: list[Verb | str], thick_m: float,
    arrived: bool, lasting: Event,
) -> None:  # fmt: skip
    """lasting: what is wrong, or asked for, in every cycle; words and signals are said in two cycles."""
    arm = Arm(mode, guard=guard, drops=drops, thick_m=thick_m, arrived=arrived)
    for said in (first, then):
        for what in said:
            arm.say(what)
        arm.cycle(lasting)
    arm.changes.clear()
    for _ in range(CYCLES):
        if not TABLE[arm.mode].commands:
            return
        arm.cycle(lasting)
    assert len(arm.changes) <= CHANGES_MAX, arm.changes
