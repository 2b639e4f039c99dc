"""docs/first-carry.md, executed: its words in its order on emulated servos, and what it says is seen after each."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import pytest
import typer

from agent.cli.main import app
from agent.modes import FLOATING, Event, Mode
from agent.operator.guide import STEPS
from agent.operator.table import EVENT_OF, Verb
from agent.session_modes import next_in_session
from tests.unit.test_whole import CELL, modes, whole

PAGE = (Path(__file__).parents[3] / "docs/first-carry.md").read_text()
COMMANDS = re.findall(r"^    coop (.+)$", PAGE, re.MULTILINE)
WORDS = [Verb(c.split()[0]) for c in COMMANDS if c.split()[0] in set(Verb)]
SEEN = [
    [Mode[name] for name in re.findall(r"\b[A-Z]{3,}\b", told) if name in Mode.__members__]
    for told in re.findall(r"\(((?:[A-Z]+(?:, then )?)+)\)", PAGE)
]


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_of_the_page_is_one(command: str) -> None:
    words = command.replace("CELL", "two_wx200").split()
    found = typer.main.get_command(app).commands[words[0]]  # type: ignore[attr-defined]
    found.make_context(words[0], words[1:])


def test_the_page_says_every_word_of_a_session_in_its_order() -> None:
    assert [verb.value for verb in WORDS] == [
        "approach", "grasp", "start", "lower", "release", "park", "release"
    ]  # fmt: skip


def test_the_words_of_the_page_in_its_order_lead_through_the_phases_that_it_says_are_seen() -> None:
    """The rig says the next word when all arms are ready for it; the rest is the doing of driver, servos and loop."""
    run = whole()
    said = {EVENT_OF.get(verb, Event.STARTED) for verb in WORDS}
    for arm in run.arms:
        way = modes(run, arm)
        own = {Event.GRIPPED, Event.ARRIVED, Event.STOP}  # what nobody says: STOP is the end of the trajectory
        for before, after in pairwise(way):
            assert any(next_in_session(before, event) is after for event in said | own)
        seen = [mode for told in SEEN for mode in told if mode is not Mode.HALT]
        assert [mode for mode in way if mode in seen] == seen
    assert run.place is not None
    assert run.place[0] < 3e-3, "the object stays where it is"
    assert CELL.file.session is not None


def test_the_guide_has_a_line_for_every_mode_and_names_the_word_that_comes_next() -> None:
    assert set(STEPS) == set(Mode) - FLOATING
    for before, verb in zip(
        (Mode.REST, Mode.APPROACH, Mode.READY, Mode.HOLD, Mode.LOWER, Mode.RELEASE), WORDS, strict=False
    ):
        assert f"coop {verb.value} CELL" in STEPS[before].do
