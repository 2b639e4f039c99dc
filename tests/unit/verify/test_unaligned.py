"""Arms without alignment: what check says of the begin at the stated tolerance, and what the arms make of it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from agent.config.cell import Cell, load_cell
from agent.config.schema.reality import ArmReality, Reality
from agent.config.schema.tolerance import ZEROS_PLANAR_RAD
from agent.control.models import Matrix
from agent.study.lab import Laboratory, Run
from agent.verify.check import examine, start_configurations
from agent.verify.finding import Finding, Verdict
from agent.verify.noticing import blow_limits
from agent.verify.unaligned import blow_at_start, unaligned
from tests.support.few import long

OFF = "controller.alignment.enabled=false"
READY = "simulation.ready_s=1.5"  # until what the support and friction gave has gone
REAL, SESSION = 'driver="dynamixel"', "session.lift_m=0.015"
SMALL = ("tolerance.base_rad=0.0", "tolerance.grasp_m=0.0", "tolerance.zeros_rad=0.0")
TOLERANCE = "at the stated tolerance"
ERRORS = ("base_m", "base_rad", "grasp_m", "grasp_rad", "zeros_rad")


def only(name: str, key: str, size: float) -> Cell:
    """The cell without alignment and with this error alone."""
    errors = dict.fromkeys(ERRORS, 0.0) | {key: size}
    return load_cell(Path(name), [OFF, READY, *(f"tolerance.{k}={x}" for k, x in errors.items())])


def at_start(c: Cell) -> tuple[float, float]:
    models = [c.model(arm) for arm in c.arms]
    return blow_at_start(c, models, start_configurations(c, models))


def found_of(name: str, *changes: str) -> list[Finding]:
    c = load_cell(Path(name), changes)
    models = [c.model(arm) for arm in c.arms]
    return unaligned(c, models, start_configurations(c, models))


def directions(c: Cell, key: str) -> Matrix:
    """(k, 3) the directions that such an error may have."""
    rows = c.model(c.arms[0]).task_basis[:, slice(3) if key.endswith("_m") else slice(3, 6)]
    return rows[np.linalg.norm(rows, axis=1) > 0.5]


def begin(c: Cell, key: str, error: tuple[float, float, float]) -> tuple[bool, Matrix]:
    """Whether an arm holds at once where all are off by this, and what each feels (N, 2): N, N·m."""
    arms = {arm.name: ArmReality.model_validate({key: error}) for arm in c.arms}
    run, felt = Run(Laboratory(c), Reality(arms=arms)), np.zeros((len(c.arms), 2))
    while run.t < 0.05:
        run.advance()
        if run.t > 0.0 and not felt.any():
            felt = np.array([p.outcome.sensed[6:8] for p in run.places if p.outcome and p.outcome.sensed])
    return any(trip.t < 0.02 for trip in run.trips), felt


@pytest.mark.parametrize(
    ("name", "key", "half"),
    [
        ("two_wx200", "base_m", 0.5),
        ("paper_real", "grasp_m", 0.5),
        long(("two_wx200", "base_rad", 0.5)),
        long(("three_wx250s", "base_m", 0.25)),  # their limit is so low that friction takes a part of it
    ],
)
def test_arms_off_by_twice_of_what_check_allows_hold_at_once_and_by_half_they_do_not(
    name: str, key: str, half: float
) -> None:
    most_N, surely_N, most_Nm = blow_limits(only(name, key, 0.0))
    force, moment = at_start(only(name, key, 1e-3))
    for times, holds in ((2.0, True), (half, False)):
        limit_N = surely_N if holds else most_N  # a smaller one may be a touch
        size = 1e-3 * times * min(limit_N / force, most_Nm / moment)
        c = only(name, key, size)
        each = [begin(c, key, tuple((size * way).tolist())) for way in directions(c, key)]
        assert [trips for trips, _ in each] == [holds] * len(each)
        told = np.array(at_start(c))
        found = np.sqrt(np.mean([felt**2 for _, felt in each], axis=0)).max(axis=0)
        usual = (1.0, 0.25) if "paper" in name else (0.2, 0.05)  # of friction
        assert (np.abs(found - told) <= np.add(usual, 0.05 * told)).all()


@pytest.mark.parametrize("times", [0.9, 1.1])
def test_check_says_how_much_of_the_stated_errors_is_well(times: float) -> None:
    (found,) = found_of("two_wx200", OFF)
    match = re.search(r"calibrate bases, grasps and zeros to ([\d.]+)% of what", found.remedy)
    assert match is not None
    stated, part = load_cell(Path("two_wx200")).tolerance, 0.01 * times * float(match[1])
    sizes = [stated.base_m, stated.base_rad, stated.grasp_m, stated.grasp_rad, ZEROS_PLANAR_RAD]
    changes = [f"tolerance.{key}={part * size}" for key, size in zip(ERRORS, sizes, strict=True)]
    (found,) = found_of("two_wx200", OFF, *changes)
    assert found.verdict is (Verdict.OK if times < 1.0 else Verdict.WARNING)


@pytest.mark.parametrize(
    ("name", "changes", "verdict"),
    [
        ("two_wx200", [], Verdict.WARNING),
        ("two_wx200", [REAL], Verdict.REFUSED),
        ("two_wx200", [REAL, "tolerance.base_m=0.0003", *SMALL], Verdict.OK),
        ("two_wx200", [REAL, "tolerance.base_m=0.0008", *SMALL], Verdict.WARNING),  # it may be a touch
        ("two_wx200", [SESSION], Verdict.WARNING),
        ("three_wx250s", [], Verdict.WARNING),
    ],
)
def test_arms_without_alignment_are_warned_of_and_real_ones_refused(
    name: str, changes: list[str], verdict: Verdict
) -> None:
    (found,) = found_of(name, OFF, *changes)
    assert found.verdict is verdict, found


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("two_wx200", []),
        ("two_wx200", [OFF, "safety.noticing.enabled=false"]),
        ("two_wx200", [OFF, REAL, SESSION]),
        ("paper", []),
        ("paper_ideal", []),
        ("identify_wx200", []),
    ],
)
def test_nothing_is_said_of_arms_that_align_notice_nothing_or_grip_where_they_see_the_object(
    name: str, changes: list[str]
) -> None:
    assert found_of(name, *changes) == []


def test_a_thorough_check_says_it() -> None:
    (found,) = [
        f for f in examine(load_cell(Path("two_wx200"), [OFF]), thorough=True).findings if f.what.endswith(TOLERANCE)
        and f.what.startswith("what the begin")
    ]  # fmt: skip
    assert found.found == "12 N, 1.4 N·m at once (quadratic sum)"
    assert found.wanted == "≤ 1.75 N, 0.35 N·m"
