"""`coop run --real-arms`: what it refuses in one line, what it starts, and that nobody but a person lets an arm go."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import configs
from agent.config.cell import Cell, load_cell
from agent.host.child import ChildFailed
from agent.modes import Mode
from agent.operator import words
from agent.operator.ask import ask_arms
from agent.operator.error import ControlError
from agent.operator.message import Reply, Request
from agent.operator.socket import ControlSocket, Standing
from agent.operator.table import Verb
from agent.process import children, real_arms
from agent.process.children import Children
from agent.process.commands import AgentCommand, GuardCommand
from agent.process.entry import main
from agent.process.real_arms import GONE_AFTER, Holding, RealArms, RealChildren
from agent.process.run_kind import RunKind
from agent.process.started import Listener
from agent.process.started import agent as started_agent
from agent.process.unbegun import StoppedEarly
from tests.support.command import coop
from tests.support.stops import stop_flag

NO_REALTIME, EMPTY = "--allow-no-realtime", "--gripper-empty"
LOOP = ("--hil", "left", "--real-arms")


@dataclass
class Person:
    """Says what it is told to say, and remembers what it was told."""

    empty: bool = True
    hears: bool = True
    presses: list[bool] = field(default_factory=list)
    told: list[str] = field(default_factory=list)

    def says_empty(self, arm: str) -> bool:
        del arm
        return self.empty

    def lets_go(self) -> bool:
        return self.presses.pop(0) if self.presses else False

    def tell(self, text: str) -> None:
        self.told.append(text)


def cell(*changes: str) -> Cell:
    return load_cell(configs.CELLS_DIR / "two_wx200.toml", ['hil.arms=["left"]', *changes])


# --- what is refused ------------------------------------------------------------------------------------------------

WITHOUT_PORT = "two_wx200.toml without ports"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("two_wx200", "--real-arms", NO_REALTIME, EMPTY), "--real-arms: found no arm in the loop"),
        (("two_wx200", *LOOP, EMPTY), "--real-arms: found a normal priority, expected SCHED_FIFO on a real arm"),
        (("two_wx200", *LOOP, NO_REALTIME), "gripper of arm left: found nobody who says that it is empty"),
        ((WITHOUT_PORT, *LOOP, NO_REALTIME, EMPTY), "port of arm left: found none in the cell file"),
        (("two_wx200", *LOOP, NO_REALTIME, EMPTY, "--faults", "f.jsonl"), "faults: found f.jsonl for real arms"),
        (
            ("two_wx200", *LOOP, NO_REALTIME, EMPTY, "--set", "arms.left.host=one", "--set", "arms.right.host=two"),
            "[hil] of cell two_wx200: found arms on one and two, expected one host",
        ),
        (
            ("two_wx200", *LOOP, NO_REALTIME, EMPTY, "--set", "hil.frequency_rad_per_s=45.0"),
            "45 rad/s, 7.5 ms of delay: 0.34, expected a product ≤ 0.3",
        ),
        (("two_wx200", "--hil", "middle", "--real-arms", NO_REALTIME, EMPTY), "found middle, expected left or right"),
    ],
)
def test_what_real_arms_cannot_rehearse_is_one_line_and_nothing_starts(
    arguments: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    name, *more = arguments
    if name == WITHOUT_PORT:
        text = (configs.CELLS_DIR / "two_wx200.toml").read_text()
        name = str(tmp_path / "cell.toml")
        Path(name).write_text("\n".join(line for line in text.splitlines() if not line.startswith("dynamixel")))
    done = coop("run", name, *more, "--out", tmp_path / "out")
    assert done.code in (2, 3)
    (line,) = [line for line in done.err.splitlines() if line.startswith("coop: ")]
    assert message in line
    assert not (tmp_path / "out").exists()


def test_arms_of_several_hosts_are_refused_by_their_agents_too(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_bytes(cell("arms.left.host=one", "arms.right.host=two").toml)
    for arm in ("left", "right"):
        done = coop("agent", path, "--arm", arm, "--real-time", "--gripper-empty")
        assert done.code == 2
        assert "expected one host: its plant is shared by all arms" in done.err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stop_at_the_question_for_the_gripper_ends_an_agent_that_is_started_by_hand(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    def agrees(question: str) -> bool:
        assert question == "Is the gripper of arm left EMPTY?"
        signal.raise_signal(number)
        return True

    monkeypatch.setattr("agent.config.cell.load_cell", lambda _: cell())
    monkeypatch.setattr("agent.process.agent.run_agent", lambda *_: pytest.fail("it runs"))
    command = AgentCommand(cell=Path("mine.toml"), arm="left", ring=None, control=None, driver=None, with_parent=None)
    with stop_flag(), pytest.raises(KeyboardInterrupt):
        started_agent(command, Listener(lambda _: None, agrees))


# --- what is started ------------------------------------------------------------------------------------------------


class Recorded(RealChildren):
    """Starts nothing; keeps what would be started."""

    def __init__(self, *given: Any, **more: Any) -> None:
        self.commands: dict[str, Any] = {}
        super().__init__(*given, **more)

    def _child(self, name: str, command: Any) -> Any:
        self.commands[name] = command
        return self

    def wait_ready(self, timeout_s: float, look: Callable[[], None]) -> dict[str, str]:
        del timeout_s, look
        return {}


def recorded(folder: Path, monkeypatch: pytest.MonkeyPatch, **how: Any) -> Recorded:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    given = cell(), RunKind.HIL, 0, None, folder / "run.mcap", folder, "tcp/127.0.0.1:0"
    return Recorded(*given, real=RealArms(Person(), **how), cell_path=Path("mine.toml"))


def test_the_real_arm_gets_its_own_port_a_guard_and_real_time_and_nobody_lets_go(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = recorded(tmp_path, monkeypatch, priority=80)
    place = tmp_path / "coop" / "two_wx200"
    left, right = (made._agent_command(arm) for arm in ("left", "right"))
    assert (left.port, left.emulated, left.hold, left.gripper_empty) == (None, False, True, True)
    assert (left.priority, left.allow_no_realtime, left.guard) == (80, False, place / "left.guard")
    assert left.plant_socket is not None
    assert (right.driver.value, right.hold, right.emulated, right.priority, right.guard) == (
        "sim", True, False, None, None,
    )  # fmt: skip
    assert (left.control, right.control) == (place / "left.control", place / "right.control")
    made._start_servos()
    guard = made.commands["guard-left"]
    assert isinstance(guard, GuardCommand)
    assert (guard.arm, guard.hold, guard.emulated, guard.priority) == ("left", True, False, 80)
    assert (guard.socket, guard.control) == (left.guard, left.control)
    assert set(made.commands) == {"guard-left"}, "no emulated servos"


def test_an_emulated_port_has_the_patience_of_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = recorded(tmp_path, monkeypatch, emulated=True)
    made._start_servos()
    assert made._agent_command("left").emulated
    assert made.commands["guard-left"].emulated
    assert made._agent_command("left").hold, "and is held all the same"


def test_on_emulated_servos_a_partner_is_at_the_wall_clocks_pace_and_nobody_holds_for_a_person(tmp_path: Path) -> None:
    made = Children(cell(), RunKind.HIL, 0, None, tmp_path / "run.mcap", tmp_path)
    left, right = (made._agent_command(arm) for arm in ("left", "right"))
    assert (left.driver.value, right.driver.value) == ("dynamixel", "sim")
    assert (left.emulated, right.emulated, right.real_time) == (True, True, True)
    assert left.plant_socket == right.plant_socket is not None
    assert (left.port, right.port) == (str(tmp_path / "left"), None)


# --- a stop while it starts -----------------------------------------------------------------------------------------


class Process:
    """A process that has said so much; the next line is waited for in vain, until it is told to end."""

    def __init__(self, name: str, *says: str) -> None:
        self.name, self.says, self.done = name, list(says), list[str]()
        self.heard: list[str] = []
        self.obeys, self.code, self.log = True, None, Path(f"{name}.log")
        self.process: Any = SimpleNamespace(poll=lambda: self.code, pid=os.getpid())

    def wait_ready(self, _: float, look: Callable[[], None]) -> dict[str, str]:
        look()
        while not self.says:
            look()
        self.heard.append(self.says.pop(0))
        return {self.heard[-1]: "there"}

    def has_said(self, key: str) -> bool:
        return key in self.says + self.heard

    def failed(self, what: str) -> ChildFailed:
        return ChildFailed(self.name, found=what, expected="a process that runs to the end", remedy="see its log")

    def terminate(self) -> None:
        self.done.append("terminated")
        if self.obeys and self.code is None:
            self.code = 130

    def wait(self, _: float) -> None:
        """It takes no time."""

    def kill(self) -> None:
        self.done.append("killed")
        self.code = -9 if self.code is None else self.code


class Starting(RealChildren):
    """Both arms are real; starts what says what the test has for it, and knows in which order."""

    def __init__(self, folder: Path, says: dict[str, tuple[str, ...]]) -> None:
        self.begun: dict[str, Process] = {}
        self._says = says
        both = load_cell(configs.CELLS_DIR / "two_wx200.toml", ['hil.arms=["left","right"]'])
        given = both, RunKind.HIL, 0, None, folder / "run.mcap", folder, "tcp/127.0.0.1:0"
        super().__init__(*given, real=RealArms(Person(), emulated=True), cell_path=Path("mine.toml"))

    def _child(self, name: str, command: Any) -> Any:
        del command
        self.begun[name] = Process(name, *self._says.get(name, ("endpoint",)))
        return self.begun[name]


class Stop:
    """Asked for at the so-manieth look."""

    def __init__(self, at: int) -> None:
        self.at, self.looks = at, 0

    def __call__(self) -> bool:
        self.looks += 1
        return self.looks >= self.at


def test_processes_of_real_arms_are_started_anew_and_those_of_simulated_ones_are_copies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[object] = []
    monkeypatch.setattr(children, "Child", lambda *given: made.append(given[-1]))
    real = Starting(tmp_path, {})
    simulated = Children(real._cell, RunKind.HIL, 0, None, tmp_path / "run.mcap", tmp_path)
    for whose in (real, simulated):
        Children._child(whose, "arm-left", whose._agent_command("left"))
    assert made == [None, main]


READY_FOR_ALL = {"arm-left": ("ring", "torque"), "arm-right": ("ring", "torque")}


@pytest.fixture
def started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """Starts that were given; nobody answers at the sockets, where each silence is a look."""
    given: list[object] = []
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(real_arms, "ASK_EVERY_S", 1e-3)
    monkeypatch.setattr(words, "start_together", lambda *what, look: look() or given.append(what))
    return given


ONE_READY = {"arm-left": ("ring", "torque"), "arm-right": ("ring",)}
HOLDS = Reply(True, "left", Mode.HOLD.name, "servo 3 is hot")


@pytest.mark.parametrize("says", [ONE_READY, READY_FOR_ALL])
def test_an_arm_that_holds_before_all_are_started_is_told_of_at_once_and_none_is_started(
    says: dict[str, tuple[str, ...]], tmp_path: Path, started: list[object], monkeypatch: pytest.MonkeyPatch
) -> None:
    def asked(whom: dict[str, object], request: Request, *_: object) -> dict[str, Reply]:
        assert set(whom) <= {name.removeprefix("arm-") for name, said in says.items() if "torque" in said}
        return {"left": HOLDS} if "left" in whom and request.verb is Verb.STATUS else {}

    made = Starting(tmp_path, says)
    monkeypatch.setattr(real_arms, "ask_arms", asked)
    monkeypatch.setattr(real_arms, "ASK_EVERY_S", 0.0)
    words = r"arm left: found it holds \(servo 3 is hot\) before all arms were started, .*its log is arm-left.log"
    with pytest.raises(ChildFailed, match=words):
        made.start(lambda: False, SimpleNamespace(phase=lambda _, **__: None))  # type: ignore[arg-type]
    assert made._real.beside.told[-1].startswith("arm left HOLDS (servo 3 is hot): support it, then press Enter")  # type: ignore[attr-defined]
    assert not started


@pytest.mark.parametrize("holds", [True, False])
def test_a_start_that_an_arm_refuses_because_it_holds_by_then_names_the_hold(
    holds: bool, tmp_path: Path, started: list[object], monkeypatch: pytest.MonkeyPatch
) -> None:
    """holds: else no arm does, and what refused the start is what is told."""
    refused: list[object] = []

    def start_together(*_: object, look: object) -> None:
        refused.append(look)
        raise ControlError("start", found="left refuses", expected="every arm READY", remedy="see their logs")

    def asked(whom: dict[str, object], request: Request, *_: object) -> dict[str, Reply]:
        return {"left": HOLDS} if refused and holds and request.verb is Verb.STATUS else {}

    made = Starting(tmp_path, READY_FOR_ALL)
    monkeypatch.setattr(real_arms, "ask_arms", asked)
    monkeypatch.setattr(real_arms, "ASK_EVERY_S", 0.05)
    monkeypatch.setattr(words, "start_together", start_together)
    kind, text = (ChildFailed, "arm left: found it holds") if holds else (ControlError, "left refuses")
    with pytest.raises(kind, match=text):
        made.start(lambda: False, SimpleNamespace(phase=lambda _, **__: None))  # type: ignore[arg-type]
    assert refused


@pytest.mark.parametrize("ended", ["arm-left", "guard-left"])
def test_a_process_that_ends_before_all_arms_are_started_ends_the_start(
    ended: str, tmp_path: Path, started: list[object]
) -> None:
    made = Starting(tmp_path, ONE_READY)
    looks = Stop(40)

    def look() -> bool:
        if looks():
            made.begun[ended].code = 3
        assert looks.looks < 50, "it goes on waiting"
        return False

    with pytest.raises(ChildFailed, match=f"{ended}: found ended before all arms were started"):
        made.start(look, SimpleNamespace(phase=lambda _, **__: None))  # type: ignore[arg-type]
    assert not started


def begin(folder: Path, stop: Stop, says: dict[str, tuple[str, ...]]) -> Starting:
    made = Starting(folder, says)
    with pytest.raises(StoppedEarly, match="a stop while its processes started") as told:
        made.start(stop, SimpleNamespace(phase=lambda _, **__: None))  # type: ignore[arg-type]
    assert told.value.exit_code == 130
    return made


@pytest.mark.parametrize(
    ("at", "of_arms"), [(1, set()), (3, {"guard-left", "guard-right"}), (4, {"guard-left", "guard-right"})]
)
def test_a_stop_before_agents_are_started_starts_none(
    at: int, of_arms: set[str], tmp_path: Path, started: list[object]
) -> None:
    made = begin(tmp_path, Stop(at), READY_FOR_ALL)
    assert set(made.begun) == {"recorder", "plant"} | of_arms
    made.abandon()
    assert not started


def test_a_stop_reaches_an_arm_with_torque_while_another_has_none_and_no_start_is_given(
    tmp_path: Path, started: list[object], monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[Verb] = []
    monkeypatch.setattr(real_arms, "ask_arms", lambda _, request, *__: told.append(request.verb) or {})
    made = begin(tmp_path, Stop(40), {"arm-left": ("ring", "torque"), "arm-right": ("ring",)})
    left, right = made.begun["arm-left"], made.begun["arm-right"]
    assert not started
    made.abandon()
    assert next(verb for verb in told if verb is not Verb.STATUS) is Verb.STOP
    assert left.done == ["terminated", "killed"], "when it has been let go, and not before"
    assert right.done == ["terminated", "terminated", "killed"]


def test_all_ready_is_not_too_late_for_a_stop(
    tmp_path: Path, started: list[object], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(real_arms, "ask_arms", lambda *_: {})  # how often it looks does not depend on time
    stop = Stop(10**9)
    counting = Starting(tmp_path, READY_FOR_ALL)
    counting.start(stop, SimpleNamespace(phase=lambda _, **__: None))  # type: ignore[arg-type]
    assert len(started) == 1
    begin(tmp_path, Stop(stop.looks), READY_FOR_ALL).abandon()
    assert len(started) == 1, "the last look is right before the start"


def test_a_start_that_failed_is_not_tried_again_after_a_stop(
    tmp_path: Path, started: list[object], monkeypatch: pytest.MonkeyPatch
) -> None:
    stop = Stop(10**9)

    def refused(*what: object, look: Callable[[], None]) -> None:
        look()
        started.append(what)
        stop.at = 0
        raise ControlError("start", found="left answers late", expected="every arm READY", remedy="see their logs")

    monkeypatch.setattr(words, "start_together", refused)
    begin(tmp_path, stop, READY_FOR_ALL).abandon()
    assert len(started) == 1


def test_an_arm_that_may_still_get_torque_is_waited_for_and_killed_if_it_hangs(
    tmp_path: Path, started: list[object], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not started
    runs: list[bool] = []  # whether the left one's process does, at each look
    clock = SimpleNamespace(s=time.monotonic())

    def monotonic() -> float:
        clock.s += 0.1
        return clock.s

    made = begin(tmp_path, Stop(40), {"arm-left": ("ring",), "arm-right": ("ring",)})
    left, right = made.begun["arm-left"], made.begun["arm-right"]
    monkeypatch.setattr(real_arms, "time", SimpleNamespace(monotonic=monotonic, sleep=lambda _: None))
    monkeypatch.setattr(real_arms, "ask_arms", lambda *_: runs.append(left.code is None) or {})
    left.obeys = False
    made.abandon()
    assert left.done[:2] == ["terminated", "killed"]
    assert right.done[0] == "terminated"
    assert sum(runs) > GONE_AFTER, "its silence does not say that it is gone"
    assert len(runs) - sum(runs) >= GONE_AFTER - 1, "from then on it does"


# --- who lets go ----------------------------------------------------------------------------------------------------


class Arm:
    """An agent's end of the control socket, in a thread."""

    def __init__(self, folder: Path, name: str, mode: Mode) -> None:
        self.path = folder / f"{name}.control"
        self.standing = Standing(name, mode, "the trajectory has ended")
        self.words: list[Verb] = []
        self._control = ControlSocket(self.path, "", self.standing)
        self._thread = threading.Thread(target=self._live)
        self._thread.start()

    def _live(self) -> None:
        while self.standing.mode is not Mode.OFF:
            self._control.poll()
            for word in self._control.requests.take():
                self.words.append(word)
                self.standing.mode = {Verb.STOP: Mode.HOLD, Verb.RELEASE: Mode.OFF}[word]
            time.sleep(2e-3)
        self._control.close()

    def end(self) -> None:
        self.standing.mode = Mode.OFF
        self._thread.join()


@pytest.fixture
def arms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, Arm]]:
    monkeypatch.setattr(real_arms, "ASK_EVERY_S", 0.01)
    monkeypatch.setattr(real_arms, "SUPPORTED_S", 0.0)
    made = {name: Arm(tmp_path, name, Mode.TRACK) for name in ("left", "right")}
    yield made
    for arm in made.values():
        arm.end()


def holding(arms: dict[str, Arm], person: Person, *real: str) -> Holding:
    return Holding({name: arm.path for name, arm in arms.items()}, real or ["left"], "mine.toml", person)


def look(beside: Holding, times: int = 1) -> None:
    for _ in range(times):
        time.sleep(0.011)
        beside.look()


def test_a_person_is_told_once_that_the_arm_holds_and_lets_it_go_by_a_key(arms: dict[str, Arm]) -> None:
    person = Person(presses=[True])
    beside = holding(arms, person)
    look(beside, 2)
    assert not person.told, "it follows the motion"
    arms["left"].standing.mode = Mode.HOLD
    look(beside, 3)
    assert person.told == [
        "arm left HOLDS (the trajectory has ended): support it, then press Enter here, or say `coop release mine.toml`"
    ]
    assert arms["left"].standing.mode is Mode.HOLD, "a key from before it held counts for nothing"
    arms["right"].standing.mode = Mode.HOLD
    person.presses = [False, True]
    look(beside, 2)
    for arm in arms.values():
        arm.end()  # it answers a word before it acts on it
    assert arms["left"].words == arms["right"].words == [Verb.RELEASE]
    look(beside, GONE_AFTER - 1)
    assert not beside.over
    look(beside)
    assert beside.over


def settled(arm: Arm) -> Mode:
    """Its mode once it has acted on what it has answered."""
    heard = ask_arms({"it": [arm.path]}, Request(Verb.STATUS))["it"]
    return Mode[heard.mode] if isinstance(heard, Reply) else Mode.OFF


AS_SHIPPED_S = real_arms.SUPPORTED_S
TOO_SOON = "Enter came before that arm can have been supported: press it again once all of them are"


def test_a_key_lets_no_arm_go_that_the_person_was_not_told_of_before_it(arms: dict[str, Arm]) -> None:
    person = Person()
    beside = holding(arms, person, "left", "right")
    left, right = arms["left"], arms["right"]
    left.standing.mode = Mode.HOLD
    look(beside)
    person.presses = [True]
    look(beside)
    left.end()
    assert left.words == [Verb.RELEASE]
    person.presses = [True]
    look(beside, 2)
    assert not person.presses, "once more, while nothing holds: it is heard, and forgotten"
    right.standing.mode = Mode.HOLD
    look(beside, 2)
    assert settled(right) is Mode.HOLD
    assert [text.split(" (")[0] for text in person.told] == ["arm left HOLDS", "arm right HOLDS"]
    person.presses = [True]
    look(beside)
    right.end()
    assert right.words == [Verb.RELEASE]


def test_a_key_counts_a_second_after_the_last_arm_was_told_of_and_no_sooner(
    arms: dict[str, Arm], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = SimpleNamespace(s=100.0)
    monkeypatch.setattr(real_arms, "SUPPORTED_S", AS_SHIPPED_S)
    monkeypatch.setattr(real_arms, "time", SimpleNamespace(monotonic=lambda: clock.s))
    person = Person(presses=[False, True, True])
    beside = holding(arms, person)
    arms["left"].standing.mode = Mode.HOLD
    for clock.s, mode in ((100.0, Mode.HOLD), (100.95, Mode.HOLD), (101.05, Mode.OFF)):
        beside.look()
        assert settled(arms["left"]) is mode


@pytest.mark.parametrize("in_that_look", [True, False])
def test_a_key_that_comes_before_a_second_arm_can_be_supported_lets_none_go(
    arms: dict[str, Arm], monkeypatch: pytest.MonkeyPatch, in_that_look: bool
) -> None:
    person = Person()
    beside = holding(arms, person, "left", "right")
    arms["left"].standing.mode = Mode.HOLD
    look(beside)
    monkeypatch.setattr(real_arms, "SUPPORTED_S", 1000.0)
    arms["right"].standing.mode = Mode.HOLD
    person.presses = [in_that_look, not in_that_look]
    look(beside, 2)
    assert [settled(arm) for arm in arms.values()] == [Mode.HOLD, Mode.HOLD]
    assert [text.split(" (")[0] for text in person.told] == ["arm left HOLDS", "arm right HOLDS", TOO_SOON]
    monkeypatch.setattr(real_arms, "SUPPORTED_S", 0.0)
    person.presses = [True]
    look(beside)
    for arm in arms.values():
        arm.end()
        assert arm.words == [Verb.RELEASE]


def test_an_arm_that_holds_since_the_look_of_a_key_is_not_let_go_by_it(
    arms: dict[str, Arm], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It does so between the question and the word."""
    person = Person()
    beside = holding(arms, person, "left", "right")
    arms["left"].standing.mode = Mode.HOLD
    look(beside)

    def asked(whom: Any, request: Request, timeout_s: float) -> Any:
        heard = ask_arms(whom, request, timeout_s)
        arms["right"].standing.mode = Mode.HOLD
        return heard

    monkeypatch.setattr(real_arms, "ask_arms", asked)
    person.presses = [True]
    look(beside)
    assert [settled(arms[name]) for name in ("left", "right")] == [Mode.OFF, Mode.HOLD]
    assert not arms["right"].words


def test_where_no_key_can_be_heard_none_is_named(arms: dict[str, Arm]) -> None:
    person = Person(hears=False)
    beside = holding(arms, person)
    arms["left"].standing.mode = Mode.HOLD
    look(beside)
    assert person.told == ["arm left HOLDS (the trajectory has ended): support it, then say `coop release mine.toml`"]


def test_the_end_waits_for_a_release_from_elsewhere_and_lets_the_simulated_partner_go(arms: dict[str, Arm]) -> None:
    person = Person()
    beside = holding(arms, person)
    seeing_off = threading.Thread(target=beside.see_off, args=[lambda: False])
    seeing_off.start()
    deadline = time.monotonic() + 10.0
    while not person.told:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert arms["left"].words == arms["right"].words == [Verb.STOP]
    time.sleep(0.05 * GONE_AFTER)
    assert seeing_off.is_alive(), "it holds as long as nobody lets it go"
    ask_arms({"left": [arms["left"].path]}, Request(Verb.RELEASE))
    seeing_off.join(10.0)
    assert not seeing_off.is_alive()
    arms["right"].end()  # it answers a word before it acts on it
    assert arms["right"].words == [Verb.STOP, Verb.RELEASE]
