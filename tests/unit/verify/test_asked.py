"""A motion that takes more than its arms may give before they hold is told of before the start, one within is not."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from agent.config.cell import Cell, load_cell
from agent.config.monitors import bounds_of_all
from agent.verify.asked import asked
from agent.verify.check import examine
from agent.verify.finding import Finding, Verdict
from agent.verify.path import along_trajectory, start_configurations

CELL = Path("two_wx200")
SHORT = "duration_s=12.0"


def found_of(cell: Cell) -> list[Finding]:
    models = [cell.model(a) for a in cell.arms]
    instants = np.linspace(0.0, 12.0, 49).tolist()
    starts = start_configurations(cell, models)
    paths = [along_trajectory(cell, *of, instants) for of in zip(cell.arms, models, starts, strict=True)]
    return asked(cell, bounds_of_all(cell), models, paths, instants)


@cache
def told(*changes: str) -> list[tuple[str, str]]:
    """What and where, of this cell with these changes."""
    return [(f.what.partition(": ")[2], f.where) for f in found_of(load_cell(CELL, list(changes)))]


def test_nothing_is_said_of_a_motion_that_stays_within() -> None:
    assert not told()


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ("safety.monitors.power_share=0.001", [("power of shoulder", "left"), ("power of shoulder", "right")]),
        ("safety.monitors.load_share=0.05", [("load of elbow", "left"), ("load of elbow", "right")]),
        (
            "safety.monitors.position_margin_rad=0.5 trajectory.angle_rad=0.2",
            [("position of wrist_angle", "left"), ("position of wrist_angle", "right")],
        ),
        (
            "safety.monitors.position_margin_rad=0.5 trajectory.angle_rad=-0.2",
            [("position of wrist_angle", "left"), ("position of wrist_angle", "right")],
        ),
        ("safety.monitors.workspace_m=[[0.1,0.2],[-0.1,0.1],[0.1,0.4]]", [("workspace along x", "cell")]),
        ("safety.monitors.workspace_m=[[0.1,0.4],[-0.1,0.1],[0.26,0.4]]", [("workspace along z", "cell")]),
        ("safety.tracking_error_max_m=3e-4", [("half a step of encoders and tracking_error_max_m", "cell")]),
        ("safety.tracking_error_max_rad=1e-3", [("half a step of encoders and tracking_error_max_rad", "cell")]),
    ],
    ids=["power", "load", "above", "below", "x", "z", "position error", "attitude error"],
)  # fmt: skip
def test_the_worst_of_each_bound_is_named(change: str, expected: list[tuple[str, str]]) -> None:
    assert told(*change.split()) == expected


def test_a_speed_that_servos_hardly_reach_holds_the_arm() -> None:
    assert [where for what, where in told("trajectory.period_s=0.15") if what.startswith("speed of ")] == [
        "left",
        "right",
    ]


@pytest.mark.parametrize("monitor", ["power", "load", "workspace"])
def test_nothing_is_said_of_what_nobody_watches(monitor: str) -> None:
    bounds = {
        "power": "safety.monitors.power_share=0.001",
        "load": "safety.monitors.load_share=0.05",
        "workspace": "safety.monitors.workspace_m=[[0.1,0.2],[-0.1,0.1],[0.1,0.4]]",
    }
    assert not told(bounds[monitor], f"safety.monitors.off=['{monitor}']")


def test_a_run_that_ends_before_windings_are_warm_is_not_told_of() -> None:
    """A mean over 30 s gets to 1 − e^{−T/30} of the square: after 3 s to 0.31 of the share."""
    assert not told("safety.monitors.load_share=0.1", "duration_s=3.0")
    assert told("safety.monitors.load_share=0.1", "duration_s=60.0")


def worst_of(**figures: list[float]) -> list[Finding]:
    """Of the left arm, whose path has these figures instead of its own."""
    cell = load_cell(CELL)
    models = [cell.model(a) for a in cell.arms]
    left, right = (
        along_trajectory(cell, *of, [0.0])
        for of in zip(cell.arms, models, start_configurations(cell, models), strict=True)
    )
    path = replace(left, **{key: np.array(figure) for key, figure in figures.items()})  # type: ignore[arg-type]
    return asked(cell, bounds_of_all(cell), models, [path, right], [0.0])


def test_the_joint_that_is_farthest_beyond_its_bound_is_named_whatever_the_bounds_are() -> None:
    bounds = bounds_of_all(load_cell(CELL))[0]
    shoulder, elbow, _ = bounds.power_W
    (found,) = worst_of(power_peak=[shoulder + 0.1, elbow + 0.2, 0.0])
    assert (found.what, found.where) == ("motion against monitors: power of elbow", "left")
    assert (found.found, found.wanted) == (f"{elbow + 0.2:.3g} W", f"≤ {elbow:.3g}")


@pytest.mark.parametrize("end", [0, 1])
def test_both_ends_of_a_range_count(end: int) -> None:
    ranges = bounds_of_all(load_cell(CELL))[0].position_rad
    sign = (-1.0, 1.0)[end]
    (found,) = worst_of(q=[[0.0, 0.0, 0.0], [0.0, ranges[1][end] + sign * 0.125, 0.0]])
    assert (found.what, found.found) == ("motion against monitors: position of elbow", "0.125 rad beyond its range")
    assert not worst_of(q=[[0.0, 0.0, 0.0], [0.0, ranges[1][end] - sign * 0.125, 0.0]])


def test_half_a_step_of_every_encoder_moves_the_object_by_so_much() -> None:
    cell = load_cell(Path("three_wx250s"), ["safety.tracking_error_max_m=1e-6", "safety.tracking_error_max_rad=1e-6"])
    models = [cell.model(a) for a in cell.arms]
    starts = start_configurations(cell, models)
    paths = [along_trajectory(cell, *of, [0.0]) for of in zip(cell.arms, models, starts, strict=True)]
    place, attitude = (f for f in asked(cell, bounds_of_all(cell), models, paths, [0.0]) if "half a step" in f.what)
    half = np.pi / 4096.0
    each = [
        (half * np.linalg.norm(J[:3]), half * np.linalg.norm(J[3:]))
        for J in (m.jacobian(q) for m, q in zip(models, starts, strict=True))
    ]
    assert (place.found, attitude.found) == tuple(
        f"{size:.3g} {unit}" for size, unit in zip(np.max(each, axis=0), ("m", "rad"), strict=True)
    )


def test_arms_that_servos_move_are_refused() -> None:
    change = "safety.monitors.power_share=0.001"
    verdicts = {f.verdict for f in found_of(load_cell(CELL, [change]))}
    real = {f.verdict for f in found_of(load_cell(CELL, [change, "driver='dynamixel'"]))}
    assert (verdicts, real) == ({Verdict.WARNING}, {Verdict.REFUSED})


def test_a_thorough_check_has_them() -> None:
    cell = load_cell(CELL, ["safety.monitors.power_share=0.001"])
    assert [f for f in examine(cell, thorough=True).findings if "monitors: power of" in f.what]
