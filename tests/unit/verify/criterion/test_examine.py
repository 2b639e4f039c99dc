"""The criterion as a whole: figures of shipped cells, what more reality may do to them, and its longest delay."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from agent.verify.criterion.cases import Aligning, Case, Demand, Ranges, alone, near, rigid, soft
from agent.verify.criterion.examine import DELAY_STEP, Criterion, examine, rank
from agent.verify.criterion.judge import Judge
from tests.support.control.criterion_cells import cell_of, first, gentle, loop_of, ranges_of, start_pose
from tests.support.control.level_wx200 import LEVEL

LONG = pytest.mark.long


@cache
def examined(name: str, *overrides: str, **changes: object) -> Criterion:
    cell = gentle(name, *overrides)
    return examine([start_pose(cell)], loop_of(cell), replace(ranges_of(cell), **changes))  # type: ignore[arg-type]


# the prototype's cells, where ours have changed since
THEIRS = {
    "two_wx200": LEVEL,
    "three_wx250s": (
        "object.mass_kg=0.3", "object.inertia_kg_m2={xx=5.8e-4, yy=1.09e-3, zz=1.49e-3}",
        "arms.left.load_share=0.4", "arms.back.load_share=0.3", "arms.front.load_share=0.3",
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "radius", "demand", "arm"),
    [
        ("paper", 1.533, Demand.BARE, 0),
        pytest.param("two_wx200", 1.238, Demand.BARE, None, marks=LONG),  # of two equal arms rounding chooses
        pytest.param("two_models", 1.238, Demand.BARE, 0, marks=LONG),
        ("three_wx250s", 1.104, Demand.BARE, 0),
    ],
)
def test_the_gains_as_printed_do_not_survive_an_open_gripper(
    name: str, radius: float, demand: Demand, arm: int | None
) -> None:
    """Figures of an independent prototype."""
    cell = first(name, *THEIRS.get(name, ()))
    found = examine([start_pose(cell)], loop_of(cell), ranges_of(cell))
    assert found.radius == pytest.approx(radius, abs=1e-3)
    assert found.cases[0].case.demand is demand
    assert arm in (None, found.cases[0].case.arm)
    assert found.delay_margin_s is None


@pytest.mark.parametrize(
    "name", ["paper", *(pytest.param(name, marks=LONG) for name in ("two_wx200", "two_models", "three_wx250s"))]
)
def test_gentler_gains_survive_it(name: str) -> None:
    cell, found = gentle(name), examined(name)
    assert 0.95 < found.radius < 0.995
    assert set(found.worst) == set(Demand) - {Demand.ALIGNING}
    assert found.delay_margin_s is not None
    assert found.delay_margin_s > 1.25 * cell.file.delay_s
    radii = [f.radius for f in found.cases]
    assert radii == sorted(radii, reverse=True)


@pytest.mark.parametrize(
    ("name", "inertia_error"),
    [("paper", 0.3), ("paper_real", 0.1), pytest.param("two_models", 0.1, marks=LONG)],
    ids=["heavy is worst", "light at long delays only", "of unlike arms"],
)
def test_at_the_longest_delay_all_is_stable_and_a_little_later_something_is_not(
    name: str, inertia_error: float
) -> None:
    cell = gentle(name) if name == "paper" else cell_of(name)
    judge, ranges = Judge([start_pose(cell)], loop_of(cell)), replace(ranges_of(cell), inertia_error=inertia_error)
    found = examine(judge.poses, judge.loop, ranges)
    assert found.delay_margin_s is not None
    margin = found.delay_margin_s * cell.file.rate_hz

    def worst(delay: float) -> float:
        cases = [*alone(2, ranges, [0], [delay]), *rigid(ranges, [0], [delay]), *soft(ranges, 0, delay, 2)]
        return rank(judge, ranges, cases)[0].radius

    assert worst(margin - DELAY_STEP) < 1.0 < worst(margin + 2.0 * DELAY_STEP)


@pytest.mark.parametrize(("beyond", "found"), [(1e-3, 1e-3), (0.05, 0.0)], ids=["stable", "unstable"])
def test_bisection_ends_at_the_stated_delay_where_all_is_stable_there(beyond: float, found: float) -> None:
    """The other end of its last interval is 0.034 periods farther, and unstable."""
    cell = cell_of("identify_wx200")
    poses, loop, ranges = [start_pose(cell)], loop_of(cell), ranges_of(cell)

    def margin(longest: float) -> float:
        margin_s = examine(poses, loop, replace(ranges, delay_periods=(0.8, 1.0, longest))).delay_margin_s
        assert margin_s is not None
        return margin_s / loop.period_s

    bisected = margin(1.0)
    assert 1.0 < bisected < 3.0
    assert margin(bisected + beyond) == pytest.approx(bisected + found, abs=1e-9)


@pytest.mark.parametrize(
    "wider",
    [
        {"delay_periods": (0.8, 1.0, 1.6)},
        pytest.param({"inertia_error": 0.5}, marks=LONG),
        pytest.param({"pads_N_per_m": (1e2, 1e7)}, marks=LONG),
        pytest.param({"object_error": 0.6}, marks=LONG),
        pytest.param({"friction": 0.0}, marks=LONG),
        pytest.param({"delay_periods": (0.2, 1.0, 1.25)}, marks=LONG),
        pytest.param({"pads_Nm_per_rad": (0.5, 1e4)}, marks=LONG),
        pytest.param({"pads_damping_ratio": 0.05}, marks=LONG),
    ],
)
def test_more_reality_is_never_easier(wider: dict[str, object]) -> None:
    assert examined("paper", **wider).radius >= examined("paper").radius - 2e-3


def test_the_worst_case_is_named() -> None:
    wrist = examined("paper", "arms.left.k_v_Nm_s_per_rad=0.6").cases[0]
    heavier = examined("paper", object_error=0.8).cases[0]
    assert wrist.radius > 1.0
    assert (wrist.case.demand, wrist.case.arm, wrist.case.inertia) == (Demand.BARE, 0, 0.7)
    assert (heavier.case.demand, heavier.case.load) == (Demand.HOLDING, 1.8)


def test_the_order_of_the_arms_does_not_matter() -> None:
    uneven = "arms.left.k_v_Nm_s_per_rad=0.6"
    cell, one = gentle("paper", uneven), examined("paper", uneven)
    at, loop, ranges = start_pose(cell), loop_of(cell), ranges_of(cell)
    turned = replace(at, grips=at.grips[::-1])
    swapped = replace(loop, gains=loop.gains[::-1])
    other = examine([turned], swapped, ranges)
    assert one.radius == pytest.approx(other.radius, rel=1e-9)
    assert {f.case.arm for f in one.cases[:1]} != {f.case.arm for f in other.cases[:1]}


def test_stiffnesses_between_those_looked_at_are_hardly_worse() -> None:
    random = np.random.default_rng(2)
    for name in ("paper", "two_wx200"):
        cell = gentle(name)
        judge, ranges = Judge([start_pose(cell)], loop_of(cell)), ranges_of(cell)
        cases = [
            Case(Demand.SOFT, 0, delay, inertia, load, None, 10.0**k_t, 10.0**k_r)
            for delay, inertia, load, k_t, k_r in zip(
                random.uniform(0.8, 1.25, 200), random.uniform(0.7, 1.3, 200), random.uniform(0.8, 1.2, 200),
                random.uniform(2.0, 6.0, 200), random.uniform(0.0, 3.0, 200), strict=True,
            )
        ]  # fmt: skip
        assert rank(judge, ranges, cases)[0].radius < examined(name).worst[Demand.SOFT].radius + 2e-3


def test_neighbours_of_a_grasp_stay_in_the_range() -> None:
    ranges = Ranges((0.8, 1.0, 1.25))
    corner = Case(Demand.SOFT, 0, 1.0, 1.0, 1.0, None, 1e6, 1.0)
    assert {(c.k_t, c.k_r) for c in near(ranges, corner, 10.0)} == {(1e6, 10.0), (1e5, 1.0), (1e5, 10.0)}


def test_the_sweep_reaches_from_softer_than_the_softest_pad_to_the_stiffest() -> None:
    ranges = Ranges((0.8, 1.0, 1.25), pads_N_per_m=(2e3, 2e5), pads_Nm_per_rad=(10.0, 10.0))
    pairs = ranges.grasps(1)
    assert sorted({k_t for k_t, _ in pairs}) == pytest.approx([2e2, 2e3, 2e4, 2e5])
    assert sorted({k_r for _, k_r in pairs}) == pytest.approx([2.0, 10.0])
    assert len(ranges.grasps(3)) > 2 * len(pairs)


@pytest.mark.parametrize(
    "wrong",
    [
        {"pads_N_per_m": (1e6, 1e3)},
        {"pads_Nm_per_rad": (0.0, 1.0)},
        {"delay_periods": (1.0, 0.5, 2.0)},
        {"delay_periods": (-0.5, 0.5, 2.0)},
    ],
)
def test_what_is_no_range_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"no range|no delays in ascending order"):
        replace(Ranges((0.8, 1.0, 1.25)), **wrong)  # type: ignore[arg-type]


def test_alignment_is_looked_at_where_there_is_some_and_its_creep_is_no_instability() -> None:
    cell = gentle("paper")
    aligned = examine([start_pose(cell)], loop_of(cell, Aligning(1, 2.0)), ranges_of(cell))
    assert 0.99 < aligned.worst[Demand.ALIGNING].radius < 1.0
    assert aligned.radius == pytest.approx(examined("paper").radius)
    hasty = examine([start_pose(cell)], loop_of(cell, Aligning(1, 400.0)), ranges_of(cell))
    assert hasty.worst[Demand.ALIGNING].radius > 1.0


def test_one_arm_has_no_grasps_between_arms() -> None:
    cell = cell_of("identify_wx200")
    found = examine([start_pose(cell)], loop_of(cell), ranges_of(cell))
    assert set(found.worst) == {Demand.BARE, Demand.HOLDING}
