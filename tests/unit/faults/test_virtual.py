"""Lives on virtual time: one goes at a time, in the order of what they wait for, and none is left behind."""

from __future__ import annotations

from functools import partial

import pytest

from agent.faults.virtual import STEP_NS, SharedClock
from sim_backend.wire.arm import EmulatedArm

MS = 1_000_000


class Nothing:
    """What stands where time stands, and has no servos."""

    arms: tuple[EmulatedArm, ...] = ()

    def __init__(self) -> None:
        self.time_ns = 0

    def advance_to(self, now_ns: int) -> None:
        assert now_ns - self.time_ns <= STEP_NS
        self.time_ns = now_ns


def test_lives_take_turns_in_the_order_of_what_they_wait_for() -> None:
    passed: list[int] = []
    nothing, said = Nothing(), list[tuple[str, int]]()
    clock = SharedClock(nothing, [], passed.append)

    def wakes(name: str, *at_ms: int) -> None:
        for each in at_ms:
            clock.sleep_until(each * MS)
            said.append((name, nothing.time_ns))

    clock.live([partial(wakes, "a", 3, 9), partial(wakes, "b", 1, 5, 12)])
    assert said == [("b", 1 * MS), ("a", 3 * MS), ("b", 5 * MS), ("a", 9 * MS), ("b", 12 * MS)]
    assert passed == sorted(passed)
    assert passed[-1] == nothing.time_ns == 12 * MS


def test_one_that_fails_frees_the_others_and_the_first_in_order_is_told() -> None:
    clock, ended = SharedClock(Nothing(), []), list[int]()

    def fails(at_ms: int) -> None:
        clock.sleep_until(at_ms * MS)
        raise ValueError(f"{at_ms} ms")

    def goes_on() -> None:
        clock.sleep_until(20 * MS)
        ended.append(20)

    with pytest.raises(ValueError, match="7 ms"):
        clock.live([partial(fails, 7), partial(fails, 2), goes_on])
    assert ended == [20]


@pytest.mark.parametrize("stopped_ms", [0, 2])  # before the others have begun; while they wait
def test_a_ctrl_c_ends_all_of_them_where_they_are_in_order(stopped_ms: int) -> None:
    clock, ended = SharedClock(Nothing(), []), list[str]()

    def is_stopped() -> None:
        if stopped_ms:
            clock.sleep_until(stopped_ms * MS)
        raise KeyboardInterrupt

    def goes_on(name: str) -> None:
        try:
            clock.sleep_until(20 * MS)
            ended.append("never")
        finally:
            clock.sleep_until(30 * MS)  # as a driver that takes the torque away
            ended.append(name)

    with pytest.raises(KeyboardInterrupt):
        clock.live([is_stopped, partial(goes_on, "a"), partial(goes_on, "b")])
    assert ended == (["a", "b"] if stopped_ms else [])


def test_lives_that_are_due_at_once_begin_in_order_and_one_alone_goes_on_at_once() -> None:
    clock, began = SharedClock(Nothing(), []), list[str]()
    clock.live([partial(began.append, name) for name in "abc"])
    assert began == ["a", "b", "c"]
    clock.sleep_until(5 * MS)  # outside: nobody else is there
    assert clock.now_ns() >= 5 * MS
