"""What the loop does with a session: whom it asks, what it tells, when the motion starts; and with a guided arm."""

from __future__ import annotations

import numpy as np
import pytest

from agent.control.memory import Memory, restore
from agent.modes import Event, Mode
from agent.safety import Flag
from agent.telling import OBEYS_AGAIN
from tests.support.runner_rig import HOLD_AFTER_STALE, Done, lost, lost_at, run
from tests.support.session_script import TO_READY, Script, cell, faulty, floating, guided, pushed, run_of

STILL = {"observer": None}


def at_last_row(done: Done) -> Memory:
    """What the last row began with."""
    return restore(done.rows[-1]["memory"], 3, None)


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


def test_a_second_motion_begins_a_day_ahead_again() -> None:
    again = {14: Event.STOP, 16: Event.RELEASED, 18: Event.PARK, 20: Event.ARRIVED}
    again |= {22: Event.APPROACH, 24: Event.GRASP, 26: Event.GRIPPED}
    done = run_of(Script(TO_READY | again), last=29, start_ns=lambda reads, zero: zero + (reads > 8))
    assert [mode for mode in done.modes if mode in (Mode.READY, Mode.TRACK)] == [Mode.READY, Mode.TRACK, Mode.READY]
    assert done.rows["t"][-1] == pytest.approx(-86_400.0, abs=1.0)


def test_time_in_a_mode_counts_from_its_beginning() -> None:
    done = run_of(Script({5: Event.APPROACH}), last=8)
    assert at_last_row(done).age == pytest.approx(2 * cell().period_ns * 1e-9)


@pytest.mark.parametrize(("lost", "stands"), [((), 9), ((9,), 10)], ids=["seen", "unseen"])
def test_an_arm_that_is_stopped_holds_where_it_is_seen_then_or_next(lost: tuple[int, ...], stands: int) -> None:
    done = run_of(Script(TO_READY | {9: Event.STOP}), last=13, q=pushed, failures=lost_at(*lost), agent=STILL)
    assert done.modes[-2:] == [Mode.HOLD, Mode.FAULT]
    np.testing.assert_allclose(at_last_row(done).q_hold, pushed(stands), atol=1e-12)


def test_a_word_that_is_refused_is_told_and_no_reason_of_a_hold() -> None:
    done = run_of(Script({}, {3: "not now"}), last=6)
    assert done.refused == ["not now"]
    assert (done.modes, done.troubles, done.summary.reason) == ([Mode.FAULT], [], "")
    assert run_of(Script({}, {})).refused == []


@pytest.mark.parametrize("stop", [Event.STOP, Event.NONE])
def test_a_word_that_is_refused_while_something_else_stops_the_arm_is_told_and_not_the_reason(stop: Event) -> None:
    failures = {} if stop else dict.fromkeys(range(5, 8), faulty())
    script = Script({2: Event.APPROACH}, {5: "not now"})
    done = run_of(script, last=8, failures=failures, operator=lambda reads: stop if reads == 4 else Event.NONE)
    assert done.refused == ["not now"]
    assert done.modes[:2] == [Mode.APPROACH, Mode.HALT]
    assert done.troubles == ([] if stop else [f"{faulty()}; way back: `coop park`"])


@pytest.mark.parametrize("bad", [Event.STOP, Event.TROUBLE])
def test_what_a_session_stops_for_is_its_reason_and_told_with_the_way_back(bad: Event) -> None:
    done = run_of(Script({2: Event.APPROACH, 5: bad}, {5: "no object"}), last=8)
    assert done.modes[:2] == [Mode.APPROACH, Mode.HALT]
    assert done.refused == []
    assert done.summary.reason == "no object"
    assert done.troubles == (["no object; way back: `coop park`"] if bad is Event.TROUBLE else [])


def test_a_trouble_without_a_word_of_its_own_leaves_the_reason_of_the_first() -> None:
    done = run_of(Script({2: Event.APPROACH, 5: Event.TROUBLE, 7: Event.TROUBLE}, {5: "no object"}), last=9)
    assert done.summary.reason == "no object"


def test_the_way_back_of_an_arm_that_is_not_seen_begins_once_it_answers() -> None:
    done = run_of(Script({2: Event.APPROACH}), last=20, failures=lost_at(*range(6, 11)))
    assert done.troubles == [f"{lost()}; way back once it answers again: `coop park`"]


def test_whether_the_arm_answers_is_told_to_its_session() -> None:
    script = Script({})
    run_of(script, last=14, failures=lost_at(*range(5, 10)))
    unseen = [k for k, seen in enumerate(script.seen, 1) if not seen]
    assert unseen == [5 + HOLD_AFTER_STALE, 9]


def test_what_is_wrong_with_an_arm_at_rest_is_told_once() -> None:
    done = run_of(Script({}), last=9, failures={3: faulty(), 4: faulty(), 6: faulty()})
    assert done.modes == [Mode.FAULT]
    assert done.troubles == [f"{faulty()}; way back: `coop release`"]
    assert run_of(Script({4: Event.GRASP}), last=6, refused=frozenset({3})).troubles == [], "a word is no trouble"
    assert run_of(Script({4: Event.STOP}, {4: "not now"}), last=6).troubles == [], "nor is a stop"


def test_an_arm_at_rest_whose_servos_had_stopped_obeys_again_where_it_is_and_says_so() -> None:
    other = faulty("servo 3")
    lapses = {"lapses": frozenset({4})}
    done = run_of(Script({}), last=12, failures={3: faulty(), 8: other, 9: other}, returning=lapses)
    assert done.rows["mode"].tolist() == [Mode.REST] * len(done.rows)
    assert np.flatnonzero(done.rows["flags"] & Flag.RESUMED).tolist() == [4]
    back = " way back: `coop release`"
    assert done.troubles == [f"{faulty()};{back}", f"{OBEYS_AGAIN};{back}", f"{other};{back}"]


@pytest.mark.parametrize(("later", "ends"), [("servo 2", Mode.PARK), ("servo 3", Mode.HALT)])
def test_a_fault_that_lasts_is_borne_on_the_way_back_and_another_one_stops_it(later: str, ends: Mode) -> None:
    failures = dict.fromkeys(range(4, 8), faulty()) | dict.fromkeys(range(8, 12), faulty(later))
    done = run_of(Script({2: Event.APPROACH, 6: Event.PARK}), last=13, failures=failures)
    assert done.modes[:3] == [Mode.APPROACH, Mode.HALT, Mode.PARK]
    assert done.rows["mode"][9] == ends
    assert [text.startswith("servo 3") for text in done.troubles] == ([False] if ends is Mode.PARK else [False, True])


def test_a_fault_that_lasts_stops_an_arm_that_goes_on_and_not_back() -> None:
    failures = dict.fromkeys(range(4, 12), faulty())
    done = run_of(Script({2: Event.APPROACH, 6: Event.APPROACH}), last=10, failures=failures)
    assert done.modes == [Mode.APPROACH, Mode.HALT, Mode.APPROACH, Mode.HALT, Mode.FAULT]


def test_what_the_bus_did_not_take_before_a_stop_is_forgotten_on_the_way_back() -> None:
    words = {2: Event.APPROACH, 6: Event.STOP, 8: Event.PARK}
    assert "bytes taken" in run_of(Script(words), last=7, refused=frozenset({4})).summary.reason
    assert run_of(Script(words), last=10, refused=frozenset({4})).summary.reason == ""


def test_a_session_that_nobody_listens_to_goes_on() -> None:
    done = run_of(Script({2: Event.APPROACH, 5: Event.TROUBLE}, {3: "not now", 5: "no object"}), last=8, told=False)
    assert (done.modes[:2], done.summary.reason) == ([Mode.APPROACH, Mode.HALT], "no object")
    assert run_of(Script({}), last=6, failures={3: faulty()}, told=False).modes == [Mode.FAULT]


def test_a_first_fault_on_the_way_back_stops_it() -> None:
    script = Script({2: Event.APPROACH, 4: Event.STOP, 6: Event.PARK})
    done = run_of(script, last=12, failures={9: faulty()})
    assert done.modes == [Mode.APPROACH, Mode.HALT, Mode.PARK, Mode.HALT, Mode.FAULT]
    assert done.troubles == [f"{faulty()}; way back: `coop park`"]


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


# --- an arm that a hand guides ---------------------------------------------------------------------------------------


def test_a_guided_arm_that_is_stopped_stands_where_it_was_then() -> None:
    np.testing.assert_allclose(guided({}).memory.q_hold, pushed(6), atol=1e-12)


def test_a_guided_arm_that_is_stopped_while_it_is_not_seen_stands_where_it_is_seen_next() -> None:
    np.testing.assert_allclose(guided(lost_at(6)).memory.q_hold, pushed(7), atol=1e-12)


def test_what_stops_a_guided_arm_is_told() -> None:
    lost_at_last = lambda n: Event.SERVO_LOST if n == 8 else Event.NONE  # noqa: E731
    done = run(lost_at_last, {5: faulty()}, cell=floating(), q=pushed, happened=Event.FLOATED)
    assert (done.modes, done.troubles) == ([Mode.STAND, Mode.FAULT], [str(faulty())])


def test_an_arm_that_works_while_others_float_stands_where_another_one_holds() -> None:
    events = {14: Event.STOP, 20: Event.RELEASED, 22: Event.ARRIVED}
    done = run(
        lambda n: events.get(n, Event.NONE),
        cell=floating(),
        agent=STILL,
        q=pushed,
        hold_at_end=True,
    )
    assert done.modes == [Mode.TRACK, Mode.STAND, Mode.SINK, Mode.OFF]
    np.testing.assert_allclose(done.memory.q_hold, pushed(15), atol=1e-12)
