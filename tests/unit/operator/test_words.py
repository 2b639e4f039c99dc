"""P11: words to arms of which any are dead, hung, of another cell or in another mode, on real sockets."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import pytest

from agent.modes import Mode
from agent.operator import words
from agent.operator.error import ControlError
from agent.operator.message import Reply, Request
from agent.operator.session_table import SESSION
from agent.operator.socket import ControlSocket
from agent.operator.table import MODES, TABLE, Verb
from agent.operator.words import start_together
from tests.support.operated_arms import (
    DEAD,
    EVERY,
    FOREIGN,
    HUNG,
    OTHER,
    OWN,
    PATIENT_S,
    QUICK_S,
    SILENT,
    Arm,
    Condition,
    cell_of,
    serving,
)


def said(folder: Path, verb: Verb, conditions: Sequence[Condition]) -> tuple[str, list[Arm]]:
    """What the operator is told, empty when all went well; and the arms."""
    arms = cell_of(folder, conditions)
    where = {arm.path.stem: [arm.path] for arm in arms}
    timeout_s = QUICK_S if HUNG in conditions else PATIENT_S
    with serving(arms):
        try:
            if verb is Verb.START:
                start_together(where, Request(verb, OWN, time.time_ns() + 10**12), timeout_s)
            else:
                words._tell_all(where, Request(verb, OWN), timeout_s)
        except ControlError as error:
            return str(error), arms
    return "", arms


def takes(verb: Verb, condition: Condition) -> bool:
    """Whether an arm in this condition takes the word."""
    if not isinstance(condition, Mode):
        return condition == FOREIGN and verb is Verb.STOP
    allowed = {Verb.START: {Mode.READY}, Verb.RELEASE: {Mode.OFF, Mode.HOLD, Mode.LOWER}, Verb.STOP: set(MODES)}
    return condition in allowed[verb]


def check(folder: Path, verb: Verb, conditions: Sequence[Condition]) -> None:
    told, arms = said(folder, verb, conditions)
    willing = [takes(verb, arm.condition) for arm in arms]
    assert bool(told) is not all(willing), (conditions, told)
    assert "\n" not in told
    for arm, takes_it in zip(arms, willing, strict=True):
        name = arm.path.stem
        if told and not takes_it:
            assert f"{name}: " in told, (conditions, told)
            assert ("does not answer" in told.split(f"{name}: ")[1].split("; ")[0]) is (arm.condition in SILENT)
        if isinstance(arm.condition, Mode) and not takes_it:
            assert arm.condition.name in told.split(f"{name}: ")[1].split("; ")[0]
        if arm.control is not None:
            reached = takes_it and (verb is not Verb.START or all(willing))  # a start only with all the others
            assert arm.heard == (verb is Verb.START and reached, [verb] * (reached and verb is not Verb.START))


@pytest.mark.parametrize("verb", [Verb.START, Verb.STOP, Verb.RELEASE])
@pytest.mark.fault("P11")
def test_a_word_reaches_who_lives_and_a_start_all_or_none(tmp_path: Path, verb: Verb) -> None:
    """P11: two arms, each in every mode, absent, dead, hung or of another cell."""
    for number, conditions in enumerate(product(EVERY, EVERY)):
        check(tmp_path / str(number), verb, conditions)


@pytest.mark.parametrize("verb", [Verb.START, Verb.STOP, Verb.RELEASE])
@pytest.mark.fault("P11")
def test_any_subset_of_three_arms_may_be_dead_or_hung(tmp_path: Path, verb: Verb) -> None:
    """P11."""
    alive = Mode.READY if verb is Verb.START else Mode.HOLD
    for number, conditions in enumerate(product((alive, DEAD, HUNG), repeat=3)):
        check(tmp_path / str(number), verb, conditions)


SESSION_WORDS = {
    Verb.APPROACH: Mode.REST, Verb.GRASP: Mode.APPROACH, Verb.LOWER: Mode.HOLD, Verb.PARK: Mode.RELEASE,
}  # fmt: skip


@pytest.mark.parametrize("verb", SESSION_WORDS)
@pytest.mark.fault("P11")
def test_a_word_of_a_session_moves_all_arms_or_none(tmp_path: Path, verb: Verb) -> None:
    """P11: one arm not at its phase, dead or hung, and the other is not told to go on."""
    able = SESSION_WORDS[verb]
    for number, conditions in enumerate(product((able, Mode.TRACK, DEAD, HUNG), repeat=2)):
        arms = cell_of(tmp_path / str(number), conditions)
        for arm in arms:
            arm.session = True
        where = {arm.path.stem: [arm.path] for arm in arms}
        told, timeout_s = "", QUICK_S if HUNG in conditions else PATIENT_S
        with serving(arms):
            try:
                if verb is Verb.LOWER:
                    start_together(where, Request(verb, OWN, time.time_ns() + 10**12), timeout_s)
                else:
                    told = words._tell_all(where, Request(verb, OWN), timeout_s)
            except ControlError as error:
                told = str(error)
        goes = conditions == (able, able)
        assert ("no arm has been told" in told) is not goes, (conditions, told)
        for arm in arms:
            assert goes or (f"{arm.path.stem}: " in told) is (arm.condition != able)
            if arm.control is not None:
                requests = arm.control.requests
                assert (requests.lower is not None) is (goes and verb is Verb.LOWER)
                assert requests.words == [verb] * (goes and verb is not Verb.LOWER)


def test_a_refused_word_is_one_sentence_of_each_arm(tmp_path: Path) -> None:
    arms = cell_of(tmp_path / "cell", (Mode.REST,))
    arms[0].session = True
    with serving(arms), pytest.raises(ControlError) as told:
        words._tell_all({"left": [arms[0].path]}, Request(Verb.GRASP, OWN), PATIENT_S)
    assert str(told.value).startswith(
        "grasp: found left: refuses in REST: it stands at its rest, expected another mode, from here: "
        "`coop release` or `coop approach`, expected every arm of this host at its grasp; no arm has been told; "
    )


@pytest.mark.parametrize("verb", SESSION_WORDS)
def test_a_word_that_moves_an_arm_is_refused_by_one_that_runs_another_file_and_moves_none(
    tmp_path: Path, verb: Verb
) -> None:
    able = SESSION_WORDS[verb]
    arms = cell_of(tmp_path / "cell", (able, able))
    for arm in arms:
        arm.session = True
    arms[1].fingerprint = OTHER
    where = {arm.path.stem: [arm.path] for arm in arms}
    expected = f"b: refuses in {able.name}: cell {OWN[:12]}, expected cell {OTHER[:12]}, give the file that"
    say = start_together if verb is Verb.LOWER else words._tell_all
    request = Request(verb, OWN, (time.time_ns() + 10**12) * (verb is Verb.LOWER))
    with serving(arms), pytest.raises(ControlError, match=expected):
        say(where, request, PATIENT_S)
    assert [arm.heard for arm in arms] == [(False, []), (False, [])]


def test_a_lowering_that_one_arm_does_not_take_is_taken_back(tmp_path: Path) -> None:
    """The first has begun by then, and holds again; the second has been hit by a fault between the two questions."""
    arms = cell_of(tmp_path / "cell", (Mode.HOLD, Mode.HOLD))
    able = [True]

    def first(control: ControlSocket) -> None:
        if control.requests.lower is not None:
            control.standing.mode = Mode.LOWER

    def answered() -> dict[str, Any]:
        able[0] = False
        return {"session": True}

    def second(control: ControlSocket) -> None:
        control.standing.details = answered
        control.standing.mode = Mode.HOLD if able[0] else Mode.FAULT

    arms[0].wakes, arms[1].wakes = first, second
    for arm in arms:
        arm.session = True
    request = Request(Verb.LOWER, OWN, time.time_ns() + 10**12)
    with serving(arms), pytest.raises(ControlError, match="a: had begun, holds now; b: does not begin"):
        start_together({arm.path.stem: [arm.path] for arm in arms}, request, PATIENT_S)
    assert arms[0].control is not None
    assert arms[0].control.requests.lower is None
    assert arms[0].heard == (False, [Verb.STOP])


@pytest.mark.parametrize("session", [False, True])
@pytest.mark.parametrize("mode", [Mode.READY, Mode.TRACK, Mode.HOLD, Mode.LOWER])
def test_an_arm_that_lets_go_at_a_stop_is_not_said_to_hold(tmp_path: Path, mode: Mode, *, session: bool) -> None:
    arms = cell_of(tmp_path / "cell", (mode, mode))
    with serving(arms):
        for arm, drops in zip(arms, (True, False), strict=True):
            assert arm.control is not None
            arm.control.standing.details = partial(dict, session=session, drops_on_stop=drops)
        told = words._tell_all({arm.path.stem: [arm.path] for arm in arms}, Request(Verb.STOP, OWN), PATIENT_S)
    drops_it, holds_it = told.replace("; a start that", ", a start that").split("; ")
    assert "lets go and ends, as a simulated arm does" in drops_it
    assert holds_it.removeprefix("b ") == (SESSION if session else TABLE)[Verb.STOP][mode].does.replace("; ", ", ")


def test_a_start_that_is_taken_back_says_of_such_an_arm_that_it_lets_go() -> None:
    holds, ends = ({"drops_on_stop": drops} for drops in (False, True))
    assert words._outcome({
        "a": Reply(True, "a", "TRACK", details=holds), "b": Reply(True, "b", "TRACK", details=ends),
        "c": Reply(True, "c", "TRACK"),
    }) == (
        "a: had begun, holds now; b: had begun, holds the object for a moment, then lets go and ends, as a simulated "
        "arm does; c: had begun, holds now"
    )  # fmt: skip
