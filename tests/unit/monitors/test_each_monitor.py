"""Each monitor by itself: the very tick at which it speaks, what it says then, and that it is silent at its bound."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agent.modes import Mode
from agent.monitors.body import Limited, Load, Start, Workspace
from agent.monitors.bounds import Bounds, Name
from agent.monitors.joints import Frozen, Position, Power, Speed
from agent.monitors.servos import Servos
from agent.monitors.tick import Tick
from agent.monitors.watch import Watch
from agent.safety import Flag
from drivers.interface import ServoHealth
from tests.unit.monitors.test_monitors import at_rest, health, usual

T = 0.0078125  # s, 1/128: sums of it are exact
ZERO = [0.0] * 3


def tick(*, mode: Mode = Mode.TRACK, q: Any = ZERO, dq: Any = ZERO, tau: Any = ZERO, flags: Flag = Flag.NONE) -> Tick:
    outcome: Any = SimpleNamespace(flags=flags, terms=None)
    return Tick(mode, None, outcome, q, dq, tau)  # type: ignore[arg-type]


def first(monitor: Any, ticks: list[Tick]) -> tuple[int | None, str]:
    """When it first says something, and what; before that it says an empty text."""
    for number, at in enumerate(ticks):
        if said := monitor.check(at):
            return number, said
        assert said == ""
    return None, ""


def test_what_is_at_its_bound_is_met_with_an_empty_text() -> None:
    b = replace(usual(), speed_rad_per_s=(0.5,) * 3, power_W=(0.5,) * 3, position_rad=((-1.0, 1.0),) * 3)
    for sign in (-1.0, 1.0):
        at = tick(q=[sign * 1.0] * 3, dq=[sign * 0.5] * 3, tau=[1.0] * 3)
        for monitor in (Speed(b), Power(b), Position(b), Workspace(b)):
            assert monitor.check(at) == ""
    corner: Any = SimpleNamespace(terms=SimpleNamespace(kinematics=SimpleNamespace(p_object=(0.5, -0.5, 0.0))))
    box = replace(b, workspace_m=((0.5, 1.0), (-1.0, -0.5), (0.0, 0.0)))
    assert Workspace(box).check(tick()._replace(outcome=corner)) == ""


def test_what_is_just_beyond_a_bound_is_told_with_as_many_digits_as_it_takes() -> None:
    b = replace(usual(), speed_rad_per_s=(0.5,) * 3, power_W=(0.5,) * 3, position_rad=((-1.0, 1.0),) * 3)
    b = replace(b, start_m=1e-4, start_rad=0.1, workspace_m=((-0.5, 0.5),) * 3)
    assert "found -0.5004 rad/s, expected at most 0.5000 rad/s" in Speed(b).check(tick(dq=[-0.5004] * 3))
    assert "found -0.70 rad/s, expected at most 0.50 rad/s" in Speed(b).check(tick(dq=[-0.7] * 3))
    assert "found 0.504 W (1.00 N·m at 0.50 rad/s), expected at most 0.500 W" in Power(b).check(
        tick(dq=[0.504] * 3, tau=[1.0] * 3)
    )
    assert "found -0.504 W (1.00 N·m at -0.50 rad/s), expected at most 0.500 W" in Power(b).check(
        tick(dq=[-0.504] * 3, tau=[1.0] * 3)
    )
    assert "found 0.70 W (1.00 N·m at 0.70 rad/s), expected at most 0.50 W" in Power(b).check(
        tick(dq=[0.7] * 3, tau=[1.0] * 3)
    )
    near, far = "expected -1.0000 to 1.0000 rad", "expected -1.000 to 1.000 rad"
    for q, told in ((-1.0002, f"-1.0002 rad, {near}"), (1.0002, f"1.0002 rad, {near}"), (1.2, f"1.200 rad, {far}")):
        assert f"found {told}" in Position(b).check(tick(q=[q] * 3))
    outside: Any = SimpleNamespace(terms=SimpleNamespace(kinematics=SimpleNamespace(p_object=(0.7, 0.0, 0.0))))
    assert "found 0.700 m, expected -0.500 to 0.500 m" in Workspace(b).check(tick()._replace(outcome=outside))
    above: Any = SimpleNamespace(terms=SimpleNamespace(kinematics=SimpleNamespace(p_object=(0.50003, 0.0, 0.0))))
    assert "found 0.50003 m, expected -0.50000 to 0.50000 m" in Workspace(b).check(tick()._replace(outcome=above))
    aside: Any = SimpleNamespace(memory=SimpleNamespace(shift=(1.2e-4, 0.0, 0.0, 0.0, 0.0, 0.1004)))
    said = Start(b).check(tick(mode=Mode.READY)._replace(outcome=aside))
    assert "found 0.12 mm and 100.4 mrad from where the cell states it, expected at most 0.1 mm and 100 mrad" in said


# --- a reading that stays the same -----------------------------------------------------------------------------------


def turning(rate: float, pushed: float, bounds: Bounds, ticks: int = 40, *, senses: bool = True) -> tuple[Any, str]:
    """The motion asks the second joint to turn at a rate, and the feedback pushes it; its reading stays the same."""
    J_inv_P = np.zeros((3, 6))
    J_inv_P[1, 2] = 0.5
    terms = SimpleNamespace(
        J_inv_P=J_inv_P if senses else None, desired=SimpleNamespace(v=(0.0, 0.0, 2.0 * rate, 0.0, 0.0, 0.0)),
        tau_feedback=np.array([0.0, pushed, 0.0]),
    )  # fmt: skip
    still = tick(q=[0.1, 0.2, 0.3])
    return first(Frozen(bounds), [still._replace(outcome=SimpleNamespace(terms=terms))] * ticks)  # type: ignore[arg-type]


def frozen(rad: float) -> Bounds:
    return replace(usual(), period_s=T, frozen_rad=rad, frozen_Nm=(9.0, 0.5, 9.0))


@pytest.mark.parametrize("rate", [1.0, -1.0])
def test_a_reading_is_frozen_when_it_stayed_for_a_twentieth_of_a_second_and_the_turn_is_beyond_its_bound(
    rate: float,
) -> None:
    assert turning(64.0 * rate, 0.6, frozen(0.1))[0] == 6, "50 ms are six periods"
    number, said = turning(rate, -0.6, frozen(8 * T))
    assert number == 9, "eight periods are at the bound"
    assert "0.2000 rad for 9 cycles against -0.60 N·m" in said
    assert f"a turn of about {9 * T * rate:.3f} rad" in said


def test_what_friction_may_keep_and_what_no_law_pushes_is_not_frozen() -> None:
    assert turning(64.0, 0.5, frozen(0.1)) == (None, "")
    assert turning(64.0, math.nextafter(0.5, 1.0), frozen(0.1))[0] == 6
    assert turning(64.0, 0.6, frozen(0.1), senses=False) == (None, "")


# --- torques at their limits -----------------------------------------------------------------------------------------


def limited(flagged: list[bool]) -> int | None:
    ticks = [tick(flags=Flag.SATURATED | Flag.STALE if at else Flag.STALE) for at in flagged]
    return first(Limited(replace(usual(), limited_share=0.5), Flag.SATURATED, "torque"), ticks)[0]


def test_the_last_hundred_ticks_are_a_hundred() -> None:
    assert limited([True] * 50 + [False] * 49 + [True]) == 99
    assert limited([True] * 50 + [False] * 50 + [True] * 50) is None
    assert limited([True] + [False] * 149 + [True] * 50 + [False]) is None, "the first is past"


@pytest.mark.parametrize(
    ("flag", "mode", "limp"),
    [
        (Flag.SATURATED, Mode.READY, True),
        (Flag.SATURATED, Mode.TRACK, True),
        (Flag.SATURATED, Mode.APPROACH, False),
        (Flag.RATE_LIMITED, Mode.TRACK, False),
    ],
)
def test_an_arm_at_its_torque_limit_asks_for_a_limp_neighbour_while_it_has_the_object(
    flag: Flag, mode: Mode, limp: bool
) -> None:
    _, said = first(Limited(usual(), flag, "torque"), [tick(mode=mode, flags=flag)] * 100)
    assert ("look for a neighbour that is limp, or what the arm pushes against" in said) is limp
    assert ("look for what the arm pushes against" in said) is not limp


# --- load ------------------------------------------------------------------------------------------------------------


def load(period_s: float, tau_Nm: float, load_time_s: float) -> int | None:
    """When a joint of 2 N·m stall is loaded by more than half of it."""
    b = replace(usual(), period_s=period_s, load_share=0.5, stall_Nm=(2.0,) * 3, load_time_s=load_time_s)
    return first(Load(b), [tick(tau=[0.0, 0.0, tau_Nm])] * 200)[0]


def test_load_is_judged_ten_times_a_second() -> None:
    assert load(0.005, 1.0, 0.1) is None, "at its bound"
    assert load(0.005, 1.01, 0.1) == 19
    assert load(0.005, 1.2, 0.2) == 39, "0.18 and 0.27 of the square"
    assert load(0.2, 1.01, 0.2) == 0, "of a slow loop at every tick"


# --- servos ----------------------------------------------------------------------------------------------------------


def reading(seconds: float, **more: Any) -> ServoHealth:
    """At an instant, at which temperature and voltage have been read."""
    now_ns = round(seconds * 1e9)
    return replace(health(), **{"stamp_ns": now_ns, "slow_ns": np.array([now_ns, now_ns]), **more})


def test_a_supply_at_the_end_of_its_range_is_within() -> None:
    high = float(health().voltage_max_V[0]) - usual().voltage_margin_V
    for volts, said in ((high, 0), (math.nextafter(high, 99.0), 1)):
        servos, supply = Servos(usual()), np.array([volts, 12.0])
        servos.judge(reading(0.0, voltage_V=supply))
        assert len(servos.judge(reading(0.25, voltage_V=supply))) == said


@pytest.mark.fault("S3")
def test_one_reading_of_a_servo_that_is_looked_at_twice_is_one() -> None:
    """Nine servos that answer one by one are asked every 0.36 s."""
    servos, hot, low = Servos(usual()), np.array([79.0, 40.0]), np.array([12.0, 5.0])
    read_ns = ((1, 1), (1, 1), (1, 2), (1, 2), (2, 2))
    looks = [reading(0.25 * k, slow_ns=np.array(ns), temperature_C=hot, voltage_V=low) for k, ns in enumerate(read_ns)]
    said = [[name for name, _ in servos.judge(look)] for look in looks]
    assert said == [[], [], ["voltage"], ["voltage"], ["temperature", "voltage"]]
    assert servos.judge(reading(1.25, slow_ns=np.array([3, 3]))) == []
    assert servos.judge(looks[0]) == [], "in a row"


def test_a_reading_of_no_servo_says_nothing_of_the_others() -> None:
    servos, hot = Servos(usual()), np.array([79.0, 40.0])
    assert servos.judge(reading(0.0, temperature_C=hot)) == []
    assert servos.judge(ServoHealth.none(0)) == []
    assert [name for name, _ in servos.judge(reading(0.25, temperature_C=hot))] == ["temperature"]


def test_load_of_a_servo_counts_from_its_first_reading() -> None:
    """All of stall at 0.2 of its time constant each: 0.2, 0.36 and 0.49 of the square, of which 0.25 are allowed."""
    servos = Servos(replace(usual(), load_time_s=1.0, load_share=0.5))
    said = [bool(servos.judge(reading(0.2 * k, current_A=np.array([2.3, np.nan])))) for k in range(5)]
    assert said == [False, False, False, True, True]


def test_load_of_a_servo_is_never_more_than_it_was_however_long_nobody_asked() -> None:
    servos = Servos(replace(usual(), load_time_s=1.0, load_share=0.5))
    for seconds in (0.0, 9.0, 18.0, 27.0):
        assert servos.judge(reading(seconds, load=np.array([np.nan, 0.5]))) == [], "at its bound"
    shown = [servos.judge(reading(36.0 + k, load=np.array([np.nan, -0.6]))) for k in range(2)]
    assert shown[0] == []
    assert "load of servo 8 (wrist_rotate): found 60% of stall in the mean, expected at most 50%" in shown[1][0][1]


def test_a_reading_without_a_load_forgets_nothing_of_the_load() -> None:
    servos, nan = Servos(replace(usual(), load_time_s=1.0, load_share=0.5)), np.array([np.nan, np.nan])
    for seconds in (0.0, 1.0, 2.0):
        said = servos.judge(reading(seconds, load=np.array([np.nan, 0.6])))
    assert len(said) == 1
    assert servos.judge(reading(3.0, load=nan, current_A=nan)) == []
    for seconds in (3.0, 3.0):
        said = servos.judge(reading(seconds, load=np.array([np.nan, 0.6])))
    assert len(said) == 1


# --- all of them -----------------------------------------------------------------------------------------------------


def asked(period_s: float, ticks: int) -> list[int]:
    """Ticks at which the driver was asked for the servos' health."""
    watch, (state, outcome), when = Watch(replace(usual(), period_s=period_s)), at_rest(), []
    for number in range(ticks):
        shown = partial(lambda n: when.append(n) or health(), number)
        assert watch.after(state, outcome, Mode.TRACK, shown) == ""
    return when


def test_servos_are_asked_four_times_a_second() -> None:
    assert asked(0.005, 160) == [49, 99, 149]
    assert asked(0.5, 3) == [0, 1, 2], "a slow loop at every tick"


SECONDS = itertools.count(0.0, 0.25)


def judged(watch: Watch, mode: Mode, speed: float = 0.0) -> str:
    """Of servos that are hot and have too little voltage, asked at every tick."""
    state, outcome = at_rest()
    wrong = reading(next(SECONDS), temperature_C=np.array([79.0, 40.0]), voltage_V=np.array([9.0, 12.0]))
    return watch.after(state, outcome._replace(dq=np.array([speed, 0.0, 0.0])), mode, lambda: wrong)


def test_the_first_that_is_found_is_the_reason_and_told_no_more_in_the_hold() -> None:
    told: list[str] = []
    three = frozenset({Name.SPEED, Name.TEMPERATURE, Name.VOLTAGE})
    watch = Watch(replace(usual(), period_s=0.25, watched=three), told.append)
    assert judged(watch, Mode.TRACK) == ""
    assert judged(watch, Mode.TRACK).startswith("monitor temperature: ")
    assert judged(watch, Mode.TRACK, 99.0).startswith("monitor speed: ")
    assert judged(watch, Mode.HOLD, 99.0) == ""
    assert [text.split(":")[0] for text in told] == ["monitor voltage"]


@pytest.mark.parametrize(("mode", "stops"), [(Mode.FLOAT, True), (Mode.STAND, False)])
def test_an_arm_that_floats_is_stopped_and_one_that_stands_is_told_of(mode: Mode, stops: bool) -> None:
    told: list[str] = []
    said = judged(Watch(replace(usual(), watched=frozenset({Name.SPEED})), told.append), mode, 99.0)
    assert (said != "", len(told)) == (stops, 0 if stops else 1)
