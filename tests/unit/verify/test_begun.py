"""A motion that begins elsewhere than the object stands, or quickly: what check says, and what the arms make of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from agent.config.cell import Cell, ConfigError, load_cell
from agent.study.lab import Laboratory, Run
from agent.verify.check import examine, start_configurations
from agent.verify.finding import Finding, Verdict
from agent.verify.noticing import begun
from tests.support.few import long

READY = "simulation.ready_s=1.5"  # until what the support and friction gave has gone
TURNED = "object.quat_start=[0.999996875, 0.0, 0.0025, 0.0]"  # 5 mrad about y
OUT_OF_REACH = "trajectory.p_amplitude_m=[0.5, 0.0, 0.0]"


def found_of(c: Cell) -> list[Finding]:
    models = [c.model(arm) for arm in c.arms]
    return begun(c, models, start_configurations(c, models))


def off(name: str, axis: int, millimetres: float) -> str:
    p = np.array(load_cell(Path(name)).file.object.p_start_m)
    p[axis] += 1e-3 * millimetres
    return f"object.p_start_m={p.tolist()}"


@pytest.mark.parametrize(
    ("name", "changes", "verdict"),
    [
        ("paper_real", [off("paper_real", 0, 0.3)], Verdict.OK),
        ("paper_real", [off("paper_real", 0, 0.5)], Verdict.REFUSED),
        long(("paper_adaptive", [off("paper_adaptive", 1, 0.9)], Verdict.REFUSED)),
        ("two_wx200", [off("two_wx200", 2, -1.2)], Verdict.REFUSED),
        ("two_wx200", [TURNED], Verdict.REFUSED),
        ("two_wx200", [off("two_wx200", 0, 0.3), "object.quat_start=[1.0, 0.0, -0.001, 0.0]"], Verdict.OK),
        ("two_wx200", ["trajectory.ramp_s=0.0"], Verdict.OK),
        ("two_wx200", ["trajectory.ramp_s=0.0", off("two_wx200", 0, 0.4)], Verdict.OK),
        ("two_wx200", ["trajectory.ramp_s=0.0", off("two_wx200", 0, -0.3)], Verdict.WARNING),
        ("two_wx200", ["trajectory.ramp_s=0.0", "trajectory.period_s=5.0"], Verdict.WARNING),
        ("two_wx200", ["trajectory.ramp_s=0.0", "trajectory.period_s=3.5"], Verdict.REFUSED),
        long(("three_wx250s", [off("three_wx250s", 0, 0.2)], Verdict.OK)),
        long(("three_wx250s", [off("three_wx250s", 0, 0.3)], Verdict.REFUSED)),
        ("four_wx250s", [off("four_wx250s", 2, 0.4)], Verdict.REFUSED),
    ],
)
def test_check_refuses_what_the_arms_hold_for_as_it_begins(name: str, changes: Sequence[str], verdict: Verdict) -> None:
    c = load_cell(Path(name), [READY, *changes])
    (found,) = found_of(c)
    assert found.verdict is verdict, found
    run, force, moment = Run(Laboratory(c), None), 0.0, 0.0
    while run.t < 0.1:
        run.advance()
        if run.t > 0.0 and not force:
            sizes = [place.outcome.sensed[6:8] for place in run.places if place.outcome and place.outcome.sensed]
            force, moment = np.max(sizes, axis=0).tolist()
    assert bool(run.trips) is (verdict is Verdict.REFUSED), "a warning: it may be a touch"
    told_N, told_Nm = (float(part.split()[0]) for part in found.found.split(", "))
    usual_N, usual_Nm = (0.8, 0.2) if "paper" in name else (0.12, 0.03)  # of friction before the start
    assert force == pytest.approx(told_N, abs=0.05 * told_N + usual_N)
    assert moment == pytest.approx(told_Nm, abs=0.05 * told_Nm + usual_Nm)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("two_wx200", []),
        ("paper_adaptive", []),
        ("four_wx250s", []),
        ("two_wx200", [off("two_wx200", 2, 5.0), "safety.noticing.enabled=false"]),
        ("two_wx200", [off("two_wx200", 2, 5.0), OUT_OF_REACH]),
    ],
)
def test_nothing_is_said_of_a_begin_at_rest_nor_where_nobody_notices_or_other_findings_refuse(
    name: str, changes: Sequence[str]
) -> None:
    assert found_of(load_cell(Path(name), changes)) == []


def test_a_cell_that_would_hold_as_it_begins_must_not_run() -> None:
    with pytest.raises(ConfigError, match=r"what the begin of the motion looks like .* let the motion begin at rest"):
        examine(load_cell(Path("two_wx200"), [off("two_wx200", 0, 2.0)])).require()


def test_a_session_lifts_the_object_from_where_it_stands_so_nothing_jumps() -> None:
    away = off("two_wx200", 2, -5.0)
    assert found_of(load_cell(Path("two_wx200"), [away])) != []
    assert found_of(load_cell(Path("two_wx200"), [away, "session.lift_m=0.015"])) == []
