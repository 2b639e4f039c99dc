"""Modes of a session from rest to rest, over every mode and every combination of events."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from agent.modes import FLOATING, TABLE, Event, Mode, next_mode
from agent.session import WORDS
from agent.session_modes import next_in_session

SESSION = [mode for mode in Mode if mode not in {Mode.OFF, Mode.FAULT, *FLOATING}]
ALL_EVENTS = [Event(bits) for bits in range(2 * Event.ARRIVED)]
GRIPPED = {Mode.READY, Mode.TRACK, Mode.HOLD, Mode.LOWER}
WORDS_SAID = Event.APPROACH | Event.GRASP | Event.LOWER | Event.PARK | Event.RELEASED
FREE = {Mode.REST, Mode.APPROACH, Mode.GRASP, Mode.PARK, Mode.HALT}

# the way of a whole session, word by word and finding by finding
WAY = [
    (Mode.REST, Event.APPROACH, Mode.APPROACH),
    (Mode.APPROACH, Event.GRASP, Mode.GRASP),
    (Mode.GRASP, Event.GRIPPED, Mode.READY),
    (Mode.READY, Event.STARTED, Mode.TRACK),
    (Mode.TRACK, Event.STOP, Mode.HOLD),
    (Mode.HOLD, Event.LOWER, Mode.LOWER),
    (Mode.LOWER, Event.RELEASED, Mode.RELEASE),
    (Mode.RELEASE, Event.PARK, Mode.PARK),
    (Mode.PARK, Event.ARRIVED, Mode.REST),
    (Mode.REST, Event.RELEASED, Mode.OFF),
]
BESIDE = [
    (Mode.GRASP, Event.NOT_GRIPPED, Mode.APPROACH),
    (Mode.READY, Event.RELEASED, Mode.RELEASE),
    (Mode.HOLD, Event.RELEASED, Mode.RELEASE),
    (Mode.APPROACH, Event.PARK, Mode.PARK),
    (Mode.PARK, Event.APPROACH, Mode.APPROACH),
    (Mode.HALT, Event.APPROACH, Mode.APPROACH),
    (Mode.HALT, Event.PARK, Mode.PARK),
    (Mode.HALT, Event.RELEASED, Mode.OFF),
    (Mode.LOWER, Event.STOP, Mode.HOLD),
    (Mode.RELEASE, Event.STOP | Event.GRIPPED, Mode.HOLD),
    (Mode.READY, Event.TROUBLE, Mode.HOLD),
    *((mode, Event.TROUBLE, Mode.HALT) for mode in (Mode.APPROACH, Mode.GRASP, Mode.RELEASE, Mode.PARK)),
]


@pytest.mark.parametrize(("mode", "event", "after"), WAY + BESIDE)
def test_what_follows(mode: Mode, event: Event, after: Mode) -> None:
    assert next_in_session(mode, event) is after


def test_nothing_follows_from_nothing() -> None:
    assert all(next_in_session(mode, Event.NONE) is mode for mode in Mode)


@pytest.mark.parametrize("mode", Mode)
def test_a_lost_servo_is_a_fault_from_everywhere(mode: Mode) -> None:
    assert all(next_in_session(mode, events | Event.SERVO_LOST) is Mode.FAULT for events in ALL_EVENTS)


def test_torque_comes_on_at_rest_where_the_driver_is_enabled_and_nothing_is_wrong() -> None:
    for events in ALL_EVENTS:
        if Event.SERVO_LOST not in events:
            on = Event.ENABLED in events and Event.TROUBLE not in events
            assert next_in_session(Mode.OFF, events) is (Mode.REST if on else Mode.OFF)


@pytest.mark.parametrize("mode", [m for m in SESSION if m not in (Mode.REST, Mode.HALT)])
@pytest.mark.parametrize("bad", [Event.STOP, Event.TROUBLE])
def test_a_stop_holds_what_is_gripped_and_halts_what_is_free_whatever_else_is_said(mode: Mode, bad: Event) -> None:
    after = {next_in_session(mode, events | bad) for events in ALL_EVENTS if Event.SERVO_LOST not in events}
    if mode is Mode.HOLD:  # it holds already, and what is wrong lets a person who is at it go on
        assert after == ({Mode.HOLD} if bad is Event.STOP else {Mode.HOLD, Mode.RELEASE, Mode.LOWER})
    elif mode is Mode.RELEASE:  # it holds until its gripper opens
        assert after == {Mode.HOLD, Mode.HALT}
    else:
        assert after == ({Mode.HOLD} if mode in GRIPPED else {Mode.HALT})


@pytest.mark.parametrize("mode", SESSION)
def test_no_word_counts_beside_a_stop(mode: Mode) -> None:
    words = WORDS_SAID | Event.STARTED
    for events in ALL_EVENTS:
        assert next_in_session(mode, events | words | Event.STOP) is next_in_session(mode, events & ~words | Event.STOP)
    if mode in (Mode.REST, Mode.HOLD, Mode.HALT):
        assert next_in_session(mode, Event.STOP) is mode
        assert next_in_session(mode, Event.RELEASED) is not mode


def settled(follows: Callable[[Mode, Event], Mode], mode: Mode, events: Event) -> bool:
    """Whether an arm of this mode comes to one that it stays in, or to the end of its loop, while these events last."""
    for _ in Mode:
        after = follows(mode, events)
        if after is mode or not TABLE[after].commands:
            return True
        mode = after
    return False


@pytest.mark.parametrize("mode", SESSION)
def test_no_events_that_last_have_modes_take_turns_but_words_that_somebody_repeats_in_every_cycle(mode: Mode) -> None:
    """A word counts once (`agent.process.operated`); beside a stop that lasts not even repeated words move the arm."""
    for events in ALL_EVENTS:
        if Event.STOP in events or not events & WORDS_SAID:
            assert settled(next_in_session, mode, events), events


@pytest.mark.parametrize("mode", [Mode.READY, Mode.TRACK, Mode.HOLD, Mode.LOWER])
def test_without_a_session_no_events_that_last_have_modes_take_turns(mode: Mode) -> None:
    assert all(settled(next_mode, mode, events) for events in ALL_EVENTS)


@pytest.mark.parametrize("mode", sorted(GRIPPED))
def test_an_arm_that_holds_something_leaves_it_by_release_alone(mode: Mode) -> None:
    after = {next_in_session(mode, events) for events in ALL_EVENTS}
    assert after <= GRIPPED | {Mode.RELEASE, Mode.FAULT}


@pytest.mark.parametrize("mode", SESSION)
def test_torque_goes_off_at_rest_and_where_an_arm_was_stopped_alone(mode: Mode) -> None:
    off = any(next_in_session(mode, events) is Mode.OFF for events in ALL_EVENTS)
    assert off == (mode in (Mode.REST, Mode.HALT))


def test_only_a_closed_gripper_leads_to_ready_and_only_ready_to_the_motion() -> None:
    for mode in SESSION:
        for events in ALL_EVENTS:
            after = next_in_session(mode, events)
            assert after is not Mode.READY or mode is Mode.READY or (mode is Mode.GRASP and Event.GRIPPED in events)
            assert after is not Mode.TRACK or mode in (Mode.READY, Mode.TRACK)


@pytest.mark.parametrize("mode", SESSION)
def test_every_word_that_is_taken_leads_somewhere_and_no_other_does(mode: Mode) -> None:
    for word in (Event.APPROACH, Event.GRASP, Event.LOWER, Event.PARK, Event.RELEASED):
        assert (next_in_session(mode, word) is not mode) == (word in WORDS.get(mode, Event.NONE))
