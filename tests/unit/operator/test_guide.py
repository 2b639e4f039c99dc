"""What a person is told beside the arms: how each is, what is next, and how it is stopped, in every mode."""

from __future__ import annotations

import re

import pytest

from agent.modes import Event, Mode
from agent.operator.guide import STEPS, lines
from agent.operator.message import Reply
from agent.operator.table import EVENT_OF, Verb
from agent.session import WORDS
from agent.session_modes import next_in_session


def told(text: str) -> list[Verb]:
    return [Verb(word) for word in re.findall(r"coop (\w+) CELL", text)]


@pytest.mark.parametrize("mode", STEPS)
def test_what_is_said_to_stop_stops_where_something_moves_and_the_words_behind_it_lead_on(mode: Mode) -> None:
    stopped = next_in_session(mode, Event.STOP)
    moves = mode not in (Mode.OFF, Mode.REST, Mode.HOLD, Mode.HALT, Mode.FAULT)
    assert bool(STEPS[mode].stop) == moves == (stopped is not mode)
    if not moves:
        return
    first, *onwards = told(STEPS[mode].stop)
    ends = {stopped, next_in_session(mode, Event.STOP | Event.GRIPPED)}
    assert first is Verb.STOP
    assert onwards
    for word in onwards:
        assert any(WORDS[end] & EVENT_OF[word] for end in ends)


@pytest.mark.parametrize("mode", STEPS)
def test_every_word_that_is_told_next_is_taken(mode: Mode) -> None:
    for word in told(STEPS[mode].do):
        assert WORDS[mode] & EVENT_OF.get(word, Event.STARTED)


def test_the_cell_stands_in_every_line_and_an_arm_that_is_behind_is_waited_for() -> None:
    ready = {name: Reply(True, name, "TRACK") for name in ("left", "right")}
    assert lines(ready, "mine.toml")[-2:] == [
        "next: wait",
        "to stop: coop stop mine.toml: the arms hold the object; then coop lower mine.toml",
    ]
    apart = {**ready, "right": Reply(True, "right", "HOLD", "the gripper lost the object")}
    said = lines(apart, "mine.toml")
    assert "right: HOLD: the arms hold the object and stand; the gripper lost the object" in said
    assert said[-1].startswith("next: wait until all arms are equally far")


def test_an_arm_that_a_hand_guides_is_told_of_and_not_waited_for() -> None:
    said = lines({"left": Reply(True, "left", "REST"), "right": Reply(True, "right", "FLOAT")}, "c")
    assert said[1].startswith("right: FLOAT: ")
    assert said[-1].startswith("next: put the object in its place")
