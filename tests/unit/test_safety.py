"""The last word on every torque: exact boundary values, and what holds for any input."""

from __future__ import annotations

import inspect
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent import safety
from agent.safety import AT_BOUND, Flag, Limits, limit
from tests.support.control.strategies import examples

INF, NAN = math.inf, math.nan
RATE, SATURATED, NOT_FINITE = Flag.RATE_LIMITED, Flag.SATURATED, Flag.NOT_FINITE

# wanted, last, bound, step -> torque, flags; every number is exact in binary
EXAMPLES: list[tuple[float, float, float, float, float, Flag]] = [
    (0.25, 0.0, 1.0, 0.5, 0.25, Flag.NONE),
    (-0.25, 0.0, 1.0, 0.5, -0.25, Flag.NONE),
    (0.75, 0.25, 1.0, 0.5, 0.75, Flag.NONE),  # exactly one step up
    (-0.25, 0.25, 1.0, 0.5, -0.25, Flag.NONE),  # exactly one step down
    (1.0, 0.75, 1.0, 0.5, 1.0, Flag.NONE),  # exactly at the bound
    (-1.0, -0.75, 1.0, 0.5, -1.0, Flag.NONE),
    (0.875, 0.25, 1.0, 0.5, 0.75, RATE),
    (-0.375, 0.25, 1.0, 0.5, -0.25, RATE),
    (3.0, 0.25, 1.0, 0.5, 0.75, RATE),  # far beyond the bound, which it may not reach yet
    (-3.0, -0.25, 1.0, 0.5, -0.75, RATE),
    (1.125, 0.75, 1.0, 0.5, 1.0, SATURATED),
    (-1.125, -0.75, 1.0, 0.5, -1.0, SATURATED),
    (3.0, 0.75, 1.0, 0.5, 1.0, RATE | SATURATED),
    (-3.0, -0.75, 1.0, 0.5, -1.0, RATE | SATURATED),
    (2.0, 2.0, 1.0, 0.5, 1.0, SATURATED),  # the bound forces a larger step
    (-2.0, -2.0, 1.0, 0.5, -1.0, SATURATED),
    (0.5, 0.5, 1.0, 0.0, 0.5, Flag.NONE),  # no change allowed, none wanted
    (NAN, 0.25, 1.0, 0.5, 0.25, NOT_FINITE),
    (INF, 0.25, 1.0, 0.5, 0.25, NOT_FINITE),
    (-INF, 0.25, 1.0, 0.5, 0.25, NOT_FINITE),
]

finite = st.floats(-1e6, 1e6)
anything = st.one_of(finite, st.floats(allow_nan=True, allow_infinity=True))
positive = st.floats(0.0, 1e3)
joints = st.lists(st.tuples(anything, finite, positive, positive), min_size=1, max_size=7)


Row = tuple[float, float, float, float]


def after_a_limited_tick(rows: list[Row]) -> list[Row]:
    """The same with a last torque within the bound, as every torque is that went through `limit`."""
    return [(wanted, max(-bound, min(last, bound)), bound, step) for wanted, last, bound, step in rows]


def run(rows: list[Row]) -> tuple[list[float], Flag]:
    wanted, last, bound, step = zip(*rows, strict=True)
    return limit(wanted, last, Limits(bound, step))


@pytest.mark.parametrize(("wanted", "last", "bound", "step", "torque", "flags"), EXAMPLES)
@pytest.mark.fault("M2")
def test_exact_values(wanted: float, last: float, bound: float, step: float, torque: float, flags: Flag) -> None:
    assert limit([wanted], [last], Limits((bound,), (step,))) == ([torque], flags)


def test_joints_are_limited_one_by_one_and_their_flags_are_joined() -> None:
    rows = [(NAN, 0.1, 1.0, 0.5), (3.0, 0.9, 1.0, 0.5), (0.2, 0.1, 1.0, 0.5), (0.75, 0.0, 1.0, 0.5)]
    assert run(rows) == ([0.1, 1.0, 0.2, 0.5], NOT_FINITE | RATE | SATURATED)
    assert run([*rows, *rows])[1] == NOT_FINITE | RATE | SATURATED, "what is flagged twice stays flagged"


@given(joints)
@examples(300)
@pytest.mark.fault("M1")
def test_output_is_finite_whatever_the_law_gave(rows: list[Row]) -> None:
    torque, flags = run(rows)
    assert all(map(math.isfinite, torque))
    assert (NOT_FINITE in flags) == any(not math.isfinite(r[0]) for r in rows)


@given(st.lists(st.tuples(anything, anything, anything, anything), min_size=1, max_size=7))
@examples(300)
def test_a_torque_comes_out_for_every_joint_whatever_the_numbers(rows: list[Row]) -> None:
    assert len(run(rows)[0]) == len(rows)


@given(joints)
@examples(300)
def test_output_is_within_the_bound_when_the_last_one_was(rows: list[Row]) -> None:
    rows = after_a_limited_tick(rows)
    torque, _ = run(rows)
    assert all(abs(t) <= r[2] for t, r in zip(torque, rows, strict=True))


@given(joints)
@examples(300)
@pytest.mark.fault("M3")
def test_output_is_within_one_step_of_the_last_unless_the_bound_forces(
    rows: list[Row],
) -> None:
    torque, _ = run(rows)
    for t, (_, last, bound, step) in zip(torque, rows, strict=True):
        assert last - step <= t <= last + step or abs(t) == bound


@given(joints)
@examples(300)
def test_flags_tell_of_every_change_and_of_nothing_else(rows: list[Row]) -> None:
    for row in after_a_limited_tick(rows):
        (torque,), flags = run([row])
        assert (flags is Flag.NONE) == (torque == row[0])


@given(joints)
@examples(200)
def test_limiting_twice_changes_nothing_more(rows: list[Row]) -> None:
    rows = after_a_limited_tick(rows)
    torque, _ = run(rows)
    again, flags = run([(t, *r[1:]) for t, r in zip(torque, rows, strict=True)])
    assert again == torque
    assert flags is Flag.NONE


@pytest.mark.parametrize("count", [(2, 1, 1), (1, 2, 1), (1, 1, 2)])
def test_a_wrong_number_of_joints_is_an_error_not_a_shorter_torque(count: tuple[int, int, int]) -> None:
    wanted, last, bounds = ([0.0] * n for n in count)
    with pytest.raises(ValueError, match="argument"):
        limit(wanted, last, Limits(tuple(bounds), tuple(bounds)))


def test_flags_are_the_bits_that_logs_hold() -> None:
    names = (
        "NOT_FINITE",
        "SATURATED",
        "RATE_LIMITED",
        "SINGULAR",
        "STALE",
        "ADAPTATION_SATURATED",
        "OFF_TRACK",
        "UNEXPECTED",
        "DAMPED",
        "BLIND",
        "RESUMED",
        "GAP",
        "GENTLE",
    )
    assert {f.name: f.value for f in Flag} == {name: 1 << bit for bit, name in enumerate(names)}
    assert Flag.NONE == 0


def test_the_file_stays_small() -> None:
    assert len(inspect.getsource(safety).splitlines()) <= 80


def test_a_torque_counts_as_at_its_bound_from_so_close_on() -> None:
    """For a hold that must brake, and for the report; what servos round is less."""
    assert AT_BOUND == 0.999
