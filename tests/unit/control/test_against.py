"""What pulls against the motion: its sign, a climb that only a growing pull has, and a neighbour noticed by it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agent.config.cell import load_cell
from agent.config.noticing import against
from agent.config.schema.fault import Fault, FaultKind
from agent.control.against import (
    FLAT,
    HANGS,
    LEVEL_AT,
    LIFTED,
    MEANS,
    NO_PULL,
    WEIGHT_AT,
    WITH_CLIMB,
    Against,
    Pull,
    pull_of,
)
from agent.control.cause import Cause, behind
from agent.control.memory import initial
from agent.modes import Mode
from agent.safety import Flag
from agent.study.lab import Laboratory, Run
from tests.support.branched import branched

PERIOD = 5e-3
DOWN = (0.0, 0.0, -1.0)
LAW = Against(PERIOD, level_N=0.7, climb_N=0.14, down=DOWN)
SLOWLY = (0.01, 0.0, 0.0, 0.0, 0.0, 0.0)
NOTHING = (0.0,) * 6


def after(seconds: float, force_at: object, v: tuple[float, ...] = SLOWLY, begin: Pull = NO_PULL) -> list[Pull]:
    """States under a force along x that is a function of time."""
    pulls, pull = [], begin
    for k in range(round(seconds / PERIOD)):
        pull = LAW.advance(pull, (force_at(k * PERIOD), *NOTHING[1:]), NOTHING, v)  # type: ignore[operator]
        pulls.append(pull)
    return pulls


def test_a_pull_back_counts_and_a_pull_ahead_does_not() -> None:
    assert after(1.0, lambda _: -0.5)[-1].level_N == pytest.approx(0.5, abs=1e-3)
    assert after(1.0, lambda _: 0.5)[-1].level_N == pytest.approx(-0.5, abs=1e-3)
    assert LAW.tripped(after(1.0, lambda _: -0.71)[-1], 1.0)
    assert not LAW.tripped(after(1.0, lambda _: 9.0)[-1], 1.0)


def test_the_part_that_is_usual_for_a_while_is_not_in_the_level_but_in_the_climb() -> None:
    base = (-0.4, *NOTHING[1:])
    pull = NO_PULL
    for _ in range(100):
        pull = LAW.advance(pull, (-0.5, *NOTHING[1:]), base, SLOWLY)
    assert pull.level_N == pytest.approx(0.1, abs=1e-3)
    assert pull.means_N == pytest.approx((0.5,) * MEANS)


@pytest.mark.parametrize(
    ("wrench", "v", "expected"),
    [
        ((0.0, -2.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.02, 0.0, 0.0, 0.0, 0.0), 2.0),
        ((2.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.02, 0.0, 0.0, 0.0, 0.0), 0.0),
        ((0.0, 0.0, 0.0, 0.0, 0.0, -0.2), (0.0, 0.0, 0.0, 0.0, 0.0, 0.1), 2.0),  # 0.2 N·m at 0.1 m
        ((-1.0, 0.0, 0.0, 0.0, 0.0, -0.1), (0.01, 0.0, 0.0, 0.0, 0.0, 0.1), math.sqrt(2.0)),  # 0.1 rad/s is 10 mm/s
        ((-9.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0019, 0.0, 0.0, 0.0, 0.0, 0.0), 0.0),  # hardly a direction
    ],
)
def test_the_pull_is_the_part_of_the_wrench_against_the_twist(
    wrench: tuple[float, ...], v: tuple[float, ...], expected: float
) -> None:
    assert LAW.advance(NO_PULL, wrench, NOTHING, v).sum_N == pytest.approx(expected)


@pytest.mark.parametrize("seed", range(4))
def test_every_part_of_the_wrench_and_of_its_slow_part_counts_along_the_twist(seed: int) -> None:
    """p = −(F·v + M·ω) / √(v² + (b ω)²) with b = 0.1 m."""
    W, base, v = np.random.default_rng(seed).normal(size=(3, 6))
    speed = np.linalg.norm(v * np.array([1.0] * 3 + [0.1] * 3))
    pull = LAW.advance(NO_PULL, W.tolist(), base.tolist(), v.tolist())
    assert pull.sum_N == pytest.approx(-W @ v / speed, rel=1e-12)
    assert pull.level_N == pytest.approx(15.0 * PERIOD * -(W - base) @ v / speed, rel=1e-12)


def test_a_twist_has_a_direction_above_two_millimetres_a_second() -> None:
    for speed, pulled in ((2e-3, 0.0), (np.nextafter(2e-3, 1.0), 9.0)):
        assert LAW.advance(NO_PULL, (-9.0, *NOTHING[1:]), NOTHING, (speed, *NOTHING[1:])).sum_N == pulled


def test_a_block_of_two_periods_and_a_half_has_two() -> None:
    slow = Against(0.02, level_N=0.7, climb_N=0.14)
    first = slow.advance(NO_PULL, (-1.0, *NOTHING[1:]), NOTHING, SLOWLY)
    second = slow.advance(first, (-2.0, *NOTHING[1:]), NOTHING, SLOWLY)
    assert (first.ticks, second.ticks) == (1.0, 0.0)
    assert second.means_N[:2] == pytest.approx((1.5, 0.0))


@pytest.mark.parametrize("steps", [(1.0, 2.0, 3.0), (2.0, 1.0, 3.0), (3.0, 2.0, 1.0)])
def test_the_climb_is_the_least_of_three_increments(steps: tuple[float, float, float]) -> None:
    newest, middle, oldest = steps
    blocks = [math.nan] * MEANS
    blocks[0], blocks[3], blocks[6], blocks[9] = (
        5.0 + newest + middle + oldest,
        5.0 + middle + oldest,
        5.0 + oldest,
        5.0,
    )
    assert NO_PULL._replace(means_N=tuple(blocks)).climb_N == 1.0


@pytest.mark.parametrize("slip", [1.0, 2.0])
def test_at_its_limits_a_pull_trips_nothing_and_only_that_of_the_level_grows_with_the_slip(slip: float) -> None:
    law = Against(PERIOD, level_N=0.75, climb_N=0.125)
    climbing = NO_PULL._replace(means_N=tuple(0.125 * (3 - k // 3) for k in range(MEANS)))
    assert climbing.climb_N == 0.125
    assert not law.tripped(climbing._replace(level_N=0.75 * slip), slip)
    assert law.tripped(climbing._replace(level_N=np.nextafter(0.75 * slip, 9.0)), slip)
    steeper = climbing._replace(means_N=tuple(1.01 * mean for mean in climbing.means_N))
    assert not law.tripped(steeper._replace(level_N=0.44), slip)
    assert law.drags(steeper._replace(level_N=0.46), slip)
    noisy = replace(law, climbing_N=0.5)
    assert not noisy.drags(steeper._replace(level_N=0.5), slip)
    assert noisy.drags(steeper._replace(level_N=0.51), slip)
    assert replace(law, climbing_N=9.0).drags(steeper._replace(level_N=0.76 * slip), slip), "no climb hides a pull"
    assert law.tripped(steeper._replace(level_N=0.46), slip)


def test_a_pull_that_grows_climbs_and_one_that_came_at_once_does_not() -> None:
    growing = after(0.7, lambda t: -1.2 * t)
    climbs = [LAW.drags(p._replace(level_N=0.43), 1.0) for p in growing]
    assert not any(LAW.drags(p._replace(level_N=0.41), 1.0) for p in growing), "a part of the limit is asked, too"
    assert WITH_CLIMB == 0.6
    assert growing[-1].climb_N == pytest.approx(1.2 * 0.15, rel=0.05)
    assert 0.4 < PERIOD * climbs.index(True) < 0.55
    assert all(p.climb_N < 0.01 for p in after(2.0, lambda t: -9.0 if t > 0.7 else 0.0))
    assert all(p.climb_N < 0.01 for p in after(2.0, lambda t: 1.2 * t))


def test_what_is_no_number_trips() -> None:
    assert LAW.tripped(NO_PULL._replace(level_N=math.nan), 1.0)
    assert LAW.tripped(NO_PULL._replace(level_N=0.5, means_N=(math.nan,) * MEANS), 1.0)
    assert LAW.tripped(NO_PULL._replace(weight_N=math.nan), 1.0)
    assert not LAW.tripped(NO_PULL, 1.0)


def test_what_pulls_down_is_a_weight_whatever_the_motion_is() -> None:
    for v in (SLOWLY, NOTHING):
        down = (3.0, 0.0, -0.9, 0.0, 0.0, 1.0), (0.0, 0.0, -0.1, 0.0, 0.0, 0.0)
        assert LAW.advance(NO_PULL, *down, v).weight_N == pytest.approx(0.8), "of this tick alone"
    tilted = Against(PERIOD, 0.7, 0.14, down=(0.6, -0.48, -0.64))
    first = tilted.advance(NO_PULL, (1.0, 2.0, 3.0, *NOTHING[3:]), (0.5, 4.0, 1.0, *NOTHING[3:]), SLOWLY)
    assert first.weight_N == pytest.approx(0.6 * 0.5 + 0.48 * 2.0 - 0.64 * 2.0)
    nowhere = Against(PERIOD, 0.7, 0.14)
    assert nowhere.advance(NO_PULL, (3.0, 2.0, -5.0, *NOTHING[3:]), NOTHING, SLOWLY).weight_N == 0.0


@pytest.mark.parametrize("slip", [1.0, 1.5])
def test_a_weight_and_a_lift_have_limits_of_their_own_that_grow_with_the_slip(slip: float) -> None:
    assert (HANGS, LIFTED) == (1.05, 1.25)
    for share, weight in ((1.05, True), (-1.25, False)):
        at = NO_PULL._replace(weight_N=share * 0.7 * slip)
        beyond = NO_PULL._replace(weight_N=np.nextafter(share * 0.7 * slip, 99.0 * share))
        assert not LAW.tripped(at, slip)
        assert LAW.tripped(beyond, slip)
        assert (LAW.weighs(beyond, slip), LAW.lifts(beyond, slip)) == (weight, not weight)
        assert not LAW.drags(beyond, slip)


def test_its_state_goes_through_a_row() -> None:
    pull = after(0.733, lambda t: -1.0 - t)[-1]._replace(weight_N=0.3)
    assert pull.ticks
    assert all(pull.means_N)
    assert pull_of(pull.flat) == pull
    assert pull_of(pull.flat[:-1]) == pull._replace(weight_N=0.0), "a row that is older than the weight"
    assert pull_of([]) == NO_PULL
    assert len(pull.flat) == FLAT
    assert not any(NO_PULL.flat)
    memory = initial(3)
    flat = memory._replace(sense=memory.sense._replace(pull=pull)).flatten()
    assert (flat[LEVEL_AT], flat[WEIGHT_AT]) == (pull.level_N, 0.3)


def test_two_arms_have_it_only_where_it_is_asked_for_and_more_arms_derive_it() -> None:
    assert against(load_cell(Path("two_wx200"))) is None
    given = against(load_cell(Path("two_wx200"), ["safety.noticing.against_N=0.9"]))
    assert given == Against(PERIOD, 0.9, math.inf, DOWN)
    climbs = against(load_cell(Path("two_wx200"), ["safety.noticing.climb_N=0.2"]))
    assert climbs == Against(PERIOD, math.inf, 0.2, DOWN)
    three, four = (against(load_cell(Path(f"{n}_wx250s"))) for n in ("three", "four"))
    assert three is not None
    assert four is not None
    assert (three.level_N, four.level_N) == (0.7, 0.525), "1.05 of an arm's share of 2 N"
    assert (three.climb_N, four.climb_N) == (0.126, 0.126), "of friction and noise"
    rough = against(load_cell(Path("three_wx250s"), ["tolerance.friction=[0.6, 3.0]"]))
    assert rough is not None
    assert rough.level_N > three.level_N
    assert rough.climb_N > three.climb_N
    typed = against(load_cell(Path("three_wx250s"), ["safety.noticing.climb_N=0.3"]))
    assert typed == Against(PERIOD, 0.7, 0.3, DOWN, climbing_N=0.369, shaken_N=0.526)
    typed = against(load_cell(Path("three_wx250s"), ["safety.noticing.against_N=0.9"]))
    assert typed == Against(PERIOD, 0.9, 0.126, DOWN)


def test_coarse_readings_raise_the_limit_of_a_lift_and_no_other() -> None:
    """Down a limp neighbour in a slow motion shows little more than they do."""
    for shaken_N, lifted_N in ((0.8, 1.25 * 0.7), (1.0, 1.0)):
        shaken = replace(LAW, shaken_N=shaken_N)
        assert (shaken.hangs_N, shaken.lifted_N) == pytest.approx((1.05 * 0.7, lifted_N))
    usual = against(load_cell(Path("four_wx250s")))
    coarse = against(load_cell(Path("four_wx250s"), ["controller.observer.velocity_gain=1.0"]))
    assert usual is not None
    assert (usual.shaken_N, usual.hangs_N, usual.lifted_N) == (0.526, *(k * 0.525 for k in (1.05, 1.25)))
    assert coarse == replace(usual, shaken_N=0.84)


def test_down_is_where_gravity_points() -> None:
    for gravity, down in (("[3.0, 0.0, -4.0]", (0.6, 0.0, -0.8)), ("[0.0, 0.0, 0.0]", (0.0, 0.0, 0.0))):
        changes = ["safety.noticing.against_N=0.9", f"world.gravity_m_per_s2={gravity}"]
        found = against(load_cell(Path("two_wx200"), changes))
        assert found is not None
        assert found.down == down


def test_limits_are_above_what_realities_showed() -> None:
    """Largest level and climb of six realities and 37 s of either cell; of three arms with one that once tripped."""
    for name, level_N, climb_N in (("three_wx250s", 0.56, 0.102), ("four_wx250s", 0.30, 0.103)):
        found = against(load_cell(Path(name)))
        assert found is not None
        assert found.level_N >= 1.2 * level_N
        assert found.climb_N >= 1.2 * climb_N
        assert found.climbing_N >= 1.02 * 0.361, (
            "of four arms where the climb was what it may be, of moments counted half"
        )


def test_what_pulls_back_or_down_is_always_named_as_that() -> None:
    g = (0.0, 0.0, -9.81)
    assert behind(np.array([-0.3, 0.0, 0.0]), SLOWLY, g, weighs=False, drags=True) == (Cause.BACK,)
    assert behind(np.array([0.0, 0.3, 0.0]), SLOWLY, g, weighs=False, drags=True) == (Cause.BACK,)
    assert behind(np.array([-0.1, 0.0, -0.3]), SLOWLY, g, weighs=False, drags=True) == (Cause.WEIGHT, Cause.BACK)
    assert behind(np.array([0.3, 0.0, -0.1]), SLOWLY, g, weighs=True, drags=False) == (Cause.WEIGHT,)
    assert behind(np.array([0.3, 0.0, -0.1]), SLOWLY, g, weighs=True, drags=True) == (Cause.WEIGHT, Cause.BACK)
    assert behind(np.array([-0.3, 0.0, -0.2]), SLOWLY, g, weighs=True, drags=False) == (Cause.WEIGHT, Cause.BACK)


def test_of_a_blow_only_its_direction_is_told() -> None:
    g = (0.0, 0.0, -9.81)
    assert behind(np.array([0.0, 0.3, 0.0]), SLOWLY, g, weighs=False, drags=False) == (Cause.PUSH,)
    assert behind(np.array([0.0, 0.0, 0.3]), SLOWLY, g, weighs=False, drags=False) == (Cause.LIFT,)
    assert behind(np.array([-0.3, 0.0, 0.0]), SLOWLY, g, weighs=False, drags=False) == (Cause.BACK,)


LAB = ["simulation.ready_s=0.4"]
BEGIN_S = 2.5  # at 10 mm/s


@pytest.fixture(scope="module")
def lab() -> Laboratory:
    return Laboratory(load_cell(Path("three_wx250s"), LAB))


@pytest.fixture(scope="module")
def given(lab: Laboratory) -> tuple[Run, list[tuple[Pull, Pull | None]]]:
    """A run until BEGIN_S, and per tick the pull of an arm and what the law makes of what it is given."""
    run, found, before = Run(lab, None), [], NO_PULL
    while run.t < BEGIN_S:
        run.advance()
        place = run.places[1]
        outcome, residual = place.outcome, place.agent.residual
        assert outcome is not None
        assert residual is not None
        assert residual.against is not None
        sense, terms, sensed = outcome.memory.sense, outcome.terms, outcome.sensed
        expected = None
        if run.t > 2 * PERIOD:
            assert terms is not None
            assert sensed is not None
            expected = residual.against.advance(before, sensed[:6], sense.base.tolist(), terms.desired.v)
        found.append((sense.pull, expected))
        before = sense.pull
    return run, found


@pytest.fixture
def goes_on(lab: Laboratory, given: tuple[Run, object]) -> Callable[..., Run]:
    return lambda *faults: branched(given[0], lab, *faults)


def test_the_neighbours_of_an_arm_that_holds_notice_within_half_a_second(goes_on: Callable[..., Run]) -> None:
    """At 10 mm/s; no other channel sees it within 0.8 s."""
    run = goes_on(Fault(kind=FaultKind.HOLD, arm="left", at_s=BEGIN_S))
    while run.t < 3.0 and all(place.mode is not Mode.HOLD for place in run.places[1:]):
        run.advance()
    first = next(trip for trip in run.trips if trip.arm != "left")
    assert Flag.UNEXPECTED in first.flags
    assert str(Cause.BACK) in first.why
    assert "N against the motion" in first.why


def test_the_neighbours_of_a_limp_arm_notice_its_weight_within_200_ms(goes_on: Callable[..., Run]) -> None:
    run = goes_on(Fault(kind=FaultKind.LIMP, arm="back", at_s=BEGIN_S))
    while run.t < 2.7 and not run.trips:
        run.advance()
    first = run.trips[0]
    assert first.arm != "back"
    assert Flag.UNEXPECTED in first.flags
    assert first.why.startswith(str(Cause.WEIGHT))
    assert " N down" in first.why


def test_two_newtons_on_the_object_for_half_a_second_are_no_trip() -> None:
    """At the end of such a push the moment is the largest of all."""
    run = Run(Laboratory(load_cell(Path("two_wx200"), LAB)), None)
    while run.t < 2.3:
        run.plant.push(np.array([0.0, 0.0, 2.0 if 1.5 <= run.t < 2.0 else 0.0, 0.0, 0.0, 0.0]))
        run.advance()
    assert run.trips == []


def test_it_is_given_the_unexpected_wrench_its_slow_part_and_the_motion(
    given: tuple[Run, list[tuple[Pull, Pull | None]]],
) -> None:
    for pull, expected in given[1]:
        if expected is not None:
            assert pull.flat == pytest.approx(expected.flat, rel=1e-9, abs=1e-12)
    assert given[1][-1][0].level_N


def test_two_newtons_for_half_a_second_are_no_trip(goes_on: Callable[..., Run]) -> None:
    run = goes_on()
    outcome = run.places[0].outcome
    assert outcome is not None
    assert outcome.terms is not None
    v = np.array(outcome.terms.desired.v[:3])
    run.plant.push(np.concatenate([-2.0 * v / np.linalg.norm(v), np.zeros(3)]))
    while run.t < 3.0:
        run.advance()
    run.plant.push(np.zeros(6))
    while run.t < 3.3:
        run.advance()
    assert not run.trips
