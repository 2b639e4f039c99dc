"""When the torque at rest is judged: after two windows of half a second at rest, component by component."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agent.modes import Mode
from agent.monitors.gravity import REST_S, Gravity

WINDOW = 100  # ticks of 5 ms
FORCES = np.hstack([np.eye(3), np.zeros((3, 3))])  # from joint torques to the object's wrench, and back
MOMENTS = np.hstack([np.zeros((3, 3)), np.eye(3)])
G = np.array([0.25, -0.5, 0.75])  # N·m: the arm's own weight
OBJECT = (0.0, 0.0, 1.0)  # N·m: half of an object of 2 N, which the third joint bears
HEAVIER = (0.0, 0.0, 2.01)
NO_NUMBER = (float("nan"),) * 3


def gravity(period_s: float = 0.005) -> Gravity:
    bounds: Any = SimpleNamespace(
        joints=("a", "b", "c"), period_s=period_s, gravity=(1.0, 1.0, 1.0, 0.5, 0.5, 0.5),
        object_weight_N=(0.0, 0.0, 2.0), load_share_of_weight=0.5,
    )  # fmt: skip
    return Gravity(bounds)


def tick(
    beside: Any = OBJECT, *, q: float = 0.3, mode: Mode = Mode.READY, to_wrench: Any = FORCES, sent: Any = OBJECT,
    **terms: Any,
) -> Any:  # fmt: skip
    """beside, sent: joint torques measured and sent, beside the arm's weight."""
    k = SimpleNamespace(g=G, Jt=FORCES + MOMENTS)
    usual = {"J_inv_P": to_wrench, "kinematics": k, "tau_internal": np.zeros(3)}
    found = terms["terms"] if "terms" in terms else SimpleNamespace(**(usual | terms))
    state = SimpleNamespace(tau=G + beside, q=np.full(3, q))
    return SimpleNamespace(mode=mode, outcome=SimpleNamespace(terms=found, tau=G + sent), state=state)


def said(monitor: Gravity, *runs: tuple[int, Any]) -> list[int]:
    """Ticks, counted from 1, at which it said something."""
    ticks = [one for count, one in runs for _ in range(count)]
    return [i for i, one in enumerate(ticks, 1) if monitor.check(one)]


HEAVY = tick(HEAVIER)


def test_it_takes_two_windows_in_a_row_at_rest() -> None:
    assert said(gravity(), (5 * WINDOW, HEAVY)) == [200, 300, 400, 500]
    assert said(gravity(), (WINDOW, HEAVY), (WINDOW, tick()), (2 * WINDOW, HEAVY)) == [400]
    assert pytest.approx(1.1) == REST_S


def test_a_host_with_slow_ticks_has_one_in_a_window() -> None:
    assert said(gravity(2.0), (3, HEAVY)) == [2, 3]


@pytest.mark.parametrize("between", [tick(HEAVIER, mode=Mode.TRACK), tick(terms=None)])
def test_what_was_seen_before_a_motion_counts_no_more(between: Any) -> None:
    assert said(gravity(), (199, HEAVY), (1, between), (200, HEAVY)) == [400]
    assert said(gravity(), (99, HEAVY), (1, between), (200, HEAVY)) == [300]
    assert said(gravity(), (100, HEAVY), (1, between), (200, HEAVY)) == [301], "also between two windows"


def test_windows_begin_once_the_arm_has_taken_its_load_up() -> None:
    taking_up = tick(HEAVIER, to_wrench=None)
    for ticks in (1, 99, 100, 101, 250):
        assert said(gravity(), (ticks, taking_up), (200, HEAVY)) == [ticks + 200]
    assert said(gravity(), (100, HEAVY), (1, taking_up), (200, HEAVY)) == [301]


def test_the_share_of_the_object_is_taken_off_and_the_limit_itself_is_none() -> None:
    for off, wrong in ((1.0, False), (1.01, True), (-1.0, False), (-1.01, True)):
        assert bool(said(gravity(), (200, tick((0.0, 0.0, 1.0 + off))))) is wrong
    inner = tick((0.0, 0.0, 4.0), tau_internal=np.array([0.0, 0.0, 3.0]))
    assert said(gravity(), (200, inner)) == []


def test_a_joint_without_a_measured_torque_gives_what_was_sent() -> None:
    assert said(gravity(), (200, tick(NO_NUMBER))) == []
    assert said(gravity(), (200, tick(NO_NUMBER, sent=(0.0, 1.5, 1.0)))) == [200]


def test_an_arm_that_moves_or_has_no_law_is_not_compared() -> None:
    for begins, ends, rests in ((0.3, 0.3249, True), (0.3, 0.3251, False), (0.0, 0.025, True), (0.3, 0.2751, True)):
        still, last = tick(HEAVIER, q=begins), tick(HEAVIER, q=ends)
        assert bool(said(gravity(), (99, still), (1, last), (99, still), (1, last))) is rests
    assert said(gravity(), (200, tick((0.0, 0.0, 9.0), to_wrench=None))) == []


def test_what_is_just_beyond_its_limit_is_told_with_as_many_digits_as_it_takes_whatever_its_sign() -> None:
    for tau_Nm, sign in ((-1.004, "-"), (1.004, "+")):
        monitor, one = gravity(), tick((tau_Nm, 0.0, 0.0), to_wrench=FORCES)
        told = [monitor.check(one) for _ in range(200)][-1]
        assert f"{sign}1.004 N along x" in told
        assert "at most 1.000 N" in told


@pytest.mark.parametrize(
    ("to_wrench", "words"),
    [
        (FORCES, ("-1.50 N along x", "+2.00 N along z", "at most 1.00 N")),
        (MOMENTS, ("-1.50 N·m about x", "+2.00 N·m about z", "at most 0.50 N·m")),
    ],
)
def test_the_worst_component_is_named_with_its_unit(to_wrench: Any, words: tuple[str, str, str]) -> None:
    for tau, text in zip(((-1.5, 0.0, 1.0), (-1.5, 0.0, 3.0)), words[:2], strict=True):
        monitor, one = gravity(), tick(tau, to_wrench=to_wrench)
        told = [monitor.check(one) for _ in range(200)][-1]
        assert f"{text} at the object" in told
        assert words[2] in told
    both = tick((1.9, 0.0, 1.0), to_wrench=FORCES + 0.6 * MOMENTS)
    monitor = gravity()
    assert "about x" in [monitor.check(both) for _ in range(200)][-1], "it is judged by its share of the limit"
