"""What the loop does with a session: whom it asks, what it tells, when the motion starts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import pytest

import configs
from agent.config.cell import Cell, load_cell
from agent.control.memory import Memory
from agent.loop import Agent
from agent.modes import Event, Mode
from agent.process.build import build_agent
from drivers.interface import ServoFault
from tests.support.runner_rig import HOLD_AFTER_STALE, Done, fault, lost, lost_at, run


@cache
def cell() -> Cell:
    return load_cell(configs.CELLS_DIR / "two_wx200.toml", ["session.take_up_s=0.02", "session.lower_s=0.02"])


@cache
def made() -> Agent:
    return build_agent(cell(), cell().arms[0])


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
    """The loop with this session, released in the read `last`; nothing is off the arm's path."""
    agent = made()
    assert agent.session is not None
    life = replace(agent.session.life, off_max_rad=math.inf)
    at_grasp = life.path.at(life.path.seconds).q
    script.happens = {last: Event.SERVO_LOST, **script.happens}
    kw = {"agent": {"session": replace(agent.session, life=life)}, "q": lambda _: at_grasp, "hold_at_end": True} | kw
    return run(cell=cell(), session=script, **kw)


TO_READY = {2: Event.APPROACH, 4: Event.GRASP, 6: Event.GRIPPED}


def test_a_session_goes_from_mode_to_mode_and_its_gripper_is_told_of_each() -> None:
    script = Script(TO_READY | {9: Event.RELEASED, 11: Event.PARK, 13: Event.ARRIVED})
    done = run_of(script, last=15, start_ns=lambda *_: None)
    on_the_way = [Mode.APPROACH, Mode.GRASP, Mode.READY, Mode.RELEASE, Mode.PARK, Mode.REST]
    assert done.modes == script.entered_modes == [*on_the_way, Mode.FAULT]
    assert done.rows["mode"][:3].tolist() == [Mode.REST, Mode.REST, Mode.APPROACH]
    assert (done.troubles, done.refused) == ([], [])


def test_a_start_counts_once_the_load_is_taken_up_and_not_one_that_was_given_before() -> None:
    given = lambda reads, zero: zero + (reads > 12) * 1000  # noqa: E731 - another one after read 12
    script = Script(TO_READY, taken_up_in=16)
    done = run_of(script, last=30, start_ns=given)
    assert len(script.voids) == 1, "asked once, when READY begins"
    ready = done.of(Mode.READY)
    assert ready["t"][0] == pytest.approx(-86_400.0, abs=1.0), "the trajectory is a day ahead again"
    assert Mode.TRACK in done.modes
    assert done.of(Mode.TRACK)["sequence"][0] == 17
    early = Script(TO_READY)
    assert Mode.TRACK not in run_of(early, last=30, start_ns=lambda _, zero: zero).modes, "it was given before READY"


def test_a_word_that_is_refused_is_told_and_no_reason_of_a_hold() -> None:
    done = run_of(Script({}, {3: "not now"}), last=6)
    assert done.refused == ["not now"]
    assert (done.modes, done.troubles, done.summary.reason) == ([Mode.FAULT], [], "")
    assert run_of(Script({}, {})).refused == []


@pytest.mark.parametrize("bad", [Event.STOP, Event.TROUBLE])
def test_what_a_session_stops_for_is_its_reason_and_told_with_the_way_back(bad: Event) -> None:
    done = run_of(Script({2: Event.APPROACH, 5: bad}, {5: "no object"}), last=8)
    assert done.modes[:2] == [Mode.APPROACH, Mode.HALT]
    assert done.refused == []
    assert done.summary.reason == "no object"
    assert done.troubles == (["no object; way back: `coop park`"] if bad is Event.TROUBLE else [])


def test_the_way_back_of_an_arm_that_is_not_seen_begins_once_it_answers() -> None:
    done = run_of(Script({2: Event.APPROACH}), last=20, failures=lost_at(*range(6, 11)))
    assert done.troubles == [f"{lost()}; way back once it answers again: `coop park`"]


def test_whether_the_arm_answers_is_told_to_its_session() -> None:
    script = Script({})
    run_of(script, last=14, failures=lost_at(*range(5, 10)))
    unseen = [k for k, seen in enumerate(script.seen, 1) if not seen]
    assert unseen == [5 + HOLD_AFTER_STALE, 9]


def test_what_is_wrong_with_an_arm_at_rest_is_told_once() -> None:
    done = run_of(Script({}), last=9, failures={3: fault(True), 4: fault(True), 6: fault(True)})
    assert done.modes == [Mode.FAULT]
    assert done.troubles == [f"{fault(True)}; way back: `coop release`"]


def other_fault() -> ServoFault:
    error = ServoFault("servo 3", found="overload", expected="none", remedy="look")
    error.state = fault(True).state
    return error


@pytest.mark.parametrize(("later", "ends"), [(fault, Mode.PARK), (other_fault, Mode.HALT)])
def test_a_fault_that_lasts_is_borne_on_the_way_back_and_another_one_stops_it(later: Any, ends: Mode) -> None:
    error = later(True) if later is fault else later()
    failures = dict.fromkeys(range(4, 8), fault(True)) | dict.fromkeys(range(8, 12), error)
    done = run_of(Script({2: Event.APPROACH, 6: Event.PARK}), last=13, failures=failures)
    assert done.modes[:3] == [Mode.APPROACH, Mode.HALT, Mode.PARK]
    assert done.rows["mode"][9] == ends
    assert [text.startswith("servo 3") for text in done.troubles] == ([False] if ends is Mode.PARK else [False, True])


def test_the_end_of_the_trajectory_stops_the_motion_and_not_the_way_down() -> None:
    done = run_of(Script(TO_READY | {45: Event.LOWER}), last=60, start_ns=lambda reads, zero: zero + (reads > 8))
    assert done.modes[:6] == [Mode.APPROACH, Mode.GRASP, Mode.READY, Mode.TRACK, Mode.HOLD, Mode.LOWER]
    assert len(done.of(Mode.TRACK)) == 20
    assert len(done.of(Mode.LOWER)) == 15, "though the end has passed in each of its cycles"


def test_an_arm_that_goes_on_has_no_reason_to_hold() -> None:
    script = Script({2: Event.APPROACH, 4: Event.TROUBLE, 6: Event.PARK, 8: Event.TROUBLE}, {4: "first", 8: "second"})
    done = run_of(script, last=10)
    assert done.troubles == ["first; way back: `coop park`", "second; way back: `coop park`"]
    assert done.modes == [Mode.APPROACH, Mode.HALT, Mode.PARK, Mode.HALT, Mode.FAULT]
