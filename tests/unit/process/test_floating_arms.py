"""Whether arms still float, stand or sink, from what has become of their processes and those of their guards."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest

from agent.host.child import ChildFailed
from agent.modes import Mode
from agent.process import floating_arms
from agent.process.floating_arms import END_TIMEOUT_S, FloatingArms

KILLED, FAILED = -9, 5


@dataclass
class Child:
    """A process that runs, or has ended with a code."""

    code: int | None = None
    done: list[str] = field(default_factory=list)
    told: Callable[[], list[str]] = list

    @property
    def process(self) -> Any:
        return SimpleNamespace(poll=lambda: self.code)

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


def arms(agents: dict[str, int | None], guards: dict[str, int | None]) -> Any:
    """Of these exit codes; None: it runs."""
    made: Any = FloatingArms.__new__(FloatingArms)
    made._agents = {name: Child(code) for name, code in agents.items()}
    made._guards = {name: Child(code) for name, code in guards.items()}
    made._recorder, made._servos, made._killed_s = Child(), None, {}
    made._telemetry = {name: Child() for name in agents}
    made._cell, made._ring = SimpleNamespace(arm=lambda name: name), lambda name: name
    return made


@pytest.mark.parametrize(
    ("agent", "guard", "lets_down"),
    [(None, None, False), (0, None, False), (FAILED, None, False), (KILLED, None, True), (KILLED, 0, False)],
)
def test_only_the_guard_of_a_killed_process_lets_an_arm_down(
    agent: int | None, guard: int | None, lets_down: bool
) -> None:
    one = arms({"left": agent}, {"left": guard})
    assert not one._in_its_place("left"), "nobody has looked yet"
    assert one._alive() is (agent is None or lets_down)
    assert one._in_its_place("left") is lets_down


def test_an_arm_whose_process_was_never_there_has_nobody_in_its_place() -> None:
    one = arms({}, {"left": None})
    assert not one._in_its_place("left")
    assert not one._alive()


def test_a_guard_is_waited_for_as_long_as_an_arm_takes_to_sink(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    monkeypatch.setattr(floating_arms, "time", clock)
    assert END_TIMEOUT_S == 43.0, "s: it stands for 3, sinks for at most 30"
    one = arms({"left": KILLED, "right": 0}, {"left": None, "right": None})
    assert one._alive()
    clock.s += END_TIMEOUT_S - 0.001
    assert one._alive()
    clock.s += 0.001
    assert not one._alive()


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


class Watched:
    """Two arms that somebody watches; `at` says what happens before a look, by its number from 2 on."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, at: dict[int, Callable[[Watched], None]]) -> None:
        self.arms = arms({"left": None, "right": None}, {"left": None, "right": None})
        self.left, self.right = self.arms._agents.values()
        self.modes = {"left": Mode.FLOAT, "right": Mode.FLOAT}
        self.asked, self.shown, self.closed = False, 0, 0
        self.noted: list[str] = []
        self.at = at
        self.clock = Clock(slept=lambda nap: at.get(nap + 1, lambda _: None)(self))
        monkeypatch.setattr(floating_arms, "time", self.clock)
        monkeypatch.setattr(floating_arms, "Window", self._window)

    def _window(self, _: Any, name: str, ring: str) -> Any:
        assert name == ring
        return SimpleNamespace(look=lambda: SimpleNamespace(mode=self.modes[name]), close=self._close)

    def _close(self) -> None:
        self.closed += 1

    def _show(self, _: Any) -> None:
        self.shown += 1
        assert self.shown < 20, "it does not end"

    def watch(self) -> Watched:
        self.arms.watch(lambda: self.asked, SimpleNamespace(show=self._show, note=self.noted.append))
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
    assert (run.shown, run.closed) == (5, 2)


def test_arms_that_nobody_stops_float_on(monkeypatch: pytest.MonkeyPatch) -> None:
    run = Watched(monkeypatch, {8: ended}).watch()
    assert (run.left.done, run.shown) == ([], 7)


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
    assert (run.shown, run.closed, run.right.done) == (5, 2, ["terminated"])


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
