"""What check says of reality: the worst case by name, a warning in simulation, a refusal where servos move the arms."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from agent.cli.documents import check_document
from agent.config.cell import Cell, ConfigError
from agent.verify.check import CheckReport, examine, start_configurations
from agent.verify.criterion.cases import Aligning, Demand
from agent.verify.criterion.examine import Found
from agent.verify.disagreement import disagreement
from agent.verify.finding import Finding, Verdict
from agent.verify.path import along_trajectory
from agent.verify.robustness import Walk, loop_of, poses, ranges_of
from tests.support.control.criterion_cells import cell_of, first, gentle

SERVOS = (
    'driver="dynamixel"',
    'arms.left.dynamixel={port="/dev/a"}',
    'arms.right.dynamixel={port="/dev/b"}',
)
ALIGNED = ("controller.alignment.ready_per_s=2.0",)
WORN = ("tolerance.delay=[0.8, 2.0]", "tolerance.delay_jitter_s=1e-3", "tolerance.backlash_rad=0.004")


@cache
def looked_at(gains: Callable[..., Cell], name: str, *overrides: str) -> CheckReport:
    """The whole check of a cell."""
    return examine(gains(name, *overrides), thorough=True)


def findings(report: CheckReport) -> dict[str, Finding]:
    return {f.what: f for f in report.findings if f.what.startswith("stable") or f.what.startswith("longest")}


def of_left(report: CheckReport) -> dict[str, Finding]:
    """What is said of the left arm."""
    return {f.what: f for f in report.findings if f.where == "left"}


def test_the_worst_case_is_named_with_its_reality() -> None:
    found = findings(looked_at(first, "paper"))
    alone = found["stable: arm alone"]
    assert alone.where == "left"
    assert alone.found.startswith("1.5")
    assert "arms' inertia -30%" in alone.found
    assert "an arm whose gripper opens would swing up" in alone.remedy
    assert "pads 1e+02 N/m, 1 N·m/rad" in found["stable: cell with soft grasps"].found
    assert found["longest delay with all of this stable"].found == "none"


def test_a_locked_arm_is_judged_by_the_time_until_it_is_noticed_which_is_said() -> None:
    report = looked_at(cell_of, "paper_real")
    for what in ("this arm locked", "this arm holding"):
        found = of_left(report)[what]
        assert re.search(r"% of stall \(right [a-z_]+, t = [0-9.]+ s\), noticed after about [0-9.]+ s$", found.found)
        assert found.verdict is Verdict.OK


def test_an_arm_that_nobody_notices_is_fought_up_to_the_torque_bound_which_is_a_warning_and_no_refusal() -> None:
    report = looked_at(first, "paper")
    assert report.ok
    for what in ("this arm locked", "this arm holding"):
        found = of_left(report)[what]
        assert found.verdict is Verdict.WARNING
        assert found.found.startswith("up to the torque bound, 50% of stall (right ")
        assert found.found.endswith("noticing is off: the others fight it until a monitor, or their error, holds them")
        assert found.remedy == "switch on safety.noticing, or take softer gains"


def test_within_the_bound_it_is_said_by_which_error_an_arm_that_nobody_notices_is_fought() -> None:
    small = ("trajectory.p_amplitude_m=[1e-3, 0.0, 0.0]", "trajectory.angle_rad=0.0")
    found = of_left(examine(gentle("paper", *small), thorough=True))["this arm holding"]
    assert found.verdict is Verdict.OK
    until = "the others fight it until they are 50 mm or 300 mrad off, or as far as the motion goes"
    assert found.found.endswith(f" s); noticing is off: {until}")


@pytest.mark.parametrize(
    ("name", "more", "wanted", "verdict"),
    [
        ("paper_real", ("controller.alignment.enabled=true",), "≤ 2 N", Verdict.OK),
        ("paper_real", (), "≤ 2 N", Verdict.WARNING),
        ("paper_real", ("controller.alignment.enabled=true", "tolerance.zeros_rad=0.05"), "≤ 2 N", Verdict.WARNING),
        (
            "paper_real",
            ("controller.alignment.enabled=true", "tolerance.friction=[0.0, 10.0]"),
            "≤ 2 N",
            Verdict.WARNING,
        ),
        (
            "paper_real",
            ("controller.alignment.enabled=true", "tolerance.torque_constant=0.8"),
            "≤ 2 N",
            Verdict.WARNING,
        ),
        (
            "paper_real",
            ("controller.alignment.enabled=true", "arms.left.grip_force_max_N=1.6"),
            "≤ 1.3 N",  # its share of the object is held by the same grip
            Verdict.WARNING,
        ),
        ("three_wx250s", (), "≤ 8 N", Verdict.OK),
    ],
)
def test_an_internal_wrench_that_tolerances_may_make_is_judged_whether_it_breaks_the_loop_or_not(
    name: str, more: tuple[str, ...], wanted: str, verdict: Verdict
) -> None:
    """At a dozen places, as the check looks at them, by its words."""
    cell = cell_of(name, *more)
    models, times = [cell.model(arm) for arm in cell.arms], np.linspace(0.0, cell.trajectory().period_s, 12).tolist()
    each = zip(cell.arms, models, start_configurations(cell, models), strict=True)
    paths = [along_trajectory(cell, arm, model, q, times).q for arm, model, q in each]
    walk = Walk(cell, models, list(zip(*paths, strict=True)), times)
    apart = disagreement(cell, models, poses(walk), walk.along, walk.instants)
    whole = looked_at(first, "paper").robustness
    assert whole is not None
    found, *_ = replace(whole, walk=walk, disagreement=apart)._internal()
    assert (found.where, found.wanted, found.verdict) == (cell.arms[0].name, wanted, verdict), found


def test_the_whole_check_judges_the_internal_wrench_at_the_stated_tolerance() -> None:
    found = of_left(looked_at(cell_of, "paper_real"))["internal wrench at the stated tolerance"]
    assert (found.wanted, found.verdict) == ("≤ 2 N", Verdict.WARNING), found


def test_jitter_counts_as_delay_and_backlash_is_said_to_count_nowhere() -> None:
    plain, worn = (ranges_of(gentle("paper", *more)).delay_periods for more in ((), ("tolerance.delay_jitter_s=1e-3",)))
    assert plain == (0.8, 1.0, 1.25)
    assert worn == pytest.approx((0.6, 1.0, 1.45))
    assert ranges_of(gentle("paper", "loop_delay_s=1e-4", "tolerance.delay_jitter_s=1e-3")).delay_periods[0] == 0.0
    report = looked_at(gentle, "paper", *WORN)
    assert findings(report)["longest delay with all of this stable"].wanted == "≥ 11 ms", "twice 5 ms, and 1 ms"
    (gears,) = (f for f in report.findings if f.what == "backlash of the gears")
    assert (gears.verdict, gears.found) == (Verdict.OK, "up to 4 mrad, in no figure of this check")
    assert not any(f.what == "backlash of the gears" for f in looked_at(first, "paper").findings)


def test_in_simulation_it_warns_and_where_servos_move_the_arms_it_refuses() -> None:
    simulated = looked_at(first, "paper")
    assert simulated.ok
    assert {f.verdict for f in findings(simulated).values()} == {Verdict.WARNING}
    real = examine(first("paper", *SERVOS))
    assert {f.verdict for f in findings(real).values()} == {Verdict.REFUSED}
    with pytest.raises(ConfigError, match=r"stable: arm alone \(left\): found 1\.5.*coop tune"):
        real.require()


@pytest.mark.parametrize(
    "cell",
    [
        ("paper", *SERVOS, *ALIGNED),
        *(pytest.param((name,), marks=pytest.mark.long) for name in ("two_wx200", "three_wx250s")),
    ],
)
def test_gains_that_survive_are_neither_warned_of_nor_refused(cell: tuple[str, ...]) -> None:
    report = looked_at(gentle, *cell)
    assert report.ok
    assert {f.verdict for f in findings(report).values()} == {Verdict.OK}


def test_a_simulated_cell_is_looked_at_thoroughly_only_where_that_is_asked() -> None:
    assert examine(first("paper")).robustness is None
    assert not findings(examine(first("paper")))
    assert not findings(examine(first("paper", *SERVOS), thorough=False))


def test_the_document_carries_the_figures() -> None:
    cell = first("paper")
    document = json.loads(json.dumps(check_document(cell, looked_at(first, "paper"))))["robustness"]
    assert document["spectral_radius"] == pytest.approx(1.546, abs=1e-3)
    assert document["delay_margin_s"] is None
    worst = document["worst"]["bare"]
    assert (worst["arm"], worst["inertia"], worst["pads_N_per_m"]) == ("left", 0.7, None)
    assert document["worst"]["soft"]["pads_N_per_m"] == pytest.approx(100.0)
    assert check_document(cell, examine(cell))["robustness"] is None


def test_the_delay_margin_is_in_milliseconds_and_wants_the_stated_delay() -> None:
    found = looked_at(gentle, "paper")
    margin = findings(found)["longest delay with all of this stable"]
    assert found.robustness is not None
    assert found.robustness.criterion.delay_margin_s is not None
    assert margin.found == f"{found.robustness.criterion.delay_margin_s * 1e3:.3g} ms"
    assert margin.wanted == "≥ 6.25 ms"
    wider = findings(looked_at(gentle, "paper", *WORN))
    assert wider["longest delay with all of this stable"].verdict is Verdict.WARNING


def test_the_ranges_are_those_that_the_cell_states() -> None:
    stated = (
        "tolerance.delay=[0.9, 1.5]", "tolerance.object=0.1", "tolerance.friction=[0.2, 2.0]",
        "tolerance.pads_N_per_m=[2e3, 2e4]", "tolerance.pads_Nm_per_rad=[7.0, 70.0]",
        "tolerance.pads_damping_ratio=0.1", "safety.inertia_error=0.15", "loop_delay_s=0.004",
    )  # fmt: skip
    found = ranges_of(cell_of("paper", *stated))
    assert found.delay_periods == pytest.approx((0.72, 0.8, 1.2))
    assert (found.inertia_error, found.object_error, found.friction) == (0.15, 0.1, 0.2)
    assert (found.pads_N_per_m, found.pads_Nm_per_rad) == ((2e3, 2e4), (7.0, 70.0))
    assert found.pads_damping_ratio == 0.1
    assert ranges_of(cell_of("paper", "tolerance.masses=0.5")).inertia_error == 0.5  # above what is checked for


@pytest.mark.parametrize(("anchor", "index"), [(None, 0), ("left", 0), ("right", 1)])
def test_alignment_is_part_of_the_loop_with_its_anchor_and_its_faster_rate(anchor: str | None, index: int) -> None:
    named = () if anchor is None else (f'controller.alignment.anchor="{anchor}"',)
    assert loop_of(cell_of("paper", *ALIGNED, *named)).aligning == Aligning(index, 2.0)
    fast = cell_of("paper", "controller.alignment.ready_per_s=1.0", "controller.alignment.track_per_s=3.0", *named)
    assert loop_of(fast).aligning == Aligning(index, 3.0)


def test_the_slow_creep_of_alignment_is_no_instability() -> None:
    found = looked_at(gentle, "paper", *SERVOS, *ALIGNED)
    aligning = findings(found)["stable: cell that aligns itself"]
    assert aligning.verdict is Verdict.OK
    assert aligning.wanted == "< 1"
    assert found.robustness is not None
    assert found.robustness.criterion.worst[Demand.ALIGNING].radius > found.robustness.criterion.radius


def said_in(what: str = "stable: cell that aligns itself", **radii: float) -> Finding:
    """What is said of arms that align themselves, or of another loop, where the worst of a demand has this radius."""
    whole = looked_at(gentle, "paper", *SERVOS, *ALIGNED).robustness
    assert whole is not None
    worst = whole.criterion.worst
    cases = tuple(Found(radii.get(d.name.lower(), f.radius), f.case) for d, f in worst.items())
    found = replace(whole, criterion=replace(whole.criterion, cases=cases)).findings()
    return next(f for f in found if f.what == what)


def test_aligning_is_blamed_only_where_the_cell_is_stable_without() -> None:
    without, blamed = "unstable without aligning, too", "run away from each other; lower ready_per_s"
    for radii in ({"aligning": 1.02}, {"aligning": 1.02, "bare": 1.1}):
        assert blamed in said_in(**radii).remedy
    for aligning, other, radius in ((1.046, "soft", 1.0457), (1.03, "soft", 1.04), (1.2, "rigid", 1.1)):
        found = said_in(aligning=aligning, **{other: radius})
        assert found.verdict is Verdict.REFUSED
        assert without in found.remedy
        assert "ready_per_s" not in found.remedy


def test_a_radius_is_told_beside_its_bound_and_one_below_one_is_called_slow() -> None:
    assert said_in(aligning=1.00001).found.startswith("1.00001 (")
    slow = said_in("stable: cell with soft grasps", soft=0.99994)
    assert (slow.found.partition(" ")[0], slow.wanted) == ("0.99994", "≤ 0.9999")
    assert slow.remedy.startswith("stable, but an error takes 83.3 s to fall to 37 %")
    assert said_in("stable: cell with soft grasps", soft=1.01).remedy.startswith("on grasps this soft")
