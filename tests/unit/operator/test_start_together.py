"""C5: a start that fails between its two halves, and what is told of an arm that says nothing."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from agent.modes import Mode
from agent.operator import ask, words
from agent.operator.error import ControlError
from agent.operator.message import Reply, Request
from agent.operator.socket import ControlSocket
from agent.operator.table import Verb
from agent.operator.words import start_together
from tests.support.operated_arms import ABSENT, DEAD, HUNG, OTHER, OWN, PATIENT_S, QUICK_S, Arm, cell_of, serving


def started_with(folder: Path, wakes: Callable[[ControlSocket], None]) -> tuple[str, list[Arm]]:
    """A start to two READY arms, of which the second does `wakes` before each poll."""
    arms = cell_of(folder, (Mode.READY, Mode.READY))
    arms[1].wakes = wakes
    request = Request(Verb.START, OWN, time.time_ns() + 10**12)
    with serving(arms), pytest.raises(ControlError) as raised:
        start_together({arm.path.stem: [arm.path] for arm in arms}, request, PATIENT_S)
    return str(raised.value), arms


def test_when_one_refuses_the_instant_it_had_agreed_to_the_others_are_told_to_forget_it(tmp_path: Path) -> None:
    modes = [Mode.READY]

    def answers_once_ready() -> dict[str, Any]:
        modes[0] = Mode.HOLD
        return {}

    def wakes(control: ControlSocket) -> None:
        control.standing.details = answers_once_ready
        control.standing.mode = modes[0]

    told, (first, second) = started_with(tmp_path / "cell", wakes)
    assert "b: refuses in HOLD" in told
    assert "the start was taken back (a: does not begin; b: does not begin)" in told
    assert first.heard == second.heard == (False, [])


def test_an_arm_that_has_started_by_then_is_stopped(tmp_path: Path) -> None:
    arms = cell_of(tmp_path / "cell", (Mode.READY, Mode.READY))
    ready = [True]

    def first(control: ControlSocket) -> None:
        if control.requests.start is not None:
            control.standing.mode = Mode.TRACK

    def answered() -> dict[str, Any]:
        ready[0] = False
        return {}

    def second(control: ControlSocket) -> None:
        control.standing.details = answered
        control.standing.mode = Mode.READY if ready[0] else Mode.FAULT

    arms[0].wakes, arms[1].wakes = first, second
    request = Request(Verb.START, OWN, time.time_ns() + 10**12)
    with serving(arms), pytest.raises(ControlError, match="a: had begun, holds now; b: does not begin"):
        start_together({arm.path.stem: [arm.path] for arm in arms}, request, PATIENT_S)
    assert arms[0].heard == (False, [Verb.STOP])


@pytest.mark.fault("C5")
def test_an_agent_that_hangs_at_the_instant_finds_the_start_taken_back_when_it_wakes(tmp_path: Path) -> None:
    arms = cell_of(tmp_path / "cell", (Mode.READY, Mode.READY))
    asleep = threading.Event()

    def answered() -> dict[str, Any]:
        asleep.set()
        return {}

    def sleeps(control: ControlSocket) -> None:
        control.standing.details = answered
        if asleep.is_set():
            arms[1].control, sleeping[0] = None, control

    sleeping: list[ControlSocket] = [None]  # type: ignore[list-item]
    arms[1].wakes = sleeps
    request = Request(Verb.START, OWN, time.time_ns() + 10**12)
    with serving(arms, in_turns=True):
        with pytest.raises(ControlError) as raised:
            start_together({arm.path.stem: [arm.path] for arm in arms}, request, QUICK_S)
        sleeping[0].poll()
        sleeping[0].close()
    assert "b: does not answer (no answer within 0.04 s)" in str(raised.value)
    assert "a: does not begin; b: NOT KNOWN, it does not answer" in str(raised.value)
    assert sleeping[0].requests.start is None
    assert arms[0].heard == (False, [])


@pytest.mark.fault("C5")
@pytest.mark.parametrize("given", [False, True])
def test_a_stop_that_comes_while_an_arm_says_nothing_counts_at_once_and_nobody_keeps_the_start(
    given: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """given: the other arm has the instant by then, or else has only agreed to it."""
    arms = cell_of(tmp_path / "cell", (Mode.READY, Mode.READY))
    sleeping: list[ControlSocket] = []
    monkeypatch.setattr(words, "FORGET_S", QUICK_S)

    def sleeps(control: ControlSocket) -> None:
        if not given or control._promise._token:
            arms[1].control = None
            sleeping.append(control)

    def look() -> None:
        control = arms[0].control
        if control is not None and (control.requests.start if given else control._promise._token):
            raise KeyboardInterrupt

    arms[1].wakes = sleeps
    request = Request(Verb.START, OWN, time.time_ns() + 10**12)
    with serving(arms, in_turns=True):
        with pytest.raises(KeyboardInterrupt):
            start_together({arm.path.stem: [arm.path] for arm in arms}, request, 50 * QUICK_S, look)
        sleeping[0].poll()
        sleeping[0].close()
        control = arms[0].control
        assert control is not None
        assert not control._promise._token, "the next operator need not wait"
    assert arms[0].heard == (False, [])
    assert sleeping[0].requests.start is None


@pytest.mark.parametrize(("broken_off", "prepare"), [(1, True), (2, False), (3, False)])
def test_what_is_broken_off_is_taken_back_as_far_as_it_went(
    broken_off: int, prepare: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Asked for, given, or refused and being taken back: of what was only asked for, an earlier start stays."""
    said: list[Request] = []

    def look() -> None:
        if len(said) == broken_off:
            raise KeyboardInterrupt

    def ask_arms(_: object, request: Request, __: float, heeds: Callable[[], None] | None = None) -> dict[str, Reply]:
        said.append(request)
        if heeds is not None:
            heeds()
        return {"a": Reply(request.prepare, "a", "READY", "", OWN, dict.fromkeys(("found", "expected", "remedy"), ""))}

    monkeypatch.setattr(words, "ask_arms", ask_arms)
    with pytest.raises(KeyboardInterrupt):
        start_together({"a": []}, Request(Verb.START, OWN, 9 * 10**18), look=look)
    assert said[-1] == Request(Verb.CANCEL, prepare=prepare, token=said[0].token)
    assert len(said) == broken_off + 1


@pytest.mark.fault("C5")
def test_answers_that_come_too_late_for_the_instant_start_nobody(tmp_path: Path) -> None:
    arms = cell_of(tmp_path / "cell", (Mode.READY, Mode.READY))
    request = Request(Verb.START, OWN, time.time_ns() + 10**12)

    class Late:
        """A clock by which the answers took until just before the instant."""

        @staticmethod
        def time_ns() -> int:
            return request.start_utc_ns - 49_999_999

        monotonic_ns = time.monotonic_ns

    with serving(arms), pytest.MonkeyPatch.context() as patch:
        patch.setattr(words, "time", Late)
        with pytest.raises(ControlError, match=r"start: found .* UTC, expected at least 0.05 s from now; choose"):
            start_together({arm.path.stem: [arm.path] for arm in arms}, request, PATIENT_S)
    assert [arm.heard for arm in arms] == [(False, [])] * 2


@pytest.mark.parametrize(("left_s", "waits_s"), [((0.3, 0.3, 0.16), 0.16), ((0.3, 0.3, -0.1), 0.05)])
@pytest.mark.fault("C5")
def test_half_of_the_time_until_the_instant_is_kept_for_taking_the_start_back(
    monkeypatch: pytest.MonkeyPatch, left_s: tuple[float, ...], waits_s: float
) -> None:
    """left_s: until the instant, each time that somebody looks; waits_s: for those who are told to forget it."""
    start_ns, asked, left = 10**18, list[tuple[Verb, bool, float]](), iter(left_s)

    def ask_arms(arms: Any, request: Request, timeout_s: float, _: object) -> dict[str, ask.Heard]:
        asked.append((request.verb, request.prepare, timeout_s))
        hangs = request.verb is Verb.START and not request.prepare
        willing = Reply(True, "", "READY", "", OWN)
        return {"a": willing, "b": ask.Silence("no answer", hung=True) if hangs else willing}

    monkeypatch.setattr(words, "ask_arms", ask_arms)
    clock = SimpleNamespace(time_ns=lambda: start_ns - round(next(left) * 1e9), monotonic_ns=lambda: 7)
    monkeypatch.setattr(words, "time", clock)
    with pytest.raises(ControlError, match="b: does not answer"):
        start_together({"a": [], "b": []}, Request(Verb.START, OWN, start_ns), 2.0)
    assert asked == [
        (Verb.START, True, 2.0), (Verb.START, False, pytest.approx(0.15)), (Verb.CANCEL, False, pytest.approx(waits_s)),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("reply", "told"),
    [
        (Reply(True, "a", "HOLD", "", OWN), f"a: HOLD with cell {OWN[:12]}, not READY with {OWN[:12]}"),
        (Reply(True, "a", "READY", "", OTHER), f"a: READY with cell {OTHER[:12]}, not READY with {OWN[:12]}"),
    ],
)
def test_an_agent_of_another_version_that_says_yes_to_everything_starts_nobody(
    tmp_path: Path, reply: Reply, told: str
) -> None:
    arms = cell_of(tmp_path / "cell", (Mode.READY, Mode.READY))
    arms[0].wakes = lambda control: setattr(control, "_answer", lambda *_, **__: reply)
    request = Request(Verb.START, OWN, time.time_ns() + 10**12)
    with serving(arms), pytest.raises(ControlError) as raised:
        start_together({arm.path.stem: [arm.path] for arm in arms}, request, PATIENT_S)
    assert told in str(raised.value)
    assert arms[1].heard == (False, [])


@pytest.mark.parametrize(
    ("places", "found"),
    [
        ((ABSENT, DEAD, HUNG), "no answer within 0.04 s"),
        ((ABSENT, DEAD), "Connection refused"),
        ((DEAD, ABSENT), "Connection refused"),
        ((ABSENT, ABSENT), "nothing at {0}/a.control or {0}/b.control"),
        ((), "no socket"),
    ],
)
def test_of_several_places_of_an_arm_the_most_telling_silence_is_told(
    tmp_path: Path, places: tuple[str, ...], found: str
) -> None:
    arms = cell_of(tmp_path / "cell", places)
    with serving(arms):
        heard = ask.ask_arms({"left": [arm.path for arm in arms]}, Request(Verb.STOP), QUICK_S)
    said = found.format(tmp_path / "cell")
    assert heard == {"left": ask.Silence(said, hung=HUNG in places, nowhere={*places} == {ABSENT})}


def test_a_patient_start_is_tried_thrice_and_looks_before_each_time_whether_it_is_still_wanted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given: list[str] = []

    def start(_: object, request: Request, look: object) -> None:
        assert look is no_longer
        given.append(request.fingerprint)
        raise ControlError("start", found=f"attempt {len(given)}", expected="arms READY", remedy="see their logs")

    def no_longer() -> None:
        if len(given) == 5:
            raise KeyboardInterrupt

    monkeypatch.setattr(words, "start_together", start)
    with pytest.raises(ControlError, match="attempt 3"):
        words.start_patiently({}, OWN, 10**9, no_longer)
    with pytest.raises(KeyboardInterrupt):
        words.start_patiently({}, OWN, 10**9, no_longer)
    assert given == [OWN] * 5
