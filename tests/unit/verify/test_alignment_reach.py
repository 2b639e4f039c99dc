"""Limits of the alignment beyond what an arm can follow are told with the limits that it can."""

from __future__ import annotations

import pytest

from agent.config.cell import Cell, ConfigError
from agent.verify.alignment_reach import alignment_reach, set_to
from agent.verify.check import _instants, examine
from agent.verify.finding import Finding, Verdict
from agent.verify.path import along_trajectory
from agent.verify.robustness import REACH_PLACES, Walk
from tests.support.control.criterion_cells import cell_of, gentle
from tests.support.starts import start_joints

SERVOS = ('driver="dynamixel"', 'arms.left.dynamixel={port="/dev/a"}', 'arms.right.dynamixel={port="/dev/b"}')


def limits(cell: Cell) -> list[Finding]:
    """Of the cell's own motion, as a check finds them beside much else that takes longer."""
    models, instants = [cell.model(arm) for arm in cell.arms], _instants(cell).times
    starts = zip(cell.arms, models, start_joints(cell), strict=True)
    paths = [along_trajectory(cell, arm, model, q, instants).q for arm, model, q in starts]
    few = Walk(cell, models, list(zip(*paths, strict=True)), instants).some(REACH_PLACES)
    return alignment_reach(cell, models, few.along, few.instants)


@pytest.mark.parametrize(
    "name", ["paper", *(pytest.param(name, marks=pytest.mark.long) for name in ("three_wx250s", "two_wx200"))]
)
def test_the_default_limits_are_within_reach_of_every_follower(name: str) -> None:
    found = limits(gentle(name, "controller.alignment.track_per_s=0.3"))
    arms = cell_of(name).arms
    assert [f.where for f in found] == [arm.name for arm in arms[1:]]
    assert {f.verdict for f in found} == {Verdict.OK}


def test_the_anchor_follows_nothing_and_without_alignment_nobody_does() -> None:
    assert [f.where for f in limits(gentle("paper", 'controller.alignment.anchor="right"'))] == ["left"]
    assert limits(gentle("paper", 'controller.alignment.anchor="left"', "controller.alignment.max_m=0.001"))
    assert alignment_reach(cell_of("paper_real", "controller.alignment.enabled=false"), (), (), ()) == []
    assert alignment_reach(cell_of("identify_mk2", "controller.alignment.enabled=true"), (), (), ()) == []


def test_limits_beyond_reach_are_refused_where_servos_move_the_arms_with_those_that_are_not() -> None:
    wide = ("controller.alignment.max_rad=0.5", "safety.sigma_min=0.06", "controller.alignment.max_m=0.1")
    cell = gentle("paper", *wide, *SERVOS)
    with pytest.raises(
        ConfigError, match=r"limits of the alignment \(right\): found out of reach at t = .*set max_m = "
    ) as caught:
        examine(cell).require()
    assert "\n" not in str(caught.value)
    warned = limits(gentle("paper", *wide))[0]
    assert warned.verdict is Verdict.WARNING
    max_m, max_rad = warned.remedy.removeprefix("set max_m = ").split(" and max_rad = ")
    assert 0.0 < float(max_m) < 0.1
    narrow = (f"controller.alignment.max_m={max_m}", f"controller.alignment.max_rad={max_rad}", "safety.sigma_min=0.06")
    assert limits(gentle("paper", *narrow))[0].verdict is Verdict.OK


def test_an_anchor_that_does_not_exist_is_refused_with_those_that_do() -> None:
    with pytest.raises(ConfigError, match=r"controller\.alignment\.anchor.*'middle', expected left or right"):
        cell_of("paper", 'controller.alignment.anchor="middle"')


@pytest.mark.parametrize(
    ("anchor", "follower"), [("right", "left"), pytest.param("left", "right", marks=pytest.mark.long)]
)
def test_away_from_the_base_is_out_of_reach_first_on_either_side(anchor: str, follower: str) -> None:
    far = ("controller.alignment.max_m=0.1", "controller.alignment.max_rad=0.001", "safety.sigma_min=0.05")
    found = limits(gentle("paper", *far, f'controller.alignment.anchor="{anchor}"'))
    assert [(f.where, f.verdict) for f in found] == [(follower, Verdict.WARNING)]


def test_limits_that_are_named_hold() -> None:
    """Two digits of them, rounded down: 0.59375 is the most of 64 parts that holds."""
    said = set_to(cell_of("paper", "controller.alignment.max_m=0.02", "controller.alignment.max_rad=0.1"), is_little)
    assert said == "set max_m = 0.011 and max_rad = 0.059"


def is_little(part: float) -> bool:
    return part < 0.6
