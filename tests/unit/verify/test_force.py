"""What check says that a grasp carries: the arm's share of the object and the internal wrench together."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from agent.config.cell import Cell, load_cell
from agent.verify.finding import Finding, Verdict
from agent.verify.force import carried_N, internal_force, spare_N
from agent.verify.path import start_configurations
from agent.verify.robustness import Walk, robustness

AT_REST = ("trajectory.p_amplitude_m=[0.0, 0.0, 0.0]", "trajectory.angle_rad=0.0")
SHARES = ("arms.left.load_share=0.25", "arms.right.load_share=0.75", "object.mass_kg=0.4")


def cell(*changes: str) -> Cell:
    return load_cell(Path("two_wx200"), [*AT_REST, *SHARES, *changes])


def pressed(*wrench: float) -> tuple[str, str]:
    return (
        f"arms.left.internal_wrench_N_Nm={list(wrench)}",
        f"arms.right.internal_wrench_N_Nm={[-x for x in wrench]}",
    )


def findings(c: Cell) -> list[Finding]:
    return internal_force(c, [c.model(arm) for arm in c.arms])


def test_share_and_squeeze_are_one_force() -> None:
    weight_N = 0.4 * 9.81
    assert carried_N(cell()) == pytest.approx([0.25 * weight_N, 0.75 * weight_N], rel=1e-3)
    each = carried_N(cell(*pressed(3.0, 0.0, 0.0, 0.0, 0.0, 0.0)))
    assert each == pytest.approx([math.hypot(3.0, 0.25 * weight_N), math.hypot(3.0, 0.75 * weight_N)], rel=1e-3)


def test_what_moves_weighs_more_and_a_squeeze_turns_with_the_object() -> None:
    lifted = ("trajectory.p_amplitude_m=[0.0, 0.0, 0.05]", "trajectory.period_s=1.0")
    assert carried_N(cell(*lifted))[1] == pytest.approx(0.75 * 0.4 * (9.81 + 0.05 * (2.0 * math.pi) ** 2), rel=0.02)
    turned = ("trajectory.angle_rad=0.5", *pressed(3.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert max(carried_N(cell(*turned))) > math.hypot(3.0, 0.75 * 0.4 * 9.81) + 0.5, "then it adds to the weight"


def test_a_grip_that_either_alone_leaves_holding_is_refused_for_both() -> None:
    grip = ("arms.right.grip_force_max_N=3.5",)
    for changes in (grip, (*grip, *pressed(3.0, 0.0, 0.0, 0.0, 0.0, 0.0))):
        (found,) = (f for f in findings(cell(*changes)) if f.what == "force on the grasp, object and internal")
        assert found.where == "right"
        assert found.verdict is (Verdict.OK if changes is grip else Verdict.REFUSED)


def test_a_moment_is_told() -> None:
    told = [f.found for f in findings(cell(*pressed(0.0, 0.0, 0.0, 0.0, 0.1, 0.0)))]
    assert told == ["0 N, 0.1 N·m"] * 2


def test_errors_of_calibration_may_take_what_the_load_leaves_of_the_grip() -> None:
    c = cell("arms.right.grip_force_max_N=3.5")
    left_N, right_N = spare_N(c, 2.0)
    assert (left_N, right_N) == (2.0, pytest.approx(3.5 - 0.75 * 0.4 * 9.81, rel=1e-3))
    assert spare_N(cell("arms.right.grip_force_max_N=0.5"), 2.0) == [2.0, 0.0]
    models = [c.model(arm) for arm in c.arms]
    walk = Walk(c, models, [start_configurations(c, models)], [0.0])
    found = {f.where: f for f in robustness(walk).findings() if f.what.startswith("internal wrench at the")}
    assert (found["left"].wanted, found["right"].wanted) == ("≤ 2 N", f"≤ {right_N:.3g} N")
