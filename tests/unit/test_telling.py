"""What a loop tells of its arm, and that it may be asked to tell nobody."""

from __future__ import annotations

from agent.around import Surroundings
from agent.modes import Event, Mode
from agent.telling import OBEYS_AGAIN, Telling

TEXT = "servo 3: too hot"


def told(*, in_session: bool) -> tuple[Telling, list[str]]:
    texts: list[str] = []
    around = Surroundings(
        lambda: 0, lambda: Event.NONE, lambda: None, lambda: None, lambda _: None, texts.append, texts.append
    )
    return Telling(around, in_session=in_session), texts


def test_an_arm_that_stands_says_why_and_in_a_session_what_leads_back() -> None:
    for in_session, said in ((False, TEXT), (True, f"{TEXT}; way back: `coop park`")):
        telling, texts = told(in_session=in_session)
        telling.stands(Mode.HALT, TEXT, seen=True)
        assert texts == [said]


def test_a_word_that_counts_for_nothing_is_told_as_it_is() -> None:
    telling, texts = told(in_session=True)
    telling.refused("park: wait for it")
    assert texts == ["park: wait for it"]


def test_an_arm_at_rest_says_each_reason_once() -> None:
    telling, texts = told(in_session=True)
    for reason in (TEXT, TEXT, "its supply is low"):
        telling.at_rest(reason)
    assert texts == [f"{TEXT}; way back: `coop release`", "its supply is low; way back: `coop release`"]


def test_of_servos_that_obey_again_an_arm_at_rest_tells_and_one_that_holds_keeps_its_reason() -> None:
    telling, texts = told(in_session=True)
    assert telling.resumed(Mode.HOLD, TEXT) == TEXT
    assert texts == []
    assert telling.resumed(Mode.REST, TEXT) == ""
    assert texts == [f"{OBEYS_AGAIN}; way back: `coop release`"]


def test_a_loop_may_have_nobody_to_tell() -> None:
    alone = Surroundings(lambda: 0, lambda: Event.NONE, lambda: None, lambda: None, lambda _: None)
    telling = Telling(alone, in_session=True)
    telling.refused(TEXT)
    telling.at_rest(TEXT)
    telling.stands(Mode.HALT, TEXT, seen=False)
