"""Mode changes, over every mode and every combination of events."""

from __future__ import annotations

from itertools import product

import pytest

from agent.modes import FLOATING, TABLE, WAY_BACK, Event, Mode, mode_name, mode_of, next_mode
from agent.session_modes import next_in_session

OF_OBJECT = [mode for mode in Mode if mode <= Mode.FAULT]  # the others are of a session: test_session_modes.py
ALL_EVENTS = [Event(bits) for bits in range(2 * Event.RELEASED)]
ALL = list(product(OF_OBJECT, ALL_EVENTS))
BAD = (Event.STOP, Event.TROUBLE, Event.SERVO_LOST)
# how far a mode is from rest: a bad event may never lead further out
ACTIVITY = {Mode.OFF: 0, Mode.FAULT: 0, Mode.READY: 2, Mode.LOWER: 2, Mode.HOLD: 2, Mode.TRACK: 3}

# mode, events that decide it (any of them, none of the others decides before), next mode
NAMED = [
    (Mode.OFF, Event.NONE, Mode.OFF),
    (Mode.OFF, Event.ENABLED, Mode.READY),
    (Mode.OFF, Event.ENABLED | Event.TROUBLE, Mode.OFF),
    (Mode.OFF, Event.ENABLED | Event.SERVO_LOST, Mode.OFF),
    (Mode.OFF, Event.STARTED, Mode.OFF),
    (Mode.READY, Event.NONE, Mode.READY),
    (Mode.READY, Event.STARTED, Mode.TRACK),
    (Mode.READY, Event.STARTED | Event.STOP, Mode.HOLD),
    (Mode.READY, Event.STARTED | Event.TROUBLE, Mode.HOLD),
    (Mode.READY, Event.SERVO_LOST, Mode.FAULT),
    (Mode.TRACK, Event.NONE, Mode.TRACK),
    (Mode.TRACK, Event.STOP, Mode.HOLD),
    (Mode.TRACK, Event.TROUBLE, Mode.HOLD),
    (Mode.TRACK, Event.RELEASED, Mode.TRACK),
    (Mode.TRACK, Event.SERVO_LOST, Mode.FAULT),
    (Mode.HOLD, Event.NONE, Mode.HOLD),
    (Mode.HOLD, Event.STARTED, Mode.HOLD),
    (Mode.HOLD, Event.RELEASED, Mode.OFF),
    (Mode.HOLD, Event.SERVO_LOST | Event.RELEASED, Mode.FAULT),
    (Mode.LOWER, Event.NONE, Mode.LOWER),
    (Mode.LOWER, Event.RELEASED, Mode.OFF),
    (Mode.LOWER, Event.SERVO_LOST, Mode.FAULT),
    (Mode.FAULT, Event.ENABLED | Event.STARTED, Mode.FAULT),
    (Mode.FAULT, Event.RELEASED, Mode.FAULT),
]


@pytest.mark.parametrize(("mode", "events", "expected"), NAMED)
def test_named_transitions(mode: Mode, events: Event, expected: Mode) -> None:
    assert next_mode(mode, events) is expected


def test_numbers_of_the_modes_are_those_that_logs_hold() -> None:
    names = (
        "OFF", "READY", "TRACK", "HOLD", "LOWER", "FAULT", "REST", "APPROACH", "GRASP", "RELEASE", "PARK", "HALT",
        "FLOAT", "STAND", "SINK",
    )  # fmt: skip
    assert {mode.name: mode.value for mode in Mode} == {name: value for value, name in enumerate(names)}


def test_every_event_is_a_bit_of_its_own() -> None:
    values = [event.value for event in Event.__members__.values() if event]  # aliases too
    assert values == [1 << i for i in range(len(values))]
    assert Event.NONE == 0


def test_the_named_transitions_name_every_mode() -> None:
    assert {mode for mode, _, _ in NAMED} == set(OF_OBJECT)


@pytest.mark.parametrize("mode", OF_OBJECT)
def test_every_combination_of_events_has_an_answer(mode: Mode) -> None:
    assert {type(next_mode(mode, events)) for events in ALL_EVENTS} == {Mode}


@pytest.mark.parametrize("origin", [Mode.HOLD, Mode.LOWER, Mode.FAULT, Mode.OFF])
def test_track_is_entered_from_ready_only(origin: Mode) -> None:
    assert all(next_mode(origin, events) is not Mode.TRACK for events in ALL_EVENTS)


def test_no_way_from_hold_or_fault_to_track_without_off() -> None:
    """Reachability over any number of ticks, with OFF (torque off, an operator's release) taken out."""
    for origin in (Mode.HOLD, Mode.LOWER, Mode.FAULT):
        reached, frontier = {origin}, [origin]
        while frontier:
            mode = frontier.pop()
            for after in {next_mode(mode, events) for events in ALL_EVENTS} - reached - {Mode.OFF}:
                reached.add(after)
                frontier.append(after)
        assert Mode.TRACK not in reached


def test_torque_is_never_switched_off_while_the_object_is_carried() -> None:
    """TRACK ends in HOLD, or in FAULT when the arm does not obey any more."""
    assert {next_mode(Mode.TRACK, events) for events in ALL_EVENTS} == {Mode.TRACK, Mode.HOLD, Mode.FAULT}


@pytest.mark.parametrize(("mode", "events"), [(m, e) for m, e in ALL if m in (Mode.HOLD, Mode.LOWER)])
def test_a_held_object_is_let_go_only_when_an_operator_confirms_its_support(mode: Mode, events: Event) -> None:
    if next_mode(mode, events) is Mode.OFF:
        assert Event.RELEASED in events


@pytest.mark.parametrize("mode", [m for m in OF_OBJECT if m is not Mode.OFF])
def test_a_lost_servo_is_a_fault_in_every_mode_with_torque(mode: Mode) -> None:
    assert all(next_mode(mode, e) is Mode.FAULT for e in ALL_EVENTS if Event.SERVO_LOST in e)


def test_fault_is_left_by_nothing_so_a_lost_arm_never_ends_with_exit_code_0() -> None:
    assert {next_mode(Mode.FAULT, events) for events in ALL_EVENTS} == {Mode.FAULT}
    assert all(next_mode(mode, Event.SERVO_LOST | e) is not Mode.OFF for mode, e in ALL if mode is not Mode.OFF)


@pytest.mark.parametrize("mode", OF_OBJECT)
def test_a_held_object_comes_from_a_mode_that_holds_one(mode: Mode) -> None:
    """Nothing but READY and TRACK leads to HOLD, and HOLD to nothing but a release and a fault."""
    into_hold = Mode.HOLD in {next_mode(mode, e) for e in ALL_EVENTS}
    assert into_hold == (mode in (Mode.READY, Mode.TRACK, Mode.HOLD))
    if mode is Mode.HOLD:
        assert {next_mode(mode, e) for e in ALL_EVENTS} == {Mode.HOLD, Mode.OFF, Mode.FAULT}


def test_every_mode_has_a_line_and_words_of_its_own() -> None:
    assert set(TABLE) == set(Mode)
    assert len({entry.says for entry in TABLE.values()}) == len(Mode)
    assert {mode for mode, entry in TABLE.items() if entry.commands} == set(Mode) - {Mode.OFF, Mode.FAULT}


@pytest.mark.parametrize("bad", BAD)
def test_one_more_bad_event_never_leads_to_a_more_active_mode(bad: Event) -> None:
    for mode, events in ALL:
        assert ACTIVITY[next_mode(mode, events | bad)] <= ACTIVITY[next_mode(mode, events)]


FLOATS = [Event.NONE, Event.STOP, Event.TROUBLE, Event.RELEASED, Event.ARRIVED, Event.STARTED, Event.ENABLED]


@pytest.mark.parametrize(
    ("mode", "after"),
    [
        (Mode.FLOAT, {Event.STOP: Mode.STAND, Event.TROUBLE: Mode.STAND}),
        (Mode.STAND, {Event.RELEASED: Mode.SINK}),
        (Mode.SINK, {Event.ARRIVED: Mode.OFF}),
    ],
)
def test_a_floating_arm_stands_then_sinks_before_its_torque_goes_off(mode: Mode, after: dict[Event, Mode]) -> None:
    assert {event: next_mode(mode, event) for event in FLOATS} == {event: after.get(event, mode) for event in FLOATS}
    assert all(next_mode(mode, event | Event.SERVO_LOST) is Mode.FAULT for event in FLOATS)


def test_float_is_entered_from_off_alone() -> None:
    assert next_mode(Mode.OFF, Event.FLOATED) is Mode.FLOAT
    assert {Mode.FLOAT, Mode.STAND, Mode.SINK} == FLOATING
    assert {m for m in Mode if next_mode(m, Event.FLOATED) in FLOATING} == {Mode.OFF, *FLOATING}


def test_the_way_back_is_what_a_session_passes_from_its_hold_to_its_rest() -> None:
    mode, passed = Mode.HOLD, []
    for event in (Event.LOWER, Event.RELEASED, Event.PARK):
        mode = next_in_session(mode, event)
        passed.append(mode)
    assert next_in_session(mode, Event.ARRIVED) is Mode.REST
    assert frozenset(passed) == WAY_BACK


def test_a_number_of_a_row_names_its_mode_and_one_of_another_version_itself() -> None:
    assert [mode_of(mode.value) for mode in Mode] == list(Mode)
    assert [mode_name(mode.value) for mode in Mode] == [mode.name for mode in Mode]
    later = max(Mode) + 1
    assert (mode_of(later), mode_name(later)) == (None, str(later))
