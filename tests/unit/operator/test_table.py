"""The table of words and modes: complete, in step with the table of modes, and the one that the documents show."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import pytest

from agent.modes import Event, Mode, next_mode
from agent.operator.table import EVENT_OF, MODES, TABLE, Effect, Verb, _in_each, effect, markdown

ROOT = Path(__file__).parents[3]
EVERY = list(product(Verb, MODES))


@pytest.mark.fault("P11")
def test_every_word_has_an_effect_in_every_mode() -> None:
    assert [(verb, mode) for verb, row in TABLE.items() for mode in row] == EVERY
    with pytest.raises(ValueError, match="no effect in FAULT, LOWER"):
        _in_each({mode: Effect(mode, "is") for mode in MODES if mode not in (Mode.LOWER, Mode.FAULT)})


@pytest.mark.parametrize(("verb", "mode"), EVERY)
def test_a_word_does_what_the_modes_make_of_its_event(verb: Verb, mode: Mode) -> None:
    found = effect(verb, mode)
    if found.accepted:
        events = EVENT_OF.get(verb, Event.NONE)
        if verb is Verb.CANCEL and mode is Mode.TRACK:
            events = Event.STOP  # of a start that has come true
        assert found.becomes is next_mode(mode, events)
        assert found.remedy == ""
    else:
        assert found.does
        assert found.remedy


def test_a_stop_is_taken_in_every_mode_and_no_word_leads_from_a_hold_to_a_motion() -> None:
    assert all(effect(verb, mode).accepted for verb in (Verb.STOP, Verb.CANCEL, Verb.STATUS) for mode in MODES)
    assert [mode for mode in MODES if effect(Verb.START, mode).accepted] == [Mode.READY]
    assert [mode for mode in MODES if not effect(Verb.RELEASE, mode).accepted] == [Mode.READY, Mode.TRACK, Mode.FAULT]
    assert {effect(verb, Mode.HOLD).becomes for verb in Verb} == {None, Mode.HOLD, Mode.OFF}


def test_the_documents_show_this_table() -> None:
    assert markdown() in (ROOT / "docs/commands.md").read_text(), "replace the table by agent.operator.table.markdown()"
