"""What `coop check` says of the estimates of an adaptive cell, and that arms which start too early hold by them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from agent.config.cell import Cell, load_cell
from agent.config.noticing import thresholds
from agent.control.residual import Channels
from agent.study.lab import Laboratory, Run
from agent.verify.check import start_configurations
from agent.verify.finding import Finding, Verdict
from agent.verify.noticing import forgotten_s, unlearnt
from tests.support.disagreement import pressed


def cell(*overrides: str) -> Cell:
    return load_cell(Path("paper_adaptive"), overrides)


def found_of(c: Cell) -> Finding:
    models = [c.model(arm) for arm in c.arms]
    (found,) = unlearnt(c, models, start_configurations(c, models))
    return found


def test_from_nothing_an_arm_lacks_what_holds_it_and_its_share_until_the_leak_has_forgotten_that() -> None:
    c = cell()
    found, lacking = found_of(c), []
    models = [c.model(arm) for arm in c.arms]
    for arm, model, q in zip(c.arms, models, start_configurations(c, models), strict=True):
        k = model.evaluate(q, np.zeros(model.n))
        share = c.offline(arm).load_share * model.task_basis @ np.array([*(-0.062 * c.gravity), 0.0, 0.0, 0.0])
        wrench = model.task_basis.T @ (np.linalg.pinv(k.J).T @ k.g + share)
        lacking.append((np.linalg.norm(wrench[:3]), np.linalg.norm(wrench[3:])))
    force, moment = np.max(lacking, axis=0).tolist()
    wait_s = forgotten_s((force, moment), thresholds(c), 4.0)
    assert found.found == f"{force:.2g} N, {moment:.2g} N·m, forgotten after {wait_s:.2g} s"
    assert found.verdict is Verdict.OK
    assert 0.15 < wait_s < 0.5


def test_a_start_before_that_is_warned_of_and_holds_by_what_it_does_not_know() -> None:
    early = cell("simulation.ready_s=0.0")
    assert found_of(early).verdict is Verdict.WARNING
    run = Run(Laboratory(early), None)
    while run.t < 0.3 and not run.trips:
        run.advance()
    assert run.trips[0].by == "UNEXPECTED"
    later = Run(Laboratory(cell("simulation.ready_s=0.4")), None)
    while later.t < 0.3:
        later.advance()
    assert not later.trips


@pytest.mark.parametrize(
    ("overrides", "words", "verdict"),
    [
        (("controller.adaptive.leak_per_s=0.0",), "which no leak forgets", Verdict.WARNING),
        (("controller.adaptive.start='nominal'",), "0 N, 0 N·m, forgotten after 0 s", Verdict.OK),
        (("controller.adaptive.leak_per_s=0.1",), "forgotten after 12 s", Verdict.WARNING),
    ],
)
def test_leak_and_start_decide_how_long(overrides: tuple[str, ...], words: str, verdict: Verdict) -> None:
    found = found_of(cell(*overrides))
    assert found.found.endswith(words)
    assert found.verdict is verdict


def test_nothing_is_said_where_nothing_is_learnt_or_noticed() -> None:
    assert unlearnt(load_cell(Path("paper_real")), [], []) == []
    assert unlearnt(cell("safety.noticing.enabled=false"), [], []) == []


@pytest.mark.parametrize(("lacking", "over"), [((2.0, 0.0), 2.0), ((0.0, 0.9), 3.0), ((1.0, 0.3), 1.0)])
def test_the_smallest_limit_of_each_kind_counts(lacking: tuple[float, float], over: float) -> None:
    for limits in (Channels(1.0, 0.3, 5.0, 5.0), Channels(5.0, 5.0, 1.0, 0.3)):
        assert forgotten_s(lacking, limits, 0.5) == pytest.approx(math.log(over) / 0.5)


@pytest.mark.long  # with more of it: tests/property/control/test_together.py
def test_arms_that_learn_live_with_two_millimetres_of_disagreement() -> None:
    """The beginning of what `make campaign` runs for 100 s, and what becomes of it by the law as printed."""
    short = ("simulation.ready_s=1.0", "trajectory.ramp_s=1.0", "safety.noticing.enabled=false")
    agreed, found = pressed(0.0, 3.0, *short), pressed(2.0, 3.0, *short)
    assert not found.told
    assert found.mean_N(2.0, 3.0) <= 1.5
    assert found.mean_N(2.0, 3.0) <= found.mean_N(1.0, 2.0) + 0.15
    assert found.error_after_m(2.0) <= 2.0 * agreed.error_after_m(2.0)
    printed = ("controller.adaptive.leak_per_s=0.0", "controller.alignment.enabled=false")
    wound_up = pressed(2.0, 3.0, *short, *printed)
    assert wound_up.mean_N(2.0, 3.0) > 3.0 * found.mean_N(2.0, 3.0)
