"""P11, C1, C5, G2: words to arms of which any are dead, hung, of another cell or in another mode, on real sockets."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import pytest

import configs
from agent.config.cell import load_cell
from agent.host.clock import ClockState
from agent.modes import Mode
from agent.operator import ask, local, words
from agent.operator.error import ControlError
from agent.operator.message import Reply, Request
from agent.operator.socket import ControlSocket, Standing
from agent.operator.table import MODES, Verb
from agent.operator.words import Here, start_arms, start_together, tell_arms

OWN, OTHER = "ab" * 32, "cd" * 32
QUICK_S = 0.04  # how long an agent that hangs is waited for
PATIENT_S = 20.0  # nobody hangs: never waited for
ABSENT, DEAD, HUNG, FOREIGN = "absent", "dead", "hung", "of another cell"
SILENT = (ABSENT, DEAD, HUNG)
Condition = Mode | str
EVERY: tuple[Condition, ...] = (*MODES, *SILENT, FOREIGN)


@dataclass
class Arm:
    """One agent as the test wants it: in a mode, or not there in one of several ways."""

    path: Path
    condition: Condition
    fingerprint: str = OWN
    control: ControlSocket | None = None
    listener: socket.socket | None = None
    wakes: Callable[[ControlSocket], None] | None = None  # is told before each poll
    session: bool = False  # goes from its rest to the object and back

    def open(self) -> None:
        if self.condition == ABSENT:
            return
        if self.condition in (DEAD, HUNG):
            self.listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            self.listener.bind(str(self.path))
            if self.condition == HUNG:
                self.listener.listen()  # takes clients and says nothing
            return
        mode = self.condition if isinstance(self.condition, Mode) else Mode.READY
        fingerprint = OTHER if self.condition == FOREIGN else self.fingerprint
        standing = Standing(self.path.stem, mode, session=(lambda _: "") if self.session else None)
        if self.session:
            standing.details = lambda: {"session": True}
        self.control = ControlSocket(self.path, fingerprint, standing)

    def close(self) -> None:
        for one in (self.control, self.listener):
            if one is not None:
                one.close()

    @property
    def heard(self) -> tuple[bool, list[Verb]]:
        """Whether it starts, and the words it has taken."""
        assert self.control is not None
        return self.control.requests.start is not None, self.control.requests.words


@contextmanager
def serving(arms: Sequence[Arm]) -> Iterator[None]:
    """Poll those who live, as their loops would."""
    over = threading.Event()

    def loop() -> None:
        while not over.is_set():
            for arm in arms:
                if arm.control is not None and arm.wakes is not None:
                    arm.wakes(arm.control)
                if arm.control is not None:
                    arm.control.poll()
            over.wait(0.0005)

    with ExitStack() as stack:
        for arm in arms:
            arm.open()
            stack.callback(arm.close)
        thread = threading.Thread(target=loop)
        thread.start()
        stack.callback(thread.join)
        stack.callback(over.set)
        yield


def cell_of(folder: Path, conditions: Sequence[Condition]) -> list[Arm]:
    folder.mkdir()
    return [Arm(folder / f"{name}.control", condition) for name, condition in zip("abc", conditions, strict=False)]


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
                words._tell_all(where, verb, timeout_s)
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
                    start_together(where, Request(verb, start_utc_ns=time.time_ns() + 10**12), timeout_s)
                else:
                    told = words._tell_all(where, verb, timeout_s)
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
    request = Request(Verb.LOWER, start_utc_ns=time.time_ns() + 10**12)
    with serving(arms), pytest.raises(ControlError, match="a: had begun, holds now; b: does not begin"):
        start_together({arm.path.stem: [arm.path] for arm in arms}, request, PATIENT_S)
    assert arms[0].control is not None
    assert arms[0].control.requests.lower is None
    assert arms[0].heard == (False, [Verb.STOP])


# --- a start that fails between its two halves -----------------------------------------------------------------------


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
    awake = threading.Event()

    def answered() -> dict[str, Any]:
        asleep.set()
        return {}

    def sleeps(control: ControlSocket) -> None:
        control.standing.details = answered
        if asleep.is_set():
            arms[1].control, sleeping[0] = None, control
            awake.set()

    sleeping: list[ControlSocket] = [None]  # type: ignore[list-item]
    arms[1].wakes = sleeps
    request = Request(Verb.START, OWN, time.time_ns() + 10**12)
    with serving(arms):
        with pytest.raises(ControlError) as raised:
            start_together({arm.path.stem: [arm.path] for arm in arms}, request, 0.2)
        sleeping[0].poll()
        sleeping[0].close()
    assert "b: does not answer (no answer within 0.2 s)" in str(raised.value)
    assert "a: does not begin; b: NOT KNOWN, it does not answer" in str(raised.value)
    assert sleeping[0].requests.start is None
    assert arms[0].heard == (False, [])


@pytest.mark.fault("C5")
def test_answers_that_come_too_late_for_the_instant_start_nobody(tmp_path: Path) -> None:
    arms = cell_of(tmp_path / "cell", (Mode.READY, Mode.READY))
    request = Request(Verb.START, OWN, time.time_ns() + 10**12)

    class Late:
        """A clock by which the answers took until just before the instant."""

        @staticmethod
        def time_ns() -> int:
            return request.start_utc_ns - 49_999_999

    with serving(arms), pytest.MonkeyPatch.context() as patch:
        patch.setattr(words, "time", Late)
        with pytest.raises(ControlError, match=r"start: found .* UTC, expected at least 0.05 s from now; choose"):
            start_together({arm.path.stem: [arm.path] for arm in arms}, request, PATIENT_S)
    assert [arm.heard for arm in arms] == [(False, [])] * 2


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
    arms[0].wakes = lambda control: setattr(control, "_answer", lambda *_: reply)
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
        ((ABSENT, ABSENT), "No such file or directory"),
        ((), "no socket"),
    ],
)
def test_of_several_places_of_an_arm_the_most_telling_silence_is_told(
    tmp_path: Path, places: tuple[str, ...], found: str
) -> None:
    arms = cell_of(tmp_path / "cell", places)
    with serving(arms):
        heard = ask.ask_arms({"left": [arm.path for arm in arms]}, Request(Verb.STOP), QUICK_S)
    assert heard == {"left": ask.Silence(found, hung=HUNG in places)}


# --- the arms of a host, and its clock -------------------------------------------------------------------------------

PAPER = configs.CELLS_DIR / "paper.toml"
GOOD = ClockState(synchronised=True, max_error_s=2e-4)
TWO_HOSTS = ["arms.left.host=one.lab", "arms.right.host=two"]


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder in which the agents of cell `paper` are, and none that run as services."""
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr("agent.host.paths.SERVICES_DIR", tmp_path / "services")
    folder = tmp_path / "coop" / "paper"
    folder.mkdir(parents=True)
    return folder


def test_all_arms_means_those_of_this_host(home: Path) -> None:
    cell = load_cell(PAPER, TWO_HOSTS)
    assert list(local.places(cell, [], [], "one")) == ["left"]
    assert list(local.places(cell, [], [], "two.lab")) == ["right"]
    assert list(local.places(cell, ["right"], [], "one")) == ["right"], "an arm that is named is meant"
    assert list(local.places(load_cell(PAPER), [], [], "three")) == ["left", "right"], "no host: every host"
    with pytest.raises(ControlError, match=r"arms of host three: found left on one\.lab, right on two, expected"):
        local.places(cell, [], [], "three")
    arm = Arm(home / "right.control", Mode.TRACK)
    with serving([arm]):
        assert tell_arms(cell, Verb.STOP, [], [], "two") == "right holds the object where it is"
    assert arm.heard == (False, [Verb.STOP])


def test_a_start_without_one_of_this_hosts_arms_is_refused(home: Path) -> None:
    cell = load_cell(PAPER)
    arm = Arm(home / "left.control", Mode.READY, cell.fingerprint)
    with (
        serving([arm]),
        pytest.raises(ControlError, match=r"start: found right: does not answer \(No such file or directory\), exp"),
    ):
        start_arms(cell, None, 60.0, [], Here(GOOD, "one"), print)
    assert arm.heard == (False, [])


def test_a_service_that_lives_counts_before_what_an_agent_by_hand_has_left(home: Path, tmp_path: Path) -> None:
    (tmp_path / "services" / "left").mkdir(parents=True)
    dead, alive = Arm(home / "left.control", DEAD), Arm(tmp_path / "services" / "left" / "left.control", Mode.HOLD)
    with serving([dead, alive]):
        assert (
            tell_arms(load_cell(PAPER), Verb.RELEASE, ["left"], [])
            == "left switches its torque off, and its agent ends"
        )
    assert alive.heard == (False, [Verb.RELEASE])


@pytest.mark.parametrize(
    ("clock", "two_hosts", "outcome"),
    [
        (GOOD, True, "clock of this host: synchronised, error at most 0.2 ms"),
        (ClockState(True, 1.1e-3), True, "error at most 1.1 ms; WARNING: above 1 ms arms press on each other"),
        (ClockState(True, 5e-3), True, "WARNING"),
        (ClockState(True, 5.1e-3), True, None),
        (ClockState(False, 1e-4), True, None),
        (ClockState(True, float("nan")), True, None),
        (ClockState(False, 16.0), False, "not synchronised, error at most 16 s; without effect where one host"),
    ],
)
@pytest.mark.fault("C1")
def test_a_start_on_several_hosts_needs_their_time(
    home: Path, clock: ClockState, two_hosts: bool, outcome: str | None
) -> None:
    """C1, C2: refused before anybody is asked; without effect where one host has all arms."""
    cell = load_cell(PAPER, TWO_HOSTS if two_hosts else ["arms.left.host=one", "arms.right.host=one"])
    here = ["left"] if two_hosts else ["left", "right"]
    arms = [Arm(home / f"{name}.control", Mode.READY, cell.fingerprint) for name in here]
    told: list[str] = []
    with serving(arms):
        if outcome is None:
            with pytest.raises(
                ControlError, match=r"clock of this host: found .*, expected synchronised, error ≤ 5 ms"
            ):
                start_arms(cell, None, 60.0, [], Here(clock, "one"), told.append)
        else:
            start_arms(cell, None, 60.0, [], Here(clock, "one"), told.append)
            assert outcome in told[0]
    assert [arm.heard for arm in arms] == [(outcome is not None, [])] * len(arms)


@pytest.mark.parametrize(
    ("at", "in_s", "complaint"),
    [
        (None, None, "no instant, or two"),
        ("10:00:00", 1.0, "no instant, or two"),
        ("noon", None, "'noon'"),
        (None, 0.01, "at least 0.05 s from now"),
    ],
)
def test_an_instant_that_makes_no_sense_is_one_line(
    home: Path, at: str | None, in_s: float | None, complaint: str
) -> None:
    """C5."""
    with pytest.raises(ControlError, match=complaint):
        start_arms(load_cell(PAPER), at, in_s, [], Here(GOOD), print)
