"""Words of a session by mode: complete, as the modes have it, and as the documents show it."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import pytest

from agent.modes import FLOATING, Event, Mode
from agent.operator.session_table import DOING, MODES, SESSION, markdown
from agent.operator.table import EVENT_OF, TABLE, Verb
from agent.session import WORDS
from agent.session_modes import next_in_session

ROOT = Path(__file__).parents[3]
WORDS_OF_SESSION = (Verb.APPROACH, Verb.GRASP, Verb.LOWER, Verb.PARK)


@pytest.mark.parametrize(("verb", "mode"), list(product(Verb, MODES)))
def test_a_word_does_what_the_modes_make_of_its_event(verb: Verb, mode: Mode) -> None:
    found = SESSION[verb][mode]
    assert found.does
    event = EVENT_OF.get(verb, Event.NONE)
    if verb in WORDS_OF_SESSION or verb is Verb.RELEASE:
        assert found.accepted == bool(event & WORDS.get(mode, Event.NONE))
    if verb not in (Verb.START, Verb.CANCEL, Verb.STATUS):
        assert found.becomes in (None, next_in_session(mode, event))
    assert bool(found.remedy) != found.accepted


def test_a_stop_is_taken_everywhere_and_says_what_becomes_of_the_grip() -> None:
    assert all(SESSION[Verb.STOP][mode].accepted for mode in MODES)
    for mode in (Mode.READY, Mode.TRACK, Mode.LOWER):
        assert SESSION[Verb.STOP][mode].does == "holds the object where it is, gripper closed"
    for mode in (Mode.APPROACH, Mode.GRASP, Mode.RELEASE, Mode.PARK):
        assert SESSION[Verb.STOP][mode].becomes is Mode.HALT


def test_a_word_out_of_order_says_what_may_be_said_instead() -> None:
    refused = SESSION[Verb.LOWER][Mode.REST]
    assert refused.does == "it stands at its rest"
    assert refused.remedy == "from here: `coop release` or `coop approach`"
    assert set(DOING) == set(MODES) == set(Mode) - FLOATING


def test_an_agent_that_began_with_the_object_knows_no_such_word() -> None:
    for verb in WORDS_OF_SESSION:
        assert not any(found.accepted for found in TABLE[verb].values())


def test_the_documents_show_this_table() -> None:
    shown = (ROOT / "docs/session.md").read_text()
    assert markdown() in shown, "replace the table by agent.operator.session_table.markdown()"
