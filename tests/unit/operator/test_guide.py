"""What a person is told beside the arms: how each is, what is next, and how it is stopped, in every mode."""

from __future__ import annotations

import re
from typing import Any

import pytest

from agent.modes import Event, Mode
from agent.operator.guide import STEPS, STEPS_HELD, lines, missing
from agent.operator.table import EVENT_OF, MODES, Verb, effect
from agent.process.session import LEADS_BACK
from agent.session import _BACK, WORDS
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


def arm(name: str, mode: str | None, reason: str = "", **other: Any) -> dict[str, Any]:
    """One that answers, as in the document of `coop status`."""
    own = {
        "answers": True,
        "silence": None,
        "alive": True,
        "ended": False,
        "failed": None,
        "same_cell": True,
        "no_start": None,
        "session": True,
        "drops_on_stop": False,
        "guard": "watches",
    }
    return {"arm": name, "mode": mode, "reason": reason, "last_row_age_s": 0.0, **own, **other}


def silent(name: str, mode: str | None, **other: Any) -> dict[str, Any]:
    """One that does not, dead unless `other` says more."""
    gone = {
        "answers": False,
        "silence": "No such file or directory",
        "alive": False,
        "last_row_age_s": 3.0,
        "failed_utc_ns": 0,
    }
    return arm(name, mode, **(gone | {"same_cell": None} | other))


@pytest.mark.fault("P7")
@pytest.mark.parametrize(
    ("how", "said"), [("gone", "its guard is gone, and nobody goes on"), ("hangs", "its guard hangs")]
)
def test_an_arm_whose_guard_is_gone_or_hangs_is_led_back_and_its_guard_is_named(how: str, said: str) -> None:
    """It refuses what would lead it on."""
    beside = arm("left", "REST")
    first, second, then = lines([beside, arm("right", "REST", guard=how)], "mine.toml")
    assert "guard" not in first
    assert said in second
    assert then == "next: coop release mine.toml ends it"
    assert lines([arm("left", "HALT", guard=how)], "mine.toml")[1] == "next: coop park mine.toml"
    assert lines([beside, beside], "mine.toml")[2].startswith("next: put the object in its place")
    assert lines([beside, arm("right", "REST", guard=None)], "mine.toml")[2].startswith("next: put the object")


def test_the_cell_stands_in_every_line_of_arms_that_are_alike() -> None:
    assert lines([arm("left", "TRACK"), arm("right", "TRACK")], "mine.toml")[-2:] == [
        "next: wait",
        "to stop: coop stop mine.toml: the arms hold the object; then coop lower mine.toml",
    ]


STOPS = "to stop: coop stop c: what moves stops, what holds the object goes on holding it"
LOST = (
    "next for left: support it and what it holds; lead the others back; then fold it into its rest by hand and start "
    "its agent"
)
BEGIN = "bring it to its rest by hand and start its agent"
NOT_SEEN = (
    "look at it: its agent may run as another user, with another XDG_RUNTIME_DIR or name of the cell, and hears words "
    "that are said from there; where none runs, start its agent"
)
APART: dict[str, tuple[list[dict[str, Any]], list[str]]] = {
    "one holds, one carries on": (
        [arm("left", "HOLD", "it slipped"), arm("right", "TRACK")],
        [STOPS, "next: coop stop c; then coop lower c sets the object down"],
    ),
    "one lowers what the other holds": (
        [arm("left", "HOLD"), arm("right", "LOWER")],
        [STOPS, "next: coop stop c; then coop lower c sets the object down"],
    ),
    "one is dead, one carries on": (
        [silent("left", "TRACK"), arm("right", "TRACK")],
        [STOPS, "next: coop stop c; then coop lower c --arm right sets the object down", LOST],
    ),
    "one is dead, two hold": (
        [silent("left", "HOLD"), arm("right", "HOLD"), arm("third", "HOLD")],
        [
            (
                "next for right, third: coop lower c --arm right --arm third sets it down; or support it, "
                "then coop release c --arm right --arm third"
            ),
            LOST,
        ],
    ),
    "one is dead, one lowers": (
        [silent("left", "LOWER"), arm("right", "LOWER")],
        [STOPS, "next for right: once it stands: coop release c --arm right", LOST],
    ),
    "one does not obey": (
        [arm("left", "FAULT"), arm("right", "APPROACH")],
        [STOPS, f"next for left: {STEPS[Mode.FAULT].do}", "next for right: coop park c --arm right"],
    ),
    "one has closed on nothing": (
        [arm("left", "APPROACH"), arm("right", "READY")],
        [
            STOPS,
            (
                "next for left: look along each gripper: the object between open fingers? coop grasp c --arm left, "
                "else coop park c --arm left"
            ),
            "next for right: wait for the others; or coop release c --arm right, for the object still stands",
        ],
    ),
    "one hangs": (
        [silent("left", "HOLD", alive=True), arm("right", "HALT")],
        [
            "next for right: coop park c --arm right",
            "next for left: support it and what it holds: no word reaches it; its log says why, then end its process",
        ],
    ),
    "one begins": (
        [silent("left", None, alive=True), arm("right", "REST")],
        [
            (
                "next for right: wait, or coop approach c --arm right where the others stand at their grasps; to end "
                "it coop release c --arm right"
            ),
            "next for left: wait until it answers",
        ],
    ),
    "all have ended": (
        [silent("left", "OFF", ended=True), silent("right", "OFF", ended=True)],
        [f"next for left, right: {BEGIN}"],
    ),
    "one was never there, one ended without its arm": (
        [silent("left", "FAULT", ended=True), silent("right", None)],
        [
            LOST.replace(" and what it holds; lead the others back; ", ", and the object if it holds it; "),
            f"next for right: {NOT_SEEN}",
        ],
    ),
}


@pytest.mark.parametrize("case", APART)
def test_arms_that_are_not_alike_are_stopped_first_and_led_on_by_words_to_each(case: str) -> None:
    arms, expected = APART[case]
    assert lines(arms, "c")[len(arms) :] == expected
    assert missing(arms) == any(not one["answers"] for one in arms)


@pytest.mark.parametrize("case", APART)
def test_every_word_that_is_told_to_some_arms_is_taken_by_those(case: str) -> None:
    arms, _ = APART[case]
    mode_of = {one["arm"]: Mode[one["mode"]] for one in arms if one["answers"]}
    stopped = False
    for word, named in re.findall(r"coop (\w+) c((?: --arm \w+)*)", "\n".join(lines(arms, "c"))):
        meant = re.findall(r"--arm (\w+)", named) or list(mode_of)
        stopped = stopped or word == "stop"
        for name in meant if word != "stop" else ():
            after = next_in_session(mode_of[name], Event.STOP) if word == "lower" and stopped else mode_of[name]
            assert WORDS[after] & EVENT_OF[Verb(word)]


def test_an_arm_that_is_not_there_is_told_of_as_status_does() -> None:
    found = [
        silent("a", "TRACK", failed="arm a: found no answer, expected a fresh state"), silent("b", "OFF", ended=True),
        silent("c", None), silent("d", "HOLD", alive=True, silence="no answer within 0.5 s"),
        silent("e", None, alive=True, silence="no answer within 0.5 s"), arm("f", "HOLD", "it is hot", same_cell=False),
    ]  # fmt: skip
    assert lines(found, "cell")[:6] == [
        "a: DEAD; arm a: found no answer, expected a fresh state (at 1970-01-01 00:00:00 UTC); last TRACK",
        "b: ENDED; last OFF",
        "c: NOT SEEN from here: No such file or directory",
        "d: HUNG; no answer within 0.5 s; last HOLD",
        "e: STARTING; no answer within 0.5 s: it loads or connects, and has made no cycle yet",
        "f: HOLD: the arms hold the object and stand; RUNS OTHER SETTINGS THAN THIS FILE; it is hot",
    ]


NO_START = {"found": "SCHED_OTHER 0", "expected": "SCHED_FIFO on a real arm", "remedy": "give --priority 80"}


def test_arms_that_would_refuse_the_start_are_led_back_and_say_why() -> None:
    said = lines([arm("left", "REST", no_start=NO_START), arm("right", "REST")], "c")
    assert said[0].endswith("touched; NO START: SCHED_OTHER 0, expected SCHED_FIFO on a real arm; give --priority 80")
    assert said[2] == "next: coop release c ends it"
    apart = lines([arm("left", "APPROACH", no_start=NO_START), arm("right", "REST")], "c")
    assert apart[-2:] == [
        "next for left: coop park c --arm left", "next for right: coop release c --arm right ends it"
    ]  # fmt: skip


LED_BACK = {"no_start": LEADS_BACK}


@pytest.mark.parametrize("mode", [*_BACK, Mode.LOWER, Mode.RELEASE, Mode.PARK])
def test_every_word_that_is_told_of_an_arm_whose_guard_leads_it_back_is_taken_by_it(mode: Mode) -> None:
    said = lines([arm("left", mode.name, **LED_BACK)], "CELL")
    assert "start its guard and its agent anew" in said[0]
    words = set(told("\n".join(said)))
    assert words <= {Verb.STOP, Verb.PARK, Verb.LOWER, Verb.RELEASE}
    assert mode is not Mode.REST or words == {Verb.RELEASE}


def test_arms_of_another_file_are_told_no_word_that_they_refuse() -> None:
    """All but stop and release are refused with a file that is not the agent's."""
    found = [arm("left", "APPROACH", same_cell=False), arm("right", "REST")]
    for arms, named in ((found, "left"), ([found[0], arm("right", "READY", same_cell=False)], "left, right")):
        *said, told_then = lines(arms, "CELL")
        assert len(said) == 2
        assert told_then.startswith(f"next for {named}: coop guide with the cell file that its agent was started with;")
        assert {Verb.STOP, Verb.RELEASE} == set(told(told_then))


def test_sockets_that_are_given_are_named_as_such() -> None:
    assert lines([arm("l.control", "HOLD"), silent("r.control", None)], "c", "--control")[2].startswith(
        "next for l.control: coop lower c --control l.control sets it down"
    )


def test_an_arm_that_a_hand_guides_is_told_of_and_not_waited_for() -> None:
    deaf = silent("third", "FLOAT", alive=True, last_row_age_s=0.01)
    found = [arm("left", "REST"), arm("right", "FLOAT"), deaf]
    said = lines(found, "c")
    assert [line.split(": ")[1] for line in said[1:3]] == ["FLOAT", "FLOAT"]
    assert said[3].startswith("next: put the object in its place")
    assert not missing(found)


def test_arms_that_began_with_the_object_in_their_grippers_are_told_of_in_every_mode() -> None:
    assert set(STEPS_HELD) == set(MODES)


@pytest.mark.parametrize("right", [Mode.READY, Mode.TRACK, Mode.HOLD, Mode.LOWER, Mode.FAULT, None])
@pytest.mark.parametrize("left", [Mode.READY, Mode.TRACK, Mode.HOLD, Mode.LOWER])
def test_every_word_that_is_told_to_arms_of_no_session_is_taken_by_those(left: Mode, right: Mode | None) -> None:
    beside = silent("right", "TRACK") if right is None else arm("right", right.name, session=False)
    said = lines([arm("left", left.name, session=False), beside], "c")
    mode_of = {"left": left} | ({"right": right} if right else {})
    assert all(f"{name}: {mode.name}: {STEPS_HELD[mode].seen}" in said for name, mode in mode_of.items())
    for line in said[2:]:
        words = re.findall(r"coop (\w+) c((?: --arm \w+)*)", line)
        for place, (word, named) in enumerate(words):
            stopped = not {("stop", ""), ("stop", named)}.isdisjoint(words[:place])
            for name in re.findall(r"--arm (\w+)", named) or mode_of:
                if (mode := mode_of[name]) is not Mode.FAULT:
                    after = effect(Verb.STOP, mode).becomes if stopped else mode
                    assert after is not None
                    assert effect(Verb(word), after).accepted, (word, name, said)


def test_arms_of_no_session_are_supported_and_released_and_not_lowered() -> None:
    held = [arm("left", "HOLD", session=False), arm("right", "TRACK", session=False)]
    assert lines(held, "c")[2:] == [STOPS, "next: coop stop c; then support the object and coop release c"]
    assert lines([arm("left", "READY", session=False), silent("right", None)], "c")[2:] == [
        STOPS,
        "next for left: coop stop c --arm left; support the object; then coop release c --arm left",
        f"next for right: {NOT_SEEN}",
    ]
    assert lines([arm("left", "READY", session=False), silent("right", "TRACK")], "c")[-1] == (
        "next for right: support it and what it holds; stop and release the others; then start its agent"
    )


def test_arms_that_let_go_at_a_stop_are_not_said_to_hold_after_one() -> None:
    def brief(name: str, mode: str, **other: Any) -> dict[str, Any]:
        return arm(name, mode, session=False, drops_on_stop=True, **other)

    ends = "to stop: coop stop c: the arms stop for a moment, then let go and end"
    assert lines([brief("left", "TRACK"), brief("right", "TRACK")], "c")[2:] == ["next: wait", ends]
    apart = lines([brief("left", "HOLD"), brief("right", "TRACK")], "c")
    assert apart[2:] == [ends, "next: support the object; then coop stop c"]
    assert lines([brief("left", "READY"), silent("right", "TRACK")], "c")[2:] == [
        ends,
        "next for left: support the object; then coop stop c --arm left",
        "next for right: support it and what it holds; stop the others; then start its agent",
    ]
    unlike = [arm("left", "TRACK", session=False), brief("right", "TRACK")]
    assert lines(unlike, "c")[-1] == (
        "to stop: coop stop c: the arms hold the object; support it, then coop release c (right: let go and end)"
    )
    unlike[0]["mode"] = "HOLD"
    assert lines(unlike, "c")[2:] == [
        f"{STOPS} (right: let go and end)", "next: coop stop c; then support the object and coop release c"
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("mode", "support"),
    [
        *((mode, "support it") for mode in ("REST", "APPROACH", "PARK", "HALT")),
        *((mode, "support it and what it holds") for mode in ("GRASP", "READY", "TRACK", "HOLD", "LOWER", "RELEASE")),
        ("FAULT", "support it, and the object if it holds it"),
    ],
)
def test_of_an_arm_that_held_nothing_nobody_is_to_support_what_it_holds(mode: str, support: str) -> None:
    assert lines([silent("left", mode)], "c")[-1] == (
        f"next for left: {support}; then fold it into its rest by hand and start its agent"
    )
    hung = lines([silent("left", mode, alive=True)], "c")[-1]
    assert hung == f"next for left: {support}: no word reaches it; its log says why, then end its process"
