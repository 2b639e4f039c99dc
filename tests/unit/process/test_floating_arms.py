"""Whether arms still float, stand or sink, from what has become of their processes and those of their guards."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import pytest

from agent.modes import Mode
from agent.process import floating_arms
from agent.process.floating_arms import END_TIMEOUT_S, FloatingArms

KILLED, FAILED = -9, 5


@dataclass
class Child:
    """A process that runs, or has ended with a code."""

    code: int | None = None

    @property
    def process(self) -> Any:
        return SimpleNamespace(poll=lambda: self.code)


@dataclass
class Clock:
    s: float = 100.0

    def monotonic(self) -> float:
        return self.s


def arms(agents: dict[str, int | None], guards: dict[str, int | None]) -> Any:
    """Of these exit codes; None: it runs."""
    made: Any = FloatingArms.__new__(FloatingArms)
    made._agents = {name: Child(code) for name, code in agents.items()}
    made._guards = {name: Child(code) for name, code in guards.items()}
    made._recorder, made._servos, made._killed_s = Child(), None, {}
    return made


@pytest.mark.parametrize(
    ("agent", "guard", "lets_down"),
    [(None, None, False), (0, None, False), (FAILED, None, False), (KILLED, None, True), (KILLED, 0, False)],
)
def test_only_the_guard_of_a_killed_process_lets_an_arm_down(
    agent: int | None, guard: int | None, lets_down: bool
) -> None:
    one = arms({"left": agent}, {"left": guard})
    assert one._in_its_place("left") is lets_down
    assert one._alive() is (agent is None or lets_down)


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
