"""C5: two operators give instants at nearly one moment, and their words reach the arms in whichever order."""

from __future__ import annotations

import random
import socket
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path

import pytest

from agent.modes import Mode
from agent.operator import socket as control_socket
from agent.operator import words
from agent.operator.ask import Heard, Silence
from agent.operator.error import ControlError
from agent.operator.message import Reply, Request
from agent.operator.promise import HELD_NS, Promise
from agent.operator.socket import ControlSocket, Standing
from agent.operator.table import Verb
from agent.operator.words import start_together
from tests.support.operated_arms import OWN, PATIENT_S, cell_of, serving

LATER_NS = 10**15
Step = tuple[int, Request]  # a word on its way to an arm


class Clock:
    """CLOCK_MONOTONIC of the arms."""

    def __init__(self) -> None:
        self.now_ns = 1

    def monotonic_ns(self) -> int:
        return self.now_ns


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(control_socket, "time", made)
    monkeypatch.setattr(control_socket, "utc_offset_ns", lambda: 0)
    return made


class Operator:
    """Asks all, then tells all, as `start_together` does, while its words are on their way one by one."""

    def __init__(self, arms: Sequence[ControlSocket], start_ns: int, asked_ns: int) -> None:
        self.request = Request(Verb.START, OWN, start_ns, token=str(start_ns), asked_ns=asked_ns)
        self.told: bool | None = None  # whether its start counts
        self.given = False  # to all, at some time
        self._arms = arms
        self._steps = self._says()
        self.pending: list[Step] = next(self._steps)
        self.heard: dict[int, Reply] = {}

    def asks_from(self, now_ns: int) -> None:
        self.request = replace(self.request, asked_ns=now_ns)
        self.pending = [(arm, replace(self.request, prepare=True)) for arm, _ in self.pending]

    def deliver(self, which: int) -> None:
        arm, request = self.pending.pop(which)
        self.heard[arm] = self._arms[arm]._answer(request.encode(), 0)
        if not self.pending:
            self.pending = next(self._steps, [])

    def _says(self) -> Iterator[list[Step]]:
        everybody = range(len(self._arms))
        yield [(arm, replace(self.request, prepare=True)) for arm in everybody]
        agreed = [arm for arm, reply in self.heard.items() if reply.ok]
        if len(agreed) < len(self._arms):
            self.told = False
            yield [(arm, Request(Verb.CANCEL, prepare=True, token=self.request.token)) for arm in agreed]
            return
        yield [(arm, self.request) for arm in everybody]
        self.told = all(reply.ok for reply in self.heard.values())
        if not self.told:
            yield [(arm, Request(Verb.CANCEL, token=self.request.token)) for arm in everybody]


@pytest.mark.fault("C5")
@pytest.mark.parametrize("waits", [False, True], ids=["at once", "with pauses"])
@pytest.mark.parametrize("before", [False, True], ids=["first", "behind an earlier start"])
def test_no_two_arms_ever_have_the_instants_of_two_operators(
    tmp_path: Path, clock: Clock, before: bool, waits: bool
) -> None:
    """waits: longer than an arm keeps to what it agreed to."""
    won = lost = 0
    for seed in range(300):
        chance = random.Random(seed)
        with ExitStack() as stack:
            arms = [
                stack.enter_context(closing(ControlSocket(tmp_path / name, OWN, Standing(name, Mode.READY))))
                for name in "ab"
            ]
            if before:
                first = Operator(arms, LATER_NS, clock.now_ns)
                while first.pending:
                    first.deliver(0)
                assert first.told
            both = [Operator(arms, LATER_NS + k, clock.now_ns) for k in (1, 2)]
            last = LATER_NS if before else None  # what was told to be given last, if anything
            while any(operator.pending for operator in both):
                one = chance.choice([operator for operator in both if operator.pending])
                done = one.told
                one.deliver(chance.randrange(len(one.pending)))
                if one.told and done is None:
                    last = one.request.start_utc_ns
                if waits and chance.random() < 0.15:
                    clock.now_ns += HELD_NS // 2
                for operator in both:
                    if not operator.heard:  # its first word leaves only now
                        operator.asks_from(clock.now_ns)
            starts = {arm.requests.start and arm.requests.start.start_utc_ns for arm in arms}
            assert len(starts) == 1, f"{seed}: arms move at two instants"
            told = [operator for operator in both if operator.told]
            if told and waits:  # a start that was to replace it, and came too late, took it back
                assert starts <= {last, None}
            elif told:
                assert starts == {last}, f"{seed}: who was told that the arms start was told what is so"
            else:
                assert starts <= {None, LATER_NS if before else None}
            won, lost = won + len(told), lost + 2 - len(told)
    assert won > 0
    assert lost > 0


@pytest.mark.fault("C5")
def test_who_comes_second_is_refused_in_one_line_and_the_first_start_counts(tmp_path: Path) -> None:
    arms = cell_of(tmp_path / "cell", (Mode.READY, Mode.READY))
    where = {arm.path.stem: [arm.path] for arm in arms}
    first, second = (Request(Verb.START, OWN, 10**18 * 9 + k) for k in range(2))
    first = replace(first, token="first", asked_ns=time.monotonic_ns())
    with serving(arms):
        words._ask_first(where, first, PATIENT_S)
        with pytest.raises(ControlError) as raised:
            start_together(where, second, PATIENT_S)
        heard = words.ask_arms(where, first, PATIENT_S)
        start_together(where, second, PATIENT_S)
        assert all(isinstance(reply, Reply) and reply.ok for reply in heard.values())
    found = "another instant that is just being given, expected one operator at a time, say it again"
    one = f"refuses in READY: {found}"
    assert f"found a: {one}; b: {one}" in str(raised.value)
    assert "no arm has been told" in str(raised.value)
    assert "\n" not in str(raised.value)
    for arm in arms:
        assert arm.control is not None
        assert arm.control.requests.start is not None
        assert arm.control.requests.start.start_utc_ns == second.start_utc_ns, "the second one, said again"


def test_who_is_refused_by_one_arm_leaves_the_others_free_for_the_next(tmp_path: Path) -> None:
    arms = cell_of(tmp_path / "cell", (Mode.READY, Mode.HOLD))
    with serving(arms):
        for _ in range(2):
            with pytest.raises(ControlError) as raised:
                start_together({arm.path.stem: [arm.path] for arm in arms}, Request(Verb.START, OWN, 9 * 10**18))
            assert "found b: refuses in HOLD" in str(raised.value)
        start_together({"a": [arms[0].path]}, Request(Verb.START, OWN, 9 * 10**18))


@pytest.mark.parametrize("word", [Verb.STOP, Verb.RELEASE])
def test_an_instant_that_was_agreed_to_before_a_stop_is_not_taken_after_it(
    tmp_path: Path, clock: Clock, word: Verb
) -> None:
    mode = Mode.READY if word is Verb.STOP else Mode.HOLD
    standing = Standing("a", mode, session=lambda _: "")
    with closing(ControlSocket(tmp_path / "a", OWN, standing)) as arm:
        verb = Verb.START if word is Verb.STOP else Verb.LOWER
        request = Request(verb, OWN, LATER_NS, token="mine", asked_ns=clock.now_ns)
        assert arm._answer(replace(request, prepare=True).encode(), 0).ok
        assert arm._answer(Request(word).encode(), 0).ok
        refused = arm._answer(request.encode(), 0)
        assert refused.refusal["found"] == "an instant that it was not asked for"


@pytest.mark.parametrize("token", ["", "theirs"])
def test_an_instant_without_the_token_that_was_agreed_to_is_refused(tmp_path: Path, clock: Clock, token: str) -> None:
    with closing(ControlSocket(tmp_path / "a", OWN, Standing("a", Mode.READY))) as arm:
        request = Request(Verb.START, OWN, LATER_NS, token="mine", asked_ns=clock.now_ns)
        assert not arm._answer(request.encode(), 0).ok, "it was not asked"
        assert arm._answer(replace(request, prepare=True).encode(), 0).ok
        assert not arm._answer(replace(request, token=token).encode(), 0).ok
        assert arm.requests.start is None
        assert arm._answer(request.encode(), 0).ok
        assert not arm._answer(request.encode(), 0).ok, "once"


def test_a_promise_is_kept_for_twice_the_time_of_an_answer_from_when_it_was_asked_for() -> None:
    promise, held_ns = Promise(), 4_000_000_000
    assert promise.agree("a", 7, 1000)
    assert promise.agree("a", 7, 1001), "asked again"
    assert not promise.agree("b", 1001, 7 + held_ns - 1)
    assert promise.covers("a", 7 + held_ns - 1)
    assert not promise.covers("b", 8)
    assert not promise.covers("a", 7 + held_ns)
    assert not promise.agree("c", 7, 7 + held_ns), "too late"
    assert promise.agree("b", 1001, 7 + held_ns)
    assert not promise.covers("a", 8)
    promise.forget("a")
    assert promise.covers("b", 9)
    promise.forget("b")
    assert not promise.covers("b", 9)
    promise.agree("d", 9, 9)
    promise.give()
    assert not promise.covers("", 10), "nobody has none"


def test_nobody_is_agreed_with_for_longer_by_a_clock_that_is_ahead() -> None:
    promise = Promise()
    assert promise.agree("a", 10**18, 5)
    assert promise.covers("a", 5 + 3_999_999_999)
    assert not promise.covers("a", 5 + 4_000_000_000)


def test_what_is_taken_back_was_given_last_or_asked_for_since() -> None:
    promise = Promise()
    assert not promise.concerns("a")
    promise.agree("a", 5, 5)
    assert promise.concerns("a")
    promise.agree("b", 5 * 10**9, 5 * 10**9)
    promise.give()
    assert [promise.concerns(token) for token in ("a", "b", "c", "")] == [False, True, False, True]


def test_of_those_who_asked_and_gave_nothing_the_last_ones_are_remembered() -> None:
    promise, now_ns = Promise(), 0
    for i in range(65):
        for _ in range(3):  # who asks again counts once
            assert promise.agree(f"{i}", now_ns, now_ns)
        now_ns += HELD_NS
    assert not promise.concerns("0")
    assert all(promise.concerns(f"{i}") for i in range(1, 65))


def test_an_instant_that_was_taken_back_is_not_taken_again(tmp_path: Path, clock: Clock) -> None:
    with closing(ControlSocket(tmp_path / "a", OWN, Standing("a", Mode.READY))) as arm:
        request = Request(Verb.START, OWN, LATER_NS, token="mine", asked_ns=clock.now_ns)
        assert arm._answer(replace(request, prepare=True).encode(), 0).ok
        assert arm._answer(Request(Verb.CANCEL, token="mine").encode(), 0).ok
        assert not arm._answer(request.encode(), 0).ok


@pytest.mark.parametrize("refuses", ["when it is asked", "when it is given"])
def test_all_that_is_said_of_one_start_has_one_token_and_no_other_start_has_it(
    monkeypatch: pytest.MonkeyPatch, refuses: str
) -> None:
    said: list[Request] = []

    def ask_arms(arms: Mapping[str, object], request: Request, timeout_s: float, _: object) -> dict[str, Heard]:
        said.append(request)
        willing = Reply(True, "a", Mode.READY.name, fingerprint=OWN)
        fails = request.verb is Verb.START and request.prepare is (refuses == "when it is asked")
        return {arm: Silence("hangs") if fails and arm == "b" else willing for arm in arms}

    monkeypatch.setattr(words, "ask_arms", ask_arms)
    for _ in range(2):
        with pytest.raises(ControlError, match="b: does not answer"):
            start_together({"a": [], "b": []}, Request(Verb.START, OWN, 9 * 10**18), PATIENT_S)
    each = len(said) // 2
    tokens = [{request.token for request in half} for half in (said[:each], said[each:])]
    assert [len(one) for one in tokens] == [1, 1]
    assert tokens[0] != tokens[1]
    assert said[each - 1].verb is Verb.CANCEL
    assert said[each - 1].prepare is (refuses == "when it is asked"), "nothing was given: an earlier start stays"


def test_a_word_for_at_once_leaves_an_instant_that_was_agreed_to(tmp_path: Path, clock: Clock) -> None:
    with closing(ControlSocket(tmp_path / "a", OWN, Standing("a", Mode.HOLD, session=lambda _: ""))) as arm:
        later = Request(Verb.LOWER, OWN, LATER_NS, token="one", asked_ns=clock.now_ns)
        said = [replace(later, prepare=True), Request(Verb.LOWER, OWN), later]
        assert [arm._answer(request.encode(), 0).ok for request in said] == [True, True, True]


def test_who_has_hung_up_waits_no_more() -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        assert control_socket._waits(ours), "it says nothing, and is there"
        ours.send(b"unread")
        theirs.close()
        assert control_socket._waits(ours) is False, "it went without having read what it was told"
        assert control_socket._waits(ours) is False
