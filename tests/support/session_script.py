"""The control loop of one arm with a session whose events are written down; on the clock of `runner_rig`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

import configs
from agent.config.cell import Cell, load_cell
from agent.control.memory import Memory
from agent.loop import Agent
from agent.modes import Event, Mode
from agent.process.build import build_agent
from drivers.interface import JointState, ServoFault, Vector
from tests.support.runner_rig import Done, run

TO_READY = {2: Event.APPROACH, 4: Event.GRASP, 6: Event.GRIPPED}


@cache
def cell() -> Cell:
    """Of three joints, with short phases."""
    return load_cell(configs.CELLS_DIR / "two_wx200.toml", ["session.take_up_s=0.02", "session.lower_s=0.02"])


@cache
def made() -> Agent:
    """Of its first arm."""
    return build_agent(cell(), cell().arms[0])


def q_grasp() -> Vector:
    """Where its first arm holds the object."""
    session = made().session
    assert session is not None
    return session.life.path.at(session.life.path.seconds).q


def faulty(servo: str = "servo 2") -> ServoFault:
    """A servo that does not do its part, with a state of the arm at its grasp."""
    error = ServoFault(servo, found="torque off", expected="on", remedy="look")
    error.state = JointState(0, q_grasp(), np.zeros(3), np.full(3, np.nan))
    return error


@dataclass
class Script:
    """Stands in for a session: what happens and why, by cycle from 1 on, whatever the gripper."""

    happens: Mapping[int, Event]
    why: Mapping[int, str] = field(default_factory=dict)
    taken_up_in: int = 0
    reason: str = ""
    cycle: int = 0
    entered_modes: list[Mode] = field(default_factory=list)
    seen: list[bool] = field(default_factory=list)
    voids: list[int | None] = field(default_factory=list)

    def judge(self, _mode: Mode, events: Event, _memory: Memory, *, seen: bool) -> Event:
        self.cycle += 1
        self.seen.append(seen)
        self.reason = self.why.get(self.cycle, "")
        return events | self.happens.get(self.cycle, Event.NONE)

    def entered(self, mode: Mode) -> None:
        self.entered_modes.append(mode)

    def await_start(self, given_ns: int | None) -> None:
        self.voids.append(given_ns)

    def counts(self, zero_ns: int | None, _deadline_ns: int) -> bool:
        return zero_ns is not None and zero_ns not in self.voids

    def taken_up(self, _mode: Mode, _memory: Memory) -> bool:
        return self.cycle >= self.taken_up_in


def run_of(script: Script, last: int = 40, **kw: Any) -> Done:
    """The loop with this session on an arm that stands at its grasp, lost in the cycle `last`."""
    script.happens = {last: Event.SERVO_LOST, **script.happens}
    return run(cell=cell(), session=script, **({"q": lambda _: q_grasp(), "hold_at_end": True} | kw))


@cache
def floating() -> Cell:
    """A cell of which one arm is guided by hand."""
    return load_cell(configs.CELLS_DIR / "two_wx200.toml", ['floating.arms=["left"]'])


def guided(lost: Mapping[int, Exception], *, observer: bool = False) -> Done:
    """An arm stopped in the cycle of read 6, sinking from the one of read 10; a hand moves it a little at each read."""
    words = {5: Event.STOP, 9: Event.RELEASED, 12: Event.ARRIVED}
    done = run(
        lambda n: words.get(n, Event.NONE),
        lost,
        cell=floating(),
        agent={} if observer else {"observer": None},
        q=pushed,
        happened=Event.FLOATED,
        hold_at_end=True,
        start_ns=lambda *_: None,
    )
    assert done.modes == [Mode.STAND, Mode.SINK, Mode.OFF]
    return done


def pushed(read: int) -> Vector:
    """Where a hand has moved the guided arm by this read."""
    return q_grasp() + 1e-3 * read
