"""The operator as the loop sees them: events that are latched or count once, a start that moves, what is answered."""

from __future__ import annotations

import json
import os
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.config.schema.driver import DriverKind
from agent.host.clock import UNKNOWN
from agent.host.realtime import RealTime
from agent.modes import Event, Mode, next_mode
from agent.operator.message import Reply, Request
from agent.operator.session_table import MODES as SESSION_MODES
from agent.operator.session_table import SESSION
from agent.operator.socket import ControlSocket, Standing
from agent.operator.table import EVENT_OF, TABLE, Verb
from agent.process import agent, operated
from agent.process.clocked import ClockWatch
from agent.process.commands import AgentOptions
from agent.process.operated import Operator, tick_of
from agent.session_modes import next_in_session
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.event import Level
from agent.telemetry.row.sample import AGENT_STATE

NOW_NS = 5_000_000_000
OFFSET_NS = 1_700_000_000_000_000_000


class Clock:
    """Stands still."""

    utc_offset_ns = OFFSET_NS

    def now_ns(self) -> int:
        return NOW_NS

    def sleep_until(self, deadline_ns: int) -> None:
        raise AssertionError(deadline_ns)


class Signals:
    """No signal yet."""

    stopped = False
    released = False
    stops = 0
    why = ""


class Rig:
    """An operator with a control socket that nobody but the test asks."""

    def __init__(self, path: Path, *, drops_on_stop: bool = False, session: bool = False) -> None:
        self.told: list[tuple[Level, str, dict[str, Any]]] = []
        self.signals: Any = Signals()
        self.control = ControlSocket(path, "ab" * 32, Standing("left", Mode.TRACK))
        self.operator = Operator(
            self.signals, self.control, Clock(), self._tell, drops_on_stop=drops_on_stop, session=session
        )

    def _tell(self, level: Level, text: str, **data: float | str) -> None:
        self.told.append((level, text, data))

    def hear(self, *words: Verb) -> Event:
        self.control.requests.words += words
        return self.operator.events()


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Rig]:
    monkeypatch.setattr(operated, "utc_offset_ns", lambda: OFFSET_NS)
    made = Rig(tmp_path / "left.control")
    with closing(made.control):
        yield made


def test_a_stop_is_latched_and_a_release_counts_once(rig: Rig) -> None:
    assert rig.hear() == Event.NONE
    assert rig.hear(Verb.RELEASE) == Event.RELEASED
    assert rig.hear() == Event.NONE
    assert rig.hear(Verb.STOP) == Event.STOP
    assert rig.hear() == Event.STOP
    assert rig.hear(Verb.RELEASE) == Event.STOP | Event.RELEASED
    assert rig.hear() == Event.STOP


def test_whose_words_are_heard_and_which_start_counts_is_asked(rig: Rig) -> None:
    deaf = Operator(rig.signals, None, Clock(), rig._tell, drops_on_stop=False)
    assert (deaf.is_deaf, rig.operator.is_deaf) == (True, False)
    assert deaf.watched == "", "before a cycle too"
    deaf.listen(rig.control)
    assert not deaf.is_deaf
    rig.control.requests.start = given = Request(Verb.START, "", OFFSET_NS + 7)
    assert deaf.start is None
    assert deaf.start_ns() == 7
    assert deaf.start is given
    rig.control.requests.words.append(Verb.RELEASE)
    assert deaf.events() == Event.RELEASED


SIGHUP = "SIGHUP: its terminal or connection is gone"


@pytest.mark.parametrize(
    ("session", "mode", "reason"),
    [
        (False, Mode.HOLD, SIGHUP),
        (True, Mode.HOLD, f"{SIGHUP}; way back: `coop lower`, `coop release`, `coop park`"),
        (True, Mode.HALT, f"{SIGHUP}; way back: `coop park`"),
        (True, Mode.APPROACH, ""),  # said at rest, where it stops nothing
    ],
)
def test_a_hold_by_a_signal_says_which(tmp_path: Path, session: bool, mode: Mode, reason: str) -> None:
    rig = Rig(tmp_path / "left.control", session=session)
    with closing(rig.control):
        rig.signals.stopped, rig.signals.stops, rig.signals.why = True, 1, SIGHUP
        for _ in range(2):
            rig.hear()
        rig.operator.mode(mode)
        assert rig.control.standing.reason == reason
        assert rig.told == [(Level.INFO, f"asked to stop: {SIGHUP}", {})]
        if session:
            rig.operator.mode(Mode.PARK)
            rig.operator.mode(Mode.HALT)
            assert rig.control.standing.reason == "", "a later stop is another's"


def test_an_arm_that_took_nothing_says_why_until_it_goes_on(tmp_path: Path) -> None:
    rig, why = Rig(tmp_path / "left.control", session=True), "the gripper closed on less: found 36.0 mm"
    with closing(rig.control):
        rig.operator.mode(Mode.APPROACH)
        rig.operator.trouble("grasp: the arm is still on its way; wait for it")
        for after in (Mode.GRASP, Mode.PARK):
            rig.operator.mode(Mode.GRASP)
            assert rig.control.standing.reason == "", "of a word before"
            rig.operator.trouble(why)
            rig.operator.mode(Mode.APPROACH)
            assert rig.control.standing.reason == why
            rig.operator.mode(after)
            assert rig.control.standing.reason == ""


@pytest.mark.parametrize(
    ("before", "after"), [(Mode.REST, Mode.APPROACH), (Mode.HALT, Mode.APPROACH), (Mode.GRASP, Mode.READY)]
)
def test_an_arm_of_a_session_that_goes_on_has_no_reason_any_more(tmp_path: Path, before: Mode, after: Mode) -> None:
    rig = Rig(tmp_path / "left.control", session=True)
    with closing(rig.control):
        rig.operator.mode(before)
        rig.operator.trouble("grasp: the arm is still on its way; wait for it")
        rig.operator.mode(after)
        assert (rig.control.standing.mode, rig.control.standing.reason) == (after, "")


def test_an_arm_that_tracks_has_no_reason(rig: Rig) -> None:
    rig.operator.mode(Mode.TRACK)
    assert rig.control.standing.reason == ""


def test_signals_say_the_same(rig: Rig) -> None:
    rig.signals.released = True
    assert rig.hear() == Event.RELEASED
    assert rig.signals.released is False
    rig.signals.stopped = True
    assert rig.hear() == rig.hear() == Event.STOP


@pytest.mark.parametrize(("after_ns", "events"), [(-1, Event.LOWER), (0, Event.LOWER), (1, Event.NONE)])
def test_the_way_down_begins_at_its_instant_and_once(rig: Rig, after_ns: int, events: Event) -> None:
    rig.control.requests.lower = Request(Verb.LOWER, start_utc_ns=OFFSET_NS + NOW_NS + after_ns)
    assert (rig.hear(), rig.hear()) == (events, Event.NONE)
    assert (rig.control.requests.lower is None) is (events is Event.LOWER)


@pytest.mark.parametrize("due", [False, True])
@pytest.mark.parametrize("by", ["signal", "host"])
def test_a_stop_by_a_signal_or_by_the_host_takes_a_way_down_back_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, by: str, due: bool
) -> None:
    monkeypatch.setattr(operated, "utc_offset_ns", lambda: OFFSET_NS)
    rig = Rig(tmp_path / "c", session=True)
    with closing(rig.control):
        rig.control.requests.lower = Request(Verb.LOWER, start_utc_ns=OFFSET_NS + NOW_NS + 10**9)
        assert rig.hear() == Event.NONE
        if due:
            rig.operator._lower_ns = NOW_NS
        if by == "host":
            rig.operator.hold("the clock may be off by 5.1 ms")
        else:
            rig.signals.stopped, rig.signals.stops = True, 1
        assert (rig.hear(), rig.hear()) == (Event.STOP, Event.NONE)
        assert rig.control.requests.lower is None
        assert ((Level.WARN, "the lowering has been taken back", {}) in rig.told) is not due
        rig.control.requests.lower = Request(Verb.LOWER, start_utc_ns=OFFSET_NS + NOW_NS)
        assert (rig.hear(), rig.hear()) == (Event.LOWER, Event.NONE), "one that is given afterwards counts"
        assert sum("lowering" in text for _, text, _ in rig.told) == (not due), "what has begun is not taken back"


def test_a_clock_that_is_set_moves_no_way_down_that_was_given(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = (Request(Verb.LOWER, start_utc_ns=OFFSET_NS + NOW_NS + after_ns) for after_ns in (10**9, 0))
    rig.control.requests.lower = first
    assert rig.hear() == Event.NONE
    monkeypatch.setattr(operated, "utc_offset_ns", lambda: OFFSET_NS + 3600 * 10**9)
    assert rig.hear() == Event.NONE, "the hour that was put on has not passed"
    monkeypatch.setattr(operated, "utc_offset_ns", lambda: OFFSET_NS)
    rig.control.requests.lower = second
    assert rig.hear() == Event.LOWER, "a new instant is mapped anew"
    rig.control.requests.lower = replace(first, start_utc_ns=second.start_utc_ns)
    assert rig.hear() == Event.LOWER, "so is the next"


MOTIONS = (Verb.APPROACH, Verb.GRASP, Verb.LOWER, Verb.PARK)


def in_one_cycle(rig: Rig, path: Path, *words: Verb) -> tuple[Event, dict[Verb, Reply]]:
    """What the loop hears when these words have come since it looked last, and what each was answered."""
    with ExitStack() as stack:
        people = [stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)) for _ in words]
        for person, word in zip(people, words, strict=True):
            person.connect(str(path))
            person.send(Request(word, "ab" * 32).encode())
        happened = rig.operator.events()
        return happened, {word: Reply.decode(own.recv(4096)) for own, word in zip(people, words, strict=True)}


def said_in_one_cycle(rig: Rig, path: Path, *words: Verb) -> Event:
    """The same of words that are all answered `ok`."""
    happened, replies = in_one_cycle(rig, path, *words)
    assert all(reply.ok for reply in replies.values())
    return happened


@pytest.mark.parametrize("stop_first", [True, False])
@pytest.mark.parametrize(
    ("mode", "word"), [(mode, word) for word in MOTIONS for mode in SESSION_MODES if SESSION[word][mode].accepted]
)
def test_a_stop_beside_a_word_of_motion_stops_the_arm_whichever_was_said_first(
    tmp_path: Path, mode: Mode, word: Verb, stop_first: bool
) -> None:
    rig = Rig(tmp_path / "c", session=True)
    standing = rig.control.standing
    standing.mode, standing.session = mode, lambda _: ""
    words = (Verb.STOP, word) if stop_first else (word, Verb.STOP)
    with closing(rig.control):
        happened = said_in_one_cycle(rig, tmp_path / "c", *words)
        assert happened == Event.STOP
        assert next_in_session(mode, happened) is SESSION[Verb.STOP][mode].becomes
        assert rig.operator.events() == Event.NONE, "the next cycle begins no motion either"
        assert said_in_one_cycle(rig, tmp_path / "c", word) == EVENT_OF[word], "said afterwards it counts"


@pytest.mark.parametrize("stop_first", [True, False])
@pytest.mark.parametrize(
    ("in_session", "mode"),
    [
        (table is SESSION, mode)
        for table in (SESSION, TABLE)
        for mode, release in table[Verb.RELEASE].items()
        if release.accepted
    ],
)
def test_a_release_that_comes_with_a_stop_lets_nothing_go_and_somebody_is_told(
    tmp_path: Path, mode: Mode, stop_first: bool, in_session: bool
) -> None:
    rig = Rig(tmp_path / "c", session=in_session)
    standing, follows = rig.control.standing, next_in_session if in_session else next_mode
    standing.mode, standing.session = mode, (lambda _: "") if in_session else None
    words = [Verb.STOP, Verb.RELEASE] if stop_first else [Verb.RELEASE, Verb.STOP]
    with closing(rig.control):
        happened, replies = in_one_cycle(rig, tmp_path / "c", *words)
        assert happened == Event.STOP
        assert follows(mode, happened) is (SESSION if in_session else TABLE)[Verb.STOP][mode].becomes
        assert replies[Verb.STOP].ok
        assert replies[Verb.RELEASE].ok is not stop_first
        lost: list[Any] = [(Level.WARN, "a stop wins over the release that came with it: say it again", {})]
        assert rig.told == ([] if stop_first else lost)


@pytest.mark.parametrize("in_session", [True, False])
def test_a_stop_by_a_signal_wins_over_a_release_of_the_same_cycle_where_the_arm_holds(
    tmp_path: Path, in_session: bool
) -> None:
    rig = Rig(tmp_path / "c", session=in_session)
    rig.control.standing.mode = Mode.HOLD
    with closing(rig.control):
        for _ in range(2):
            rig.signals.stopped, rig.signals.stops, rig.signals.why = True, rig.signals.stops + 1, "SIGINT: Ctrl-C"
            rig.signals.released = True
            assert rig.hear() == Event.STOP
            assert rig.told == [
                (Level.INFO, "asked to stop: SIGINT: Ctrl-C", {}),
                (Level.WARN, "a stop wins over the release that came with it: say it again", {}),
            ]
            rig.told.clear()
            rig.signals.released = True
            assert Event.RELEASED in rig.hear(), "said again, it counts"
            assert not rig.told


@pytest.mark.parametrize("mode", [Mode.READY, Mode.LOWER, Mode.HOLD])
def test_a_release_behind_a_stop_is_refused_until_the_arm_holds(tmp_path: Path, mode: Mode) -> None:
    rig = Rig(tmp_path / "c", session=True)
    standing = rig.control.standing
    standing.mode, standing.session = mode, lambda _: ""
    with closing(rig.control):
        happened, replies = in_one_cycle(rig, tmp_path / "c", Verb.STOP, Verb.RELEASE)
        refusal = replies[Verb.RELEASE].refusal
        assert refusal["found"] == f"arm left in {mode.name}: a stop that it has yet to act on"
        assert refusal["remedy"] == "see that the object is supported, and say it again"
        standing.mode = next_in_session(mode, happened)
        assert standing.mode is Mode.HOLD
        assert next_in_session(Mode.HOLD, said_in_one_cycle(rig, tmp_path / "c", Verb.RELEASE)) is Mode.RELEASE


def test_a_release_that_comes_with_the_way_down_lets_go_and_nobody_is_told_that_it_is_lost(tmp_path: Path) -> None:
    rig = Rig(tmp_path / "c", session=True)
    rig.control.standing.mode = Mode.HOLD
    with closing(rig.control):
        happened = rig.hear(Verb.LOWER, Verb.RELEASE)
        assert happened == Event.LOWER | Event.RELEASED
        assert next_in_session(Mode.HOLD, happened) is Mode.RELEASE
        assert not rig.told


@pytest.mark.parametrize("session", [True, False])
def test_a_signal_and_a_reason_of_the_host_in_one_cycle_are_a_stop(tmp_path: Path, session: bool) -> None:
    rig = Rig(tmp_path / "c", session=session)
    with closing(rig.control):
        rig.operator.hold("the clock may be off by 5.1 ms")
        rig.signals.stopped, rig.signals.stops = True, 1
        assert rig.hear() == Event.STOP
        assert not rig.operator.is_pressed()


def test_an_arm_that_was_stopped_is_not_held_once_more_by_its_host(rig: Rig) -> None:
    assert rig.hear(Verb.STOP) == Event.STOP
    rig.operator.hold("the clock may be off by 5.1 ms")
    assert rig.told == []
    rig.operator.mode(Mode.HOLD)
    assert rig.control.standing.reason == "it was asked to"


@pytest.mark.parametrize("by", ["signal", "host", "guard"])
def test_a_release_in_the_cycle_of_another_stop_is_said_to_be_lost(tmp_path: Path, by: str) -> None:
    rig = Rig(tmp_path / "c", session=True)
    rig.control.standing.mode = Mode.READY
    with closing(rig.control):
        if by == "host":
            rig.operator.hold("the clock may be off by 5.1 ms")
        elif by == "guard":
            rig.operator._watch = lambda: "the guard is gone"
        else:
            rig.signals.stopped, rig.signals.stops = True, 1
        assert next_in_session(Mode.READY, rig.hear(Verb.RELEASE)) is Mode.HOLD
        assert rig.told[-1][1] == "a stop wins over the release that came with it: say it again"
        rig.control.standing.mode = Mode.HOLD
        rig.told.clear()
        assert next_in_session(Mode.HOLD, rig.hear(Verb.RELEASE)) is Mode.RELEASE
        assert not rig.told


@pytest.mark.parametrize("word", MOTIONS)
@pytest.mark.parametrize("by", ["signal", "host"])
def test_a_stop_by_a_signal_or_by_the_host_wins_over_a_word_of_the_same_cycle(
    tmp_path: Path, word: Verb, by: str
) -> None:
    rig = Rig(tmp_path / "c", session=True)
    with closing(rig.control):
        if by == "host":
            rig.operator.hold("the clock may be off by 5.1 ms")
        else:
            rig.signals.stopped, rig.signals.stops = True, 1
        assert (rig.hear(word), rig.hear(word)) == (Event.STOP, EVENT_OF[word])


def test_in_a_session_every_stop_is_said_once_for_the_arm_goes_on_from_it(tmp_path: Path) -> None:
    rig = Rig(tmp_path / "c", session=True)
    with closing(rig.control):
        assert (rig.hear(Verb.STOP), rig.hear()) == (Event.STOP, Event.NONE)
        for _ in range(2):  # a second signal stops the way back
            rig.signals.stopped, rig.signals.stops, rig.signals.why = True, rig.signals.stops + 1, "SIGINT: Ctrl-C"
            assert (rig.hear(), rig.hear()) == (Event.STOP, Event.NONE)
        for _ in range(2):
            rig.operator.hold("the clock may be off by 5.1 ms")
        assert (rig.hear(), rig.hear()) == (Event.STOP, Event.NONE)
        asked = ["asked to stop: SIGINT: Ctrl-C"] * 2
        assert [text for _, text, _ in rig.told] == [*asked, "holds: the clock may be off by 5.1 ms"]


def test_in_a_session_the_clock_holds_the_next_carry_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(operated, "utc_offset_ns", lambda: OFFSET_NS)
    rig, bound = Rig(tmp_path / "c", session=True), "the clock may be off by 5.1 ms"
    with closing(rig.control):
        for carry in range(1, 4):
            rig.control.requests.start = Request(Verb.START, "", OFFSET_NS + carry)
            rig.operator.start_ns()
            assert rig.hear() == Event.NONE, "a new start is no stop"
            for _ in range(2):
                rig.operator.hold(bound)
                rig.operator.start_ns()
            assert (rig.hear(), rig.hear()) == (Event.STOP, Event.NONE)
        assert [text for _, text, _ in rig.told if "holds" in text] == [f"holds: {bound}"] * 3


@pytest.mark.parametrize("by", ["signal", "word"])
@pytest.mark.parametrize("drops", [False, True])
def test_a_stop_of_a_session_holds_and_is_said_once_where_nothing_can_fall_too(
    tmp_path: Path, by: str, *, drops: bool
) -> None:
    """A guard on emulated servos, in the place of an agent that holds: in HOLD a release would not end it."""
    rig = Rig(tmp_path / "c", session=True, drops_on_stop=drops)
    rig.control.standing.mode = Mode.HOLD
    with closing(rig.control):
        assert rig.operator.drops_on_stop is False
        for _ in range(2):
            if by == "signal":
                rig.signals.stopped, rig.signals.stops = True, rig.signals.stops + 1
            words = [Verb.STOP] if by == "word" else []
            assert (rig.hear(*words), rig.hear()) == (Event.STOP, Event.NONE)
            assert not rig.operator.is_pressed()
        assert rig.hear(Verb.RELEASE) == Event.RELEASED


def test_an_operator_is_pressed_until_a_cycle_has_heard_what_was_said(rig: Rig, tmp_path: Path) -> None:
    """By which a simulated arm ends its waiting for others; a holding one waits for them again afterwards."""
    pressed = rig.operator.is_pressed
    assert not pressed()
    rig.signals.stopped, rig.signals.stops = True, 1
    assert pressed()
    assert rig.hear() == Event.STOP
    assert not pressed()
    rig.signals.released = True
    assert pressed()
    rig.hear()
    rig.control.requests.words.append(Verb.RELEASE)
    assert pressed()
    rig.hear()
    assert not pressed()
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as person:
        person.connect(os.fspath(tmp_path / "left.control"))
        person.send(Request(Verb.STOP, "ab" * 32).encode())
        assert pressed(), "a word that has come is looked for, for no cycle may come that does"


def test_the_process_of_a_simulated_arm_that_was_stopped_is_pressed_until_it_ends(tmp_path: Path) -> None:
    rig = Rig(tmp_path / "c", drops_on_stop=True)
    with closing(rig.control):
        assert rig.hear(Verb.STOP) == Event.STOP | Event.RELEASED
        assert rig.operator.is_pressed()
        without = Operator(rig.signals, None, Clock(), rig._tell, drops_on_stop=True)
        assert not without.is_pressed()
        rig.signals.stopped = True
        assert without.is_pressed()


def test_where_nothing_can_fall_a_stop_releases(tmp_path: Path) -> None:
    rig = Rig(tmp_path / "c", drops_on_stop=True)
    with closing(rig.control):
        assert rig.hear() == Event.NONE
        assert rig.hear(Verb.STOP) == rig.hear() == Event.STOP | Event.RELEASED
        assert rig.hear(Verb.STOP, Verb.RELEASE) == Event.STOP | Event.RELEASED
        assert not rig.told, "no release is lost there"


@pytest.mark.fault("C3")
def test_a_start_is_mapped_once_replaced_by_a_later_one_and_taken_back(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert rig.operator.start_ns() is None
    rig.control.requests.start = Request(Verb.START, "", OFFSET_NS + 7, clock_bound_s=3e-4)
    assert rig.operator.start_ns() == 7
    monkeypatch.setattr(operated, "utc_offset_ns", lambda: OFFSET_NS - 1_000_000_000)  # somebody sets the wall clock
    assert rig.operator.start_ns() == 7
    rig.control.requests.start = Request(Verb.START, "", OFFSET_NS + 9)
    assert rig.operator.start_ns() == 1_000_000_009
    rig.control.requests.start = None
    assert rig.operator.start_ns() is None
    assert rig.operator.start_ns() is None
    (first, second, third) = rig.told
    assert first == (
        Level.INFO, "start given: 22:13:20.000000 UTC, clock off by at most 0.3 ms", {"clock_bound_s": 3e-4}
    )  # fmt: skip
    assert (second[1].endswith("clock not synchronised"), second[2]) == (True, {})
    assert third == (Level.WARN, "the start has been taken back", {})


def test_a_start_tells_the_watch_over_the_clock_what_its_giver_knew(rig: Rig) -> None:
    rig.operator.clock = ClockWatch(lambda: NOW_NS, rig.operator.hold, 1, lambda: UNKNOWN)
    rig.control.requests.start = Request(Verb.START, "", OFFSET_NS + 7, clock_bound_s=3e-4)
    rig.operator.start_ns()
    assert rig.operator.clock.bound_s == 3e-4


def test_what_else_watches_over_the_arm_is_trouble(rig: Rig) -> None:
    gone = [""]
    operator = Operator(rig.signals, None, Clock(), rig._tell, drops_on_stop=True, watch=lambda: gone[0])
    assert (operator.events(), operator.watched) == (Event.NONE, "")
    gone[0] = "the guard is gone"
    assert (operator.events(), operator.watched) == (Event.TROUBLE, "the guard is gone")
    gone[0] = ""
    assert (operator.events(), operator.watched) == (Event.NONE, "")
    assert operator.start_ns() is None


def test_why_an_arm_holds_is_answered(rig: Rig) -> None:
    standing = rig.control.standing
    rig.operator.mode(Mode.HOLD)
    assert (standing.mode, standing.reason) == (Mode.HOLD, "the trajectory has ended")
    rig.operator.trouble("t = 3 s: OFF_TRACK")
    assert standing.reason == "t = 3 s: OFF_TRACK"
    rig.hear(Verb.STOP)
    rig.operator.mode(Mode.HOLD)
    assert standing.reason == "it was asked to"


def test_a_reason_of_this_host_holds_the_arm_and_is_told_once(rig: Rig) -> None:
    for _ in range(2):
        rig.operator.hold("the clock may be off by 5.1 ms")
    assert rig.hear() == Event.STOP
    rig.operator.mode(Mode.HOLD)
    assert rig.control.standing.reason == "the clock may be off by 5.1 ms"
    assert rig.told == [(Level.WARN, "holds: the clock may be off by 5.1 ms", {})]


@pytest.mark.parametrize(
    ("kind", "emulated", "priority", "allowed", "starts", "taken_up_s"),
    [
        (DriverKind.DYNAMIXEL, False, None, False, False, 0.0),
        (DriverKind.DYNAMIXEL, False, None, True, True, 0.0),
        (DriverKind.DYNAMIXEL, False, "SCHED_FIFO", False, True, 0.0),
        (DriverKind.DYNAMIXEL, False, "SCHED_FIFO", False, True, 2.5),
        (DriverKind.DYNAMIXEL, True, None, False, True, 2.5),
        (DriverKind.SIM, False, None, False, True, 0.0),
    ],
)
def test_only_a_real_arm_without_real_time_refuses_a_start_unless_that_is_allowed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: DriverKind, emulated: bool, priority: str | None,
    allowed: bool, starts: bool, taken_up_s: float,
) -> None:  # fmt: skip
    """taken_up_s: in which an arm with a session takes its load up, before its torque at rest tells anything."""
    monkeypatch.setattr(agent, "granted", lambda: RealTime(priority or "SCHED_OTHER", 0, 0))
    monkeypatch.setattr(agent, "newest", lambda _: None)
    told: list[tuple[str, dict[str, Any]]] = []
    teller: Any = type("Teller", (), {"event": staticmethod(lambda _, text, **data: told.append((text, data)))})
    options = AgentOptions(
        cell=Path(), arm="left", driver=kind, emulated=emulated, ring=tmp_path, control=None, real_time=True, hold=True,
        allow_no_realtime=allowed,
    )  # fmt: skip
    cell = load_cell(configs.CELLS_DIR / "two_wx200.toml", [f"session.take_up_s={taken_up_s}"] if taken_up_s else [])
    rig = Rig(tmp_path / "left.control")
    standing = rig.control.standing
    with closing(rig.control), RingWriter(tmp_path / "ring", AGENT_STATE, "left", ("waist",)) as ring:
        agent._stand(standing, options, rig.operator, ring, teller, cell, None)
        assert standing.mode is Mode.READY
        assert (standing.no_start is None) is starts
        assert standing.rest_s == (1.1 + taken_up_s if kind is DriverKind.DYNAMIXEL and not emulated else 0.0)
        assert standing.ready_ns > 0
        assert standing.details()["tick"]["cycles"] == 0
        assert standing.details()["no_start"] == standing.no_start
        assert standing.details()["drops_on_stop"] is False
        assert standing.details()["ring"] == str(tmp_path), "where `coop status` reads what it does"
    assert standing.no_start is None or "--allow-no-realtime" in standing.no_start["remedy"]
    ((text, data),) = told
    assert text == f"real time: {priority or 'SCHED_OTHER'} 0, 0 MB of memory locked; latency: not tested"
    assert data == {"policy": priority or "SCHED_OTHER", "priority": 0, "locked_bytes": 0}


def test_an_agent_in_lockstep_starts_by_itself_and_says_nothing_of_its_host(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(agent, "newest", lambda _: None)
    told: list[str] = []
    teller: Any = type("Teller", (), {"event": staticmethod(lambda _, text, **__: told.append(text))})
    options = AgentOptions(
        cell=Path(), arm="left", driver=DriverKind.SIM, ring=tmp_path, control=None, hold=False
    )  # fmt: skip
    rig = Rig(tmp_path / "left.control", drops_on_stop=True)
    with closing(rig.control), RingWriter(tmp_path / "ring", AGENT_STATE, "left", ("waist",)) as ring:
        agent._stand(
            rig.control.standing, options, rig.operator, ring, teller, load_cell(configs.CELLS_DIR / "paper.toml"), None
        )
        assert rig.control.standing.details()["no_start"] is None
        assert rig.control.standing.details()["drops_on_stop"] is True, "as the operator does what it says"
        refused = rig.control._no_start(Request(Verb.START, rig.control._fingerprint, time.time_ns() + 10**12))
    assert refused is not None
    assert refused.refusal["found"] == "an agent in lockstep"
    assert "it starts by itself" in refused.refusal["remedy"]
    assert told == []


def test_the_details_of_an_answer_fit_into_it(rig: Rig) -> None:
    rig.control.standing.details = lambda: {"pid": os.getpid(), "tick": {"cycles": 10**12, "late_s": 1e-300}}
    rig.control.standing.reason = "x" * 5000
    assert len(rig.control._refused("f" * 80, "e", "r").encode()) < 4096
    assert json.loads(rig.control._reply(ok=True).encode())["reason"] == "x" * 399 + "…"


def test_what_a_cycle_without_a_state_did_not_do_has_no_duration_in_an_answer() -> None:
    row = np.zeros((), AGENT_STATE.dtype)
    row["late_s"], row["read_s"], row["step_s"], row["write_s"] = 1e-3, 2e-3, np.nan, np.inf
    ring: Any = SimpleNamespace(row=row, written=7)
    assert tick_of(ring) == {"cycles": 7, "late_s": 1e-3, "read_s": 2e-3, "step_s": None, "write_s": None}
