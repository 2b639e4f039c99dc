"""What an arm does beside its torque in a session: words in and out of order, gripper told and believed, reasons."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

import configs
from agent.config.agent import build_agent
from agent.config.cell import load_cell
from agent.control.memory import Memory, initial
from agent.grip import GripPlan
from agent.modes import Event, Mode
from agent.session import SessionLoop, StartBound, entered
from drivers.interface import GripState

CELL = load_cell(configs.CELLS_DIR / "two_wx200.toml", ["session.lift_m=0.02", "session.take_up_s=1.0"])
AGENT = build_agent(CELL, CELL.arms[0])
PLAN = GripPlan(0.03, 0.074, 0.044, 0.25)
assert AGENT.session is not None
LIFE = AGENT.session.life
REST, GRASP = LIFE.path.at(0.0).q, LIFE.path.at(LIFE.path.seconds).q
LONG = 1e3


@dataclass
class Hand:
    """A gripper that goes where it is told at once, and holds what is `thick` between its fingers."""

    thick_m: float = 0.044
    width_m: float = 0.06
    ms: int = 0
    told: list[float] = field(default_factory=list)

    def grip(self, width_m: float) -> None:
        self.told.append(width_m)

    def grip_state(self) -> GripState:
        self.ms += 5
        goal = self.told[-1] if self.told else self.width_m
        self.width_m = max(goal, self.thick_m) if goal < self.width_m else goal
        return GripState(self.ms * 1_000_000, self.width_m, 0.0, 0.25 if self.width_m > goal else 0.0, 10.0)


def memory(q_hold: object = REST, age: float = LONG, shift_m: float = 0.0) -> Memory:
    started = initial(3)._replace(q_hold=np.array(q_hold), hold=(0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0), age=age)
    return started._replace(shift=(shift_m, 0.0, 0.0, 0.0, 0.0, 0.0))


def session(hand: Hand) -> SessionLoop:
    return SessionLoop(AGENT, hand, PLAN, StartBound(0.02, 0.1))


def heard(loop: SessionLoop, mode: Mode, event: Event = Event.NONE, cycles: int = 1, **kw: object) -> Event:
    """What counts in the last of some cycles, or in the first in which anything does."""
    for _ in range(cycles):
        found = loop.judge(mode, event, memory(**kw))  # type: ignore[arg-type]
        if found:
            return found
    return Event.NONE


@pytest.mark.parametrize(
    ("mode", "word", "says"),
    [
        (Mode.REST, Event.GRASP, "found REST, expected APPROACH; from here: release or approach"),
        (Mode.REST, Event.LOWER, "expected HOLD"),
        (Mode.TRACK, Event.PARK, "expected APPROACH or RELEASE or HALT; wait"),
        (Mode.GRASP, Event.RELEASED, "release in GRASP"),
    ],
)
def test_a_word_out_of_order_counts_for_nothing_and_says_where_it_would(mode: Mode, word: Event, says: str) -> None:
    loop = session(Hand())
    assert loop.judge(mode, word, memory()) & word == Event.NONE
    assert says in loop.reason


@pytest.mark.parametrize(
    ("mode", "word", "says"),
    [
        (Mode.APPROACH, Event.GRASP, "the arm is still on its way"),
        (Mode.LOWER, Event.RELEASED, "the object is still on its way down"),
        (Mode.READY, Event.RELEASED, "the load is being taken up"),
        (Mode.RELEASE, Event.PARK, "the gripper is not open yet"),
    ],
)
def test_a_word_before_the_phase_is_done_is_refused_and_taken_behind_it(mode: Mode, word: Event, says: str) -> None:
    loop = session(Hand())
    loop.entered(mode)
    assert heard(loop, mode, word, age=0.1) == Event.NONE
    assert says in loop.reason
    if mode in (Mode.APPROACH, Mode.RELEASE):
        heard(loop, mode, cycles=300)  # the gripper opens meanwhile
    assert word in loop.judge(mode, word, memory())


def test_a_start_is_given_once_the_load_is_taken_up_and_from_near_enough() -> None:
    loop = session(Hand())
    assert not loop.taken_up(Mode.READY, memory(age=0.9))
    assert loop.taken_up(Mode.READY, memory(age=1.0))
    assert loop.judge(Mode.READY, Event.STARTED, memory(shift_m=0.019)) == Event.STARTED
    assert loop.judge(Mode.READY, Event.STARTED, memory(shift_m=0.021)) == Event.STOP
    assert "start: found the object 21.0 mm and 0 mrad from its place, expected at most 20 mm" in loop.reason


def test_no_journey_begins_away_from_the_path() -> None:
    loop = session(Hand())
    loop.entered(Mode.HALT)
    away = REST + np.array([0.0, 0.3, 0.0])
    assert heard(loop, Mode.HALT, Event.PARK, q_hold=away) == Event.NONE
    assert "a joint is 0.30 rad from the arm's path, expected at most 0.25; release the arm" in loop.reason
    assert heard(loop, Mode.HALT, Event.PARK, q_hold=GRASP) == Event.PARK


def test_the_gripper_opens_on_the_way_and_closes_at_the_grasp() -> None:
    hand = Hand()
    loop = session(hand)
    for mode, goal in ((Mode.APPROACH, PLAN.open_m), (Mode.GRASP, PLAN.closed_m), (Mode.PARK, PLAN.open_m)):
        loop.entered(mode)
        assert hand.told[-1] == goal


@pytest.mark.parametrize(
    ("thick_m", "event", "says"),
    [
        (0.044, Event.GRIPPED, ""),
        (0.030, Event.NOT_GRIPPED, "closed on nothing: found 30.0 mm, expected 44.0 mm"),
        (0.055, Event.NOT_GRIPPED, "wider than the object: found 55.0 mm, expected 44.0 mm; it is open again: put"),
        (
            0.074,
            Event.NOT_GRIPPED,
            "does not move: found 74.0 mm, expected 44.0 mm; free its fingers, then `coop grasp`",
        ),
    ],
)
@pytest.mark.fault("F9")
def test_what_the_fingers_close_on_decides(thick_m: float, event: Event, says: str) -> None:
    loop = session(Hand(thick_m, width_m=0.074))
    loop.entered(Mode.GRASP)
    assert heard(loop, Mode.GRASP, cycles=300) == event
    assert says in loop.reason


def test_a_gripper_that_does_not_open_stops_the_arm_on_its_way() -> None:
    hand = Hand()
    loop = session(hand)
    loop.entered(Mode.APPROACH)
    hand.told[-1] = 0.06
    assert heard(loop, Mode.APPROACH, cycles=300) == Event.TROUBLE
    assert "does not move: found 60.0 mm, expected 74.0 mm; free it" in loop.reason


@pytest.mark.parametrize("mode", [Mode.READY, Mode.TRACK, Mode.HOLD, Mode.LOWER])
@pytest.mark.fault("F9")
def test_a_lost_object_is_trouble_once_in_every_mode_that_holds_it(mode: Mode) -> None:
    hand = Hand(width_m=0.044)
    loop = session(hand)
    loop.entered(Mode.READY)
    assert heard(loop, mode, cycles=3) == Event.NONE
    hand.width_m, hand.thick_m = 0.0405, 0.0405
    assert heard(loop, mode) == Event.TROUBLE
    assert "the gripper lost the object: 40.5 mm" in loop.reason
    assert heard(loop, mode, cycles=3) == Event.NONE


def test_an_arm_gives_its_load_back_before_its_gripper_opens() -> None:
    hand = Hand(width_m=0.044)
    loop = session(hand)
    loop.entered(Mode.READY)
    loop.entered(Mode.RELEASE)
    heard(loop, Mode.RELEASE, cycles=5, age=0.5)
    assert hand.told == []
    heard(loop, Mode.RELEASE, cycles=1, age=1.0)
    assert hand.told == [PLAN.open_m]


@pytest.mark.parametrize("bad", [Event.STOP, Event.TROUBLE])
def test_a_stop_in_release_holds_until_the_gripper_has_been_told_to_open(bad: Event) -> None:
    hand = Hand(width_m=0.044)
    loop = session(hand)
    loop.entered(Mode.READY)
    loop.entered(Mode.RELEASE)
    assert loop.judge(Mode.RELEASE, bad, memory(age=0.5)) == bad | Event.GRIPPED
    assert loop.judge(Mode.RELEASE, Event.NONE, memory(age=1.0)) == Event.NONE
    assert hand.told == [PLAN.open_m]
    assert loop.judge(Mode.RELEASE, bad, memory(age=1.1)) == bad


def test_a_stop_while_the_gripper_closes_opens_it_and_nobody_parks_before_it_is_open() -> None:
    hand = Hand(width_m=0.044)
    loop = session(hand)
    loop.entered(Mode.GRASP)
    loop.entered(Mode.HALT)
    assert hand.told == [PLAN.closed_m, PLAN.open_m]
    hand.told[-1] = 0.05  # on its way
    assert heard(loop, Mode.HALT, Event.PARK, q_hold=GRASP) == Event.NONE
    assert loop.reason == "park: the gripper is not open yet; wait for it"
    hand.told[-1] = PLAN.open_m
    assert heard(loop, Mode.HALT, Event.PARK, q_hold=GRASP) == Event.PARK


def test_a_gripper_that_cannot_open_keeps_no_arm_from_its_rest() -> None:
    hand = Hand(width_m=0.05)
    loop = session(hand)
    loop.entered(Mode.HALT)
    hand.told[-1] = 0.05
    assert heard(loop, Mode.HALT, cycles=200) == Event.NONE
    assert heard(loop, Mode.HALT, Event.PARK, q_hold=GRASP) == Event.PARK


@pytest.mark.parametrize(
    ("mode", "told"),
    [(Mode.HOLD, [PLAN.closed_m]), (Mode.HALT, [PLAN.open_m]), (Mode.REST, [])],
)
def test_who_goes_on_behind_another_keeps_the_grip_of_what_is_held(mode: Mode, told: list[float]) -> None:
    hand = Hand(width_m=0.044)
    loop = session(hand)
    loop.resume(mode)
    assert hand.told == told
    hand.width_m = hand.thick_m = 0.0405  # it slips out
    assert (heard(loop, mode) is Event.TROUBLE) == (mode is Mode.HOLD)


def test_an_arm_that_comes_back_has_arrived() -> None:
    loop = session(Hand())
    assert heard(loop, Mode.PARK, q_hold=GRASP, age=1.0) == Event.NONE
    assert heard(loop, Mode.PARK, q_hold=GRASP) == Event.ARRIVED


@pytest.mark.parametrize("mode", [Mode.HOLD, Mode.RELEASE, Mode.HALT, Mode.READY, Mode.TRACK])
def test_an_arm_that_is_not_seen_stands_where_it_is_seen_next_and_not_where_a_phase_of_before_began(mode: Mode) -> None:
    before = memory(q_hold=GRASP, age=2.0)
    after = entered(AGENT, mode, before, None)
    assert (after.hold, after.q_hold, after.age) == (None, None, 0.0)


def test_the_way_down_begins_at_the_pose_that_was_held() -> None:
    before = memory(q_hold=GRASP, age=2.0)
    after = entered(AGENT, Mode.LOWER, before, None)
    assert (after.hold, after.age) == (before.hold, 0.0)


def test_a_word_to_an_arm_that_does_not_answer_is_refused() -> None:
    loop = session(Hand())
    assert loop.judge(Mode.HOLD, Event.LOWER, memory(), seen=False) == Event.NONE
    assert loop.reason == "lower: the arm does not answer; check its cable and its supply"
    assert loop.not_yet(Event.LOWER) == loop.reason
    assert loop.judge(Mode.HOLD, Event.LOWER, memory()) == Event.LOWER


def test_a_guard_leads_back_and_begins_nothing() -> None:
    loop = SessionLoop(AGENT, Hand(), PLAN, StartBound(0.02, 0.1), leads_back_only=True)
    for mode, word in ((Mode.REST, Event.APPROACH), (Mode.HALT, Event.APPROACH), (Mode.APPROACH, Event.GRASP)):
        assert loop.judge(mode, word, memory()) & word == Event.NONE
        assert "the guard holds the arm in its agent's place and leads it back alone" in loop.reason
    assert loop.judge(Mode.HOLD, Event.LOWER, memory()) == Event.LOWER
    assert loop.judge(Mode.REST, Event.RELEASED, memory()) == Event.RELEASED


def test_a_start_counts_once_and_only_for_the_ready_it_was_given_in() -> None:
    loop = session(Hand())
    loop.await_start(100)
    assert not loop.counts(100, 50)
    assert loop.counts(200, 50)
    assert not loop.counts(40, 50)
    assert loop.reason == "start: its instant passed before this arm was ready; start all arms again"
    assert not loop.counts(None, 50)
