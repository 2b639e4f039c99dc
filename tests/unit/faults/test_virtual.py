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
    clock = SharedClock(nothing, [], 2, passed.append)

    def wakes(name: str, *at_ms: int) -> None:
        for each in at_ms:
            clock.sleep_until(each * MS)
            said.append((name, nothing.time_ns))

    clock.live([partial(wakes, "a", 3, 9), partial(wakes, "b", 1, 5, 12)])
    assert said == [("b", 1 * MS), ("a", 3 * MS), ("b", 5 * MS), ("a", 9 * MS), ("b", 12 * MS)]
    assert passed == sorted(passed)
    assert passed[-1] == nothing.time_ns == 12 * MS


def test_one_that_fails_frees_the_others_and_the_first_in_order_is_told() -> None:
    clock, ended = SharedClock(Nothing(), [], 3), list[int]()

    def fails(at_ms: int) -> None:
        clock.sleep_until(at_ms * MS)
        raise ValueError(f"{at_ms} ms")

    def goes_on() -> None:
        clock.sleep_until(20 * MS)
        ended.append(20)

    with pytest.raises(ValueError, match="7 ms"):
        clock.live([partial(fails, 7), partial(fails, 2), goes_on])
    assert ended == [20]
