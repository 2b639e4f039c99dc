"""Whether arms still float, stand or sink, from what has become of their processes and those of their guards."""

from __future__ import annotations

import signal
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

from agent.host.child import ChildFailed
from agent.modes import Mode
from agent.operator.error import ControlError
from agent.process import floating_arms
from agent.process.floating_arms import (
    END_TIMEOUT_S,
    MEMBER,
    READY_TIMEOUT_S,
    RING,
    STOP_TIMEOUT_S,
    TORQUE,
    FloatingArms,
)
from agent.process.glance import Glance
from agent.process.unbegun import StoppedEarly

KILLED, FAILED = -9, 5


@dataclass(eq=False)
class Child:
    """A process that runs, or has ended with a code, and has said that it is ready."""

    code: int | None = None
    done: list[str] = field(default_factory=list)
    told: Callable[[], list[str]] = list
    said: set[str] = field(default_factory=lambda: {RING, TORQUE, MEMBER})

    @property
    def process(self) -> Any:
        return SimpleNamespace(poll=lambda: self.code, kill=self._killed)

    def _killed(self) -> None:
        self.done.append("killed")
        self.code = KILLED

    def has_said(self, key: str) -> bool:
        return key in self.said

    def terminate(self) -> None:
        self.done.append("terminated")

    def wait(self, timeout_s: float) -> None:
        self.done.append(f"waited {timeout_s:g}")

    def kill(self) -> None:
        self.done.append("killed")

    def failed(self, what: str) -> ChildFailed:
        return ChildFailed("arm", found=what, expected="a process that runs to the end", remedy="see its log")


@dataclass
class Clock:
    """It goes on where the test says, and tells how often somebody has slept."""

    s: float = 100.0
    slept: Callable[[int], None] = lambda _: None
    naps: int = 0

    def monotonic(self) -> float:
        return self.s

    def sleep(self, _: float) -> None:
        self.naps += 1
        self.slept(self.naps)


def arms(agents: dict[str, int | None], guards: dict[str, int | None], stop: Callable[[], bool] = lambda: False) -> Any:
    """Of these exit codes; None: it runs."""
    made: Any = FloatingArms.__new__(FloatingArms)
    made._stop, made._told, made._begun, made._failure, made._due = stop, False, False, None, {}
    made._commands, made._windows, made._endpoint = Commands(), {}, "tcp/127.0.0.1:7448"
    made._agents = {name: Child(code) for name, code in agents.items()}
    made._guards = {name: Child(code) for name, code in guards.items()}
    made._recorder, made._servos, made._killed_s = Child(), None, {}
    made._telemetry = {name: Child() for name in agents}
    made._cell = SimpleNamespace(arm=lambda name: name, file=SimpleNamespace(name="two", floating=None), arms=())
    return made


class Commands:
    """Of processes that nobody starts."""

    def ring(self, name: str) -> str:
        return name

    def telemetry(self, name: str, endpoint: str) -> str:
        return f"telemetry of {name} to {endpoint}"


@pytest.mark.parametrize(
    ("agent", "guard", "lets_down"),
    [(None, None, False), (0, None, False), (FAILED, None, False), (KILLED, None, True), (KILLED, 0, False)],
)
def test_only_the_guard_of_a_killed_process_lets_an_arm_down(
    agent: int | None, guard: int | None, lets_down: bool
) -> None:
    one = arms({"left": agent}, {"left": guard})
    assert not one._in_its_place("left"), "nobody has looked yet"
    assert (one._living() == {"left"}) is (agent is None or lets_down)
    assert one._in_its_place("left") is lets_down


def test_an_arm_whose_process_was_never_there_has_nobody_in_its_place() -> None:
    one = arms({}, {"left": None})
    assert not one._in_its_place("left")
    assert not one._living()


def test_a_guard_is_waited_for_as_long_as_an_arm_takes_to_sink(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    monkeypatch.setattr(floating_arms, "time", clock)
    assert END_TIMEOUT_S == 43.0, "s: it stands for 3, sinks for at most 30"
    one = arms({"left": KILLED, "right": 0}, {"left": None, "right": None})
    assert one._living() == {"left"}
    clock.s += END_TIMEOUT_S - 0.001
    assert one._living() == {"left"}
    clock.s += 0.001
    assert not one._living()


def test_what_is_said_of_a_killed_process_is_whether_its_guard_has_let_the_arm_down() -> None:
    for code, said in ((0, "its guard has let the arm down"), (KILLED, "the arm has no torque any more")):
        assert arms({"left": KILLED}, {"left": code})._ended("left") == f"ended while it floated; {said}"


def test_all_arms_stop_with_the_first_that_stops_or_ends_and_with_log_or_servos() -> None:
    both: dict[str, int | None] = {"left": None, "right": None}
    floats = [SimpleNamespace(mode=Mode.FLOAT)] * 2
    assert not arms(both, both)._one_stopped(floats)
    assert arms({"left": None, "right": 0}, both)._one_stopped(floats)
    for mode in set(Mode) - {Mode.FLOAT}:
        stopped = mode in (Mode.STAND, Mode.SINK, Mode.FAULT)
        assert arms(both, both)._one_stopped([floats[0], SimpleNamespace(mode=mode)]) is stopped
    for name in ("_recorder", "_servos"):
        one = arms(both, both)
        setattr(one, name, Child(0))
        assert one._one_stopped(floats)
        setattr(one, name, Child())
        assert not one._one_stopped(floats)
    one = arms(both, both)
    one._telemetry["right"].code = KILLED
    assert one._one_stopped(floats), "telemetry, too, without which the log ends"


class Watched:
    """Two arms that somebody watches; `at` says what happens before a look, by its number from 2 on."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, at: dict[int, Callable[[Watched], None]]) -> None:
        self.arms = arms({"left": None, "right": None}, {"left": None, "right": None}, lambda: self.asked)
        self.begun: dict[str, Child] = {}
        self.phases: list[str] = []
        self.frames: list[dict[str, str]] = []
        self.left, self.right = self.arms._agents.values()
        self.modes = {"left": Mode.FLOAT, "right": Mode.FLOAT}
        self.asked, self.shown, self.closed = False, 0, 0
        self.noted: list[str] = []
        self.at = at
        self.clock = Clock(slept=lambda nap: at.get(nap + 1, lambda _: None)(self))
        monkeypatch.setattr(floating_arms, "time", self.clock)
        monkeypatch.setattr(floating_arms, "Window", self._window)
        self.arms._child = self._child

    def _window(self, _: Any, name: str, ring: str) -> Any:
        assert name == ring
        return SimpleNamespace(look=lambda: Glance(name, self.modes[name]), close=self._close)

    def _child(self, name: str, command: Any) -> Child:
        assert command == f"telemetry of {name.removeprefix('telemetry-')} to tcp/127.0.0.1:7448"
        self.begun[name] = Child()
        return self.begun[name]

    def _close(self) -> None:
        self.closed += 1

    def _show(self, glances: list[Glance]) -> None:
        self.shown += 1
        self.frames.append({glance.arm: " ".join([glance.mode.name, *glance.said]) for glance in glances})
        assert self.shown < 20, "it does not end"

    def watch(self) -> Watched:
        self.arms.watch(SimpleNamespace(show=self._show, note=self.noted.append, phase=self.phases.append))
        return self


def ended(run: Watched) -> None:
    run.left.code = run.right.code = 0


def stop(run: Watched) -> None:
    run.asked = True


def left_stands(run: Watched) -> None:
    run.modes["left"] = Mode.STAND


def left_killed(run: Watched) -> None:
    run.left.code = KILLED


@pytest.mark.parametrize("why", [stop, left_stands])
def test_all_are_told_once_to_stop_and_shown_until_they_have_ended(
    monkeypatch: pytest.MonkeyPatch, why: Callable[[Watched], None]
) -> None:
    told: list[int] = []
    run = Watched(monkeypatch, {3: why, 4: lambda run: told.append(len(run.left.done)), 6: ended}).watch()
    assert told == [1]
    assert (run.left.done, run.right.done) == (["terminated"], ["terminated"])
    assert (run.shown, run.closed) == (6, 2)


def test_arms_that_nobody_stops_float_on(monkeypatch: pytest.MonkeyPatch) -> None:
    run = Watched(monkeypatch, {8: ended}).watch()
    assert (run.left.done, run.shown) == ([], 8)
    assert (run.phases, sorted(run.begun)) == (["torque on"], ["telemetry-left", "telemetry-right"])


def test_what_the_recorder_tells_is_passed_on_while_the_arms_float(monkeypatch: pytest.MonkeyPatch) -> None:
    run = Watched(monkeypatch, {8: ended})
    told = iter([[], ["run.mcap: the log ENDS HERE"]])
    run.arms._recorder.told = lambda: next(told, [])
    assert run.watch().noted == ["run.mcap: the log ENDS HERE"]


def test_a_process_that_was_killed_fails_the_run_once_its_guard_has_let_the_arm_down(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def let_down(run: Watched) -> None:
        run.arms._guards["left"].code = run.right.code = 0

    run = Watched(monkeypatch, {3: left_killed, 6: let_down})
    with pytest.raises(ChildFailed, match="ended while it floated; its guard has let the arm down"):
        run.watch()
    assert (run.shown, run.closed, run.right.done) == (6, 2, ["terminated"])
    assert run.frames[-2:] == [
        {"left": "FLOAT", "right": "FLOAT"},
        {"left": "OFF torque off", "right": "OFF torque off"},
    ]


def test_an_arm_is_off_once_its_process_or_the_guard_after_it_has_ended_and_sinks_until_then(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def right_ends(run: Watched) -> None:
        run.right.code = 0
        run.modes.update(left=Mode.SINK, right=Mode.SINK)

    def left_let_down(run: Watched) -> None:
        run.arms._guards["left"].code = 0

    run = Watched(monkeypatch, {2: right_ends, 3: left_killed, 5: left_let_down})
    with pytest.raises(ChildFailed):
        run.watch()
    off = "OFF torque off"
    assert [frame["right"] for frame in run.frames] == ["FLOAT", off, off, off, off]
    assert [frame["left"] for frame in run.frames] == ["FLOAT", "SINK", "SINK", "SINK", off]


# --- before all of them are ready ---------------------------------------------------------------------------------


def not_yet(run: Watched, **arms: set[str]) -> Watched:
    """These have said so much."""
    for name, said in arms.items():
        run.arms._agents[name].said = said
    run.arms._telemetry = {}
    return run


def left_has_torque(run: Watched) -> None:
    run.left.said |= {RING, TORQUE}


def right_ends_unbegun(run: Watched) -> None:
    run.right.code = StoppedEarly.exit_code


def test_an_arm_is_shown_from_its_torque_on_and_a_stop_reaches_it_while_another_is_not_ready(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def obeyed(run: Watched) -> None:
        assert run.left.done == run.right.done == ["terminated"]
        run.left.code = 0
        right_ends_unbegun(run)

    at = {3: left_has_torque, 5: stop, 6: obeyed}
    run = not_yet(Watched(monkeypatch, at), left=set(), right=set()).watch()
    assert run.frames == [{"left": "FLOAT", "right": "OFF"}] * 3 + [dict.fromkeys(run.frames[0], "OFF torque off")]
    assert (run.phases, list(run.begun), run.closed) == (["torque on"], ["telemetry-left"], 1)


@pytest.mark.parametrize("code", [StoppedEarly.exit_code, -signal.SIGTERM])
def test_a_stop_before_any_torque_says_so_and_shows_nothing(monkeypatch: pytest.MonkeyPatch, code: int) -> None:
    def obeyed(run: Watched) -> None:
        run.left.code = run.right.code = code
        run.begun["telemetry-left"].code = 0

    run = not_yet(Watched(monkeypatch, {3: stop, 5: obeyed}), left={RING}, right=set())
    with pytest.raises(StoppedEarly, match="floating of cell two: found a stop while its processes started"):
        run.watch()
    assert not run.frames
    assert run.clock.naps == 4, "a guard of a process that never had torque has nothing to let down"


def test_what_was_lost_before_any_torque_is_named_and_not_the_stop_that_follows(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def telemetry_dies(run: Watched) -> None:
        run.begun["telemetry-left"].code = KILLED

    def obeyed(run: Watched) -> None:
        run.left.code = run.right.code = StoppedEarly.exit_code

    run = not_yet(Watched(monkeypatch, {3: telemetry_dies, 5: obeyed}), left={RING}, right=set())
    with pytest.raises(ChildFailed, match="ended before an arm had torque"):
        run.watch()


def test_an_arm_that_ends_before_it_is_ready_stops_the_others_and_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def right_refuses(run: Watched) -> None:
        run.right.code = FAILED

    def left_lies(run: Watched) -> None:
        run.left.code = 0

    run = not_yet(Watched(monkeypatch, {3: right_refuses, 6: left_lies}), left={RING, TORQUE}, right={RING})
    with pytest.raises(ChildFailed, match="ended before it was ready"):
        run.watch()
    assert run.left.done == ["terminated"]


@pytest.mark.parametrize(("asked", "after_s"), [(False, READY_TIMEOUT_S), (True, STOP_TIMEOUT_S)])
def test_a_process_that_gets_not_ready_or_ends_not_when_told_is_killed_and_the_others_sink(
    monkeypatch: pytest.MonkeyPatch, asked: bool, after_s: float
) -> None:
    def time_is_almost_over(run: Watched) -> None:
        run.clock.s += after_s - 0.001

    def time_is_over(run: Watched) -> None:
        assert "killed" not in run.right.done
        run.clock.s += 0.001

    def left_lies(run: Watched) -> None:
        run.left.code = 0

    at = {4: time_is_almost_over, 5: time_is_over, 8: left_lies} | ({3: stop} if asked else {})
    run = not_yet(Watched(monkeypatch, at), left={RING, TORQUE}, right={RING})
    run.arms._due = {run.right: (TORQUE, run.clock.s + READY_TIMEOUT_S)}
    with pytest.raises(ChildFailed, match="neither ready nor ended in time"):
        run.watch()
    assert run.right.done[-2:] == (["terminated", "killed"] if asked else ["killed", "terminated"])[-2:]
    assert run.left.done == ["terminated"]


def test_an_arm_has_its_time_from_its_ring_on_for_torque(monkeypatch: pytest.MonkeyPatch) -> None:
    def right_has_a_ring(run: Watched) -> None:
        run.clock.s += READY_TIMEOUT_S - 1.0
        run.right.said = {RING}

    def time_goes_on(run: Watched) -> None:
        run.clock.s += READY_TIMEOUT_S - 1.0

    def right_has_torque(run: Watched) -> None:
        assert "killed" not in run.right.done
        run.right.said.add(TORQUE)

    run = not_yet(
        Watched(monkeypatch, {3: right_has_a_ring, 5: time_goes_on, 7: right_has_torque, 9: ended}), right=set()
    )
    run.arms._due = {run.right: (TORQUE, run.clock.s + READY_TIMEOUT_S)}
    run.watch()
    assert not run.right.done


def test_a_start_is_given_once(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[object] = []
    run = Watched(monkeypatch, {6: ended})
    run.arms._commands.control = run.arms._commands.ring
    run.arms._cell.fingerprint = "of two"
    monkeypatch.setattr(floating_arms, "moving", lambda _: [SimpleNamespace(name="left")])
    monkeypatch.setattr(floating_arms, "start_patiently", lambda *what: given.append(what[:3]))
    run.watch()
    assert given == [({"left": ["left"]}, "of two", floating_arms.START_IN_NS)]


def test_those_that_move_are_told_to_once_every_arm_has_torque_and_telemetry(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[int] = []

    def right_has_torque(run: Watched) -> None:
        run.right.said.add(TORQUE)

    def telemetry_is_late(run: Watched) -> None:
        run.begun["telemetry-right"].said = set()

    def telemetry_is_ready(run: Watched) -> None:
        run.begun["telemetry-right"].said = {MEMBER}

    at = {2: telemetry_is_late, 3: right_has_torque, 5: telemetry_is_ready, 8: ended}
    run = not_yet(Watched(monkeypatch, at), left={RING, TORQUE}, right={RING})
    monkeypatch.setattr(run.arms, "_begin", lambda _: begun.append(run.clock.naps) or setattr(run.arms, "_begun", True))
    run.watch()
    assert begun == [4]


@pytest.mark.parametrize("before", [None, stop, left_stands])
def test_a_start_that_arms_do_not_take_ends_all_of_them_and_none_is_given_after_a_stop_or_beside_an_arm_that_stands(
    monkeypatch: pytest.MonkeyPatch, before: Callable[[Watched], None] | None
) -> None:
    def start(_: object, __: str, ___: int, look: Callable[[], None]) -> None:
        look()
        if before is not None:
            before(run)
            look()
        raise ControlError("start", found="left refuses", expected="every arm READY", remedy="see their logs")

    run = Watched(monkeypatch, {5: ended})
    run.arms._commands.control = run.arms._commands.ring
    run.arms._cell.fingerprint = "of two"
    monkeypatch.setattr(floating_arms, "moving", lambda _: [SimpleNamespace(name="left")])
    monkeypatch.setattr(floating_arms, "start_patiently", start)
    with nullcontext() if before else pytest.raises(ControlError, match="left refuses"):
        run.watch()
    assert run.left.done == run.right.done == ["terminated"]


@pytest.mark.parametrize("at", [1, 2, 3, 4])
def test_a_stop_before_the_arms_processes_are_started_starts_none(at: int) -> None:
    looks = iter(range(1, 10))
    one = arms({}, {}, lambda: next(looks) >= at)
    begun: list[str] = []

    def wait_ready(_: float, look: Callable[[], None]) -> dict[str, str]:
        look()
        return {"endpoint": "somewhere"}

    def child(name: str, _: object) -> Any:
        begun.append(name)
        return SimpleNamespace(wait_ready=wait_ready)

    one._child, one._emulate, one._commands = child, True, MagicMock()
    one._cell.arms = (SimpleNamespace(name="left"),)
    one._cell.file.floating = SimpleNamespace(takes_part=lambda _: True)
    with pytest.raises(StoppedEarly):
        one.start(SimpleNamespace(phase=lambda _: None))
    assert begun == ["recorder", "servos", "guard-left"][: 2 if at == 1 else 3]


# --- the end ------------------------------------------------------------------------------------------------------


def test_telemetry_that_died_is_named_when_the_log_is_closed() -> None:
    one = arms({"left": 0}, {"left": 0})
    one._recorder.wait = lambda _: 0
    one.end(SimpleNamespace(phase=lambda _: None))
    one._telemetry["left"].code = 0
    one.end(SimpleNamespace(phase=lambda _: None))
    one._telemetry["left"].code = KILLED
    with pytest.raises(ChildFailed, match="ended early; the log lacks rows of its arm"):
        one.end(SimpleNamespace(phase=lambda _: None))


def test_without_a_recorder_nobody_waits_for_telemetry_which_does_for_it() -> None:
    one = arms({"left": 0}, {"left": 0})
    one._recorder.code = KILLED
    one._recorder.wait = lambda _: KILLED
    with pytest.raises(ChildFailed, match="did not close the log"):
        one.end(SimpleNamespace(phase=lambda _: None))
    assert not one._telemetry["left"].done
    one.abandon()
    assert one._telemetry["left"].done[0] == "terminated"


def test_what_is_left_ends_in_order_and_a_guard_that_lets_an_arm_down_has_its_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run = Watched(monkeypatch, {})
    left_killed(run)
    run.right.code = 0
    run.arms.abandon()
    guards = run.arms._guards
    assert guards["left"].done == ["waited 43", "terminated", "waited 20", "killed"]
    assert guards["right"].done == ["terminated", "waited 20", "killed"]
    assert run.left.done == ["terminated", "waited 43", "killed"]
    assert run.arms._telemetry["left"].done == ["waited 20", "terminated", "waited 20", "killed"]
    assert run.arms._recorder.done == ["terminated", "waited 20", "killed"]
