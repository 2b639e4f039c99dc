"""The guard's pulse: what it is kept in, how long it may stand still, and that it is given back once."""

from __future__ import annotations

import os
import tempfile

import pytest

from agent.guard.pulse import Pulse, pulse_vigil

MS = 1_000_000


@pytest.mark.parametrize(
    ("period_ms", "shared", "stale_ms"), [(5, False, 200), (5, True, 500), (100, False, 300), (100, True, 500)]
)
def test_a_pulse_may_stand_still_for_so_long_as_the_agent_sees_it(period_ms: int, shared: bool, stale_ms: int) -> None:
    vigil = pulse_vigil(period_ms * MS, shared=shared)
    looks = range(0, 1000 * MS, period_ms * MS)
    assert not vigil.is_stale(0, 7)
    stale = [now_ns for now_ns in looks[1:] if vigil.is_stale(now_ns, 7)]
    assert stale_ms * MS <= stale[0] < (stale_ms + period_ms) * MS


def test_both_ends_see_one_count_that_goes_on_where_it_was() -> None:
    made = Pulse.made()
    other = Pulse(os.dup(made.fileno()))
    for _ in range(3):
        other.beat()
    assert (made.count, other.count) == (3, 3)
    other.close()
    again = Pulse(os.dup(made.fileno()))
    again.beat()
    assert made.count == 4
    again.close()
    made.close()


def test_nobody_makes_it_shorter_under_its_reader() -> None:
    made = Pulse.made()
    for size in (0, 4096):
        with pytest.raises(PermissionError):
            os.ftruncate(made.fileno(), size)
    made.close()


def test_it_is_given_back_once() -> None:
    made = Pulse.made()
    fd = made.fileno()
    made.close()
    others = [os.dup(0) for _ in range(3)]
    assert fd in others, "the number is free"
    made.close()
    for other in others:
        os.fstat(other)
        os.close(other)


def test_a_descriptor_of_something_else_is_closed_and_refused() -> None:
    with tempfile.TemporaryFile() as file:
        fd = os.dup(file.fileno())
        with pytest.raises(ValueError, match="file size"):
            Pulse(fd)
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(fd)
