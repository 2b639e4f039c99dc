"""What strikes an object that arms share: its size, how limits grow with the slip, and pushes noticed by it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from agent.config.cell import load_cell
from agent.config.noticing import KNOCK, STEPS, against, knock
from agent.config.usual import usual
from agent.control.against import HANGS, LIFTED
from agent.control.borne import BORNE
from agent.control.brace import BRACED
from agent.control.knock import KNOCK_AT, NOT_STRUCK, SLIP_AT, STRUCK, Knock, Struck, slip, struck_of
from agent.control.memory import initial
from agent.safety import Flag
from agent.study.lab import Laboratory, Run
from agent.telemetry.row.fill import FACTOR, SETTLED

PERIOD = 5e-3
LAW = Knock(PERIOD, limit_N=0.5)
STILL = (0.0, 0.0, 0.0)


def after(seconds: float, force: tuple[float, float, float], speeds: tuple[float, ...] = STILL) -> Struck:
    struck = NOT_STRUCK
    for _ in range(round(seconds / PERIOD)):
        struck = LAW.advance(struck, force, speeds)
    return struck


def test_a_force_that_comes_at_once_is_a_knock_until_it_has_stayed() -> None:
    force = (0.6, -0.48, 0.64)  # 1 N
    for ticks in (1, 4, 30):
        struck = after(ticks * PERIOD, force)
        assert struck.knock_N == pytest.approx((1.0 - 20.0 * PERIOD) ** ticks)
        assert (struck.x_N, struck.y_N, struck.z_N) == pytest.approx((1.0 - struck.knock_N) * np.array(force))


@pytest.mark.parametrize(
    ("speeds", "expected"), [((0.03, -0.04, 0.0), 1.0), ((0.06, 0.0, 0.0), 1.0), ((0.06, -0.08, 0.0), 0.1 / 0.06)]
)
def test_the_slip_is_the_speed_of_the_joints_over_one_at_which_they_hide_a_force(
    speeds: tuple[float, ...], expected: float
) -> None:
    assert slip(speeds) == pytest.approx(expected)
    assert after(2.0, STILL, speeds).slip == pytest.approx(expected)


def test_an_arm_that_begins_is_asked_only_for_much() -> None:
    """The residual's first step is a jump of a newton."""
    assert NOT_STRUCK == (0.0, 0.0, 0.0, 0.0, 4.0)
    assert after(PERIOD, STILL).slip == pytest.approx(4.0 - 3.0 * 20.0 * PERIOD)
    assert after(0.2, STILL).slip < 1.06


def test_at_its_limit_a_knock_trips_nothing_and_the_limit_grows_with_the_slip() -> None:
    for factor in (1.0, 2.0):
        at = Struck(knock_N=0.5 * factor, slip=factor)
        assert not LAW.tripped(at)
        assert LAW.tripped(at._replace(knock_N=np.nextafter(at.knock_N, 9.0)))
    assert LAW.tripped(Struck(knock_N=math.nan))
    assert LAW.tripped(Struck(slip=math.nan))


def test_its_state_goes_through_a_row() -> None:
    struck = Struck(0.1, 0.2, 0.3, 0.4, 1.5)
    assert struck_of(list(struck)) == struck
    assert len(struck) == STRUCK
    assert struck_of([]) == NOT_STRUCK, "a row of a log that is older than this sense"
    memory = initial(3)
    flat = memory._replace(sense=memory.sense._replace(struck=struck)).flatten()
    assert (flat[KNOCK_AT], flat[SLIP_AT], len(flat)) == (0.4, 1.5, SLIP_AT + 1 + BORNE + BRACED + FACTOR + SETTLED)


def test_its_limit_follows_from_that_of_the_pull_and_who_has_none_has_no_knock() -> None:
    for name, limit_N in (("three_wx250s", 0.735), ("four_wx250s", 0.551)):
        cell = load_cell(Path(name))
        along = against(cell)
        assert along is not None
        assert knock(cell, along) == Knock(PERIOD, limit_N)
        assert limit_N == pytest.approx(KNOCK * along.level_N, rel=1e-3)
    assert knock(cell, None) is None


def test_coarse_readings_raise_its_limit_unless_that_of_the_pull_is_given() -> None:
    """A joint that stuck and breaks away shows several steps of its encoder at once."""
    limits = []
    for changes in ([], ["safety.noticing.against_N=0.6"]):
        cell = load_cell(Path("four_wx250s"), ["controller.observer.velocity_gain=1.0", *changes])
        found = knock(cell, against(cell))
        assert found is not None
        limits.append(found.limit_N)
    assert limits == [pytest.approx(STEPS * usual(cell).steps.force_N, rel=2e-3), 0.63]
    assert limits[0] == pytest.approx(0.97, abs=0.02)


def test_limits_are_above_what_24_realities_showed_over_the_slip() -> None:
    """Largest of knock and of the force along gravity, 25 s of sixteen realities of four arms and eight of three."""
    for name, (struck_N, sunk_N) in (("three_wx250s", (0.41, 0.35)), ("four_wx250s", (0.45, 0.37))):
        cell = load_cell(Path(name))
        along = against(cell)
        found = knock(cell, along)
        assert along is not None
        assert found is not None
        assert found.limit_N >= 1.2 * struck_N
        assert STEPS * usual(cell).steps.force_N >= 1.2 * struck_N
        assert min(HANGS, LIFTED) * along.level_N >= 1.4 * sunk_N
        assert along.shaken_N >= 1.4 * sunk_N


@pytest.fixture(scope="module")
def lab() -> Laboratory:
    return Laboratory(load_cell(Path("four_wx250s"), ["simulation.ready_s=0.4"]))


@pytest.mark.parametrize("push_N", [pytest.param((0.0, -10.0, 0.0), marks=pytest.mark.long), (0.0, 0.0, 10.0)])
def test_four_arms_notice_a_push_of_ten_newtons_within_50_ms(lab: Laboratory, push_N: tuple[float, ...]) -> None:
    """No other channel sees either so soon."""
    run = Run(lab, None)
    while run.t < 1.5:
        run.advance()
    run.plant.push(np.array([*push_N, 0.0, 0.0, 0.0]))
    while run.t < 1.55:
        run.advance()
    assert run.trips
    assert Flag.UNEXPECTED in run.trips[0].flags
    assert run.trips[0].why.endswith("N of a blow")


def test_an_arm_that_never_waited_does_not_take_its_first_step_for_a_blow() -> None:
    run = Run(Laboratory(load_cell(Path("four_wx250s"), ["simulation.ready_s=0.0"])), None)
    while run.t < 0.5:
        run.advance()
    assert run.trips == []
