"""That the object was lost, when and by whose grasp, from rows of the plant in which it is known."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agent.log.read import RunLog
from agent.modes import Mode
from agent.report.errors import apart_by_pair
from agent.report.loss import LOST_M, LOST_RAD, SLIPPED_M, is_lost, loss_of, opened_s, told
from agent.report.metrics import summarise
from agent.report.moments import moments_of
from agent.report.page import render
from agent.report.prepared import prepare
from agent.report.report import PAGE, write_report
from agent.report.results import Judgement, Results
from agent.report.tables import Line, lines
from agent.study import measure
from agent.telemetry.row.event import Level
from tests.support.telemetry.small_run import RATE_HZ, TICKS, small_run
from tests.support.telemetry.synthetic_run import turn

FELL_AT, OPENED_AT = 240, 220  # ticks
TOGETHER = "have found together"


def dropped() -> RunLog:
    """Both arms hold from tick 210 on, the right one's grasp opens, then the object falls."""
    log = small_run()
    for rows in log.agents.values():
        rows["mode"][210:] = Mode.HOLD
        rows["shift"][:, 0] = 1e-3
    log.plant["contact_error_m"][:OPENED_AT, :2] = (2e-3, 3e-3)
    log.plant["contact_error_m"][OPENED_AT:, 1] = math.nan
    log.plant["p_object"][FELL_AT:, 2] -= np.linspace(0.15, 9.0, TICKS - FELL_AT)
    return log


def warned(results: Results) -> dict[str, Line]:
    return {line.what: line for line in lines(results) if line.what.isupper()}


def test_a_loss_while_the_arms_hold_is_told_with_its_instant_and_whose_grasp_was_open() -> None:
    results = summarise(dropped())
    assert results.headline("max_position_error_m") == pytest.approx(1e-3)  # of ticks that follow, as before
    found = warned(results)
    assert found["OBJECT LOST"].figure == "from 1.200\xa0s, off by 9.00\xa0m, 0\xa0rad"
    assert found["OBJECT LOST"].bound == "≤ 0.1\xa0m, 1\xa0rad"
    assert found["GRASP OPEN"].figure == "right from 1.100\xa0s"
    assert {line.verdict for line in found.values()} == {Judgement.NOT_MET}
    told = results.to_json()
    assert (told["object_lost"], told["object_lost_s"]) == (True, FELL_AT / RATE_HZ)
    assert told["object_off_max_m"] == pytest.approx(9.0, abs=2e-3)
    assert told["grasp_open_s"] == {"right": OPENED_AT / RATE_HZ}
    assert told["grasp_gap_max_m"] == {"left": 2e-3, "right": 3e-3}


def test_a_run_that_keeps_its_object_tells_no_loss() -> None:
    log = small_run()
    log.plant["p_object"][:, 1] += 0.099
    results = summarise(log)
    assert not warned(results)
    told = results.to_json()
    assert (told["object_lost"], told["object_lost_s"], told["grasp_open_s"]) == (False, None, {})
    assert told["object_off_max_m"] == pytest.approx(0.099)


def test_a_grasp_that_slips_and_does_not_open_is_told_with_how_far_and_misses_nothing() -> None:
    log = small_run()
    log.plant["slip_m"][250:, 1] = np.linspace(0.0, 2e-3, TICKS - 250)
    log.plant["slip_rad"][:, 0] = 0.9e-3  # too little to tell of
    results = summarise(log)
    found = [line for line in lines(results) if line.what == "grasp slipped"]
    from_s = float(log.plant["t"][np.argmax(log.plant["slip_m"][:, 1] > SLIPPED_M)])
    assert [(line.figure, line.verdict) for line in found] == [
        (f"right from {from_s:.3f}\xa0s, by 2.00\xa0mm, 0\xa0mrad", None)
    ]
    assert results.within_bounds
    assert results.loss.kept
    told_of = results.to_json()
    assert told_of["grasp_slip_s"] == {"right": from_s}
    assert told_of["grasp_slip_max_m"] == {"left": 0.0, "right": 2e-3}
    assert told_of["grasp_slip_max_rad"] == {"left": 0.9e-3, "right": 0.0}
    assert [(e.data["t"], e.level, e.text) for e in told(prepare(log))] == [
        (from_s, Level.WARN, "the grasp of right slips")
    ]
    log.plant["slip_rad"][:, 0] = 1.1e-3
    turned, shifted = summarise(log).loss.slips()  # as they began
    assert turned.startswith("left from ")
    assert turned.endswith(", by 0\xa0mm, 1.10\xa0mrad")
    assert shifted.startswith("right from ")


def test_an_object_that_only_turns_is_lost_too() -> None:
    log = small_run()
    log.plant["quat_object"][300:] = turn(1, np.full(TICKS - 300, 1.1))
    results = summarise(log)
    assert results.loss.object_lost_s == 300 / RATE_HZ
    assert results.loss.object_off_max_rad == pytest.approx(1.1)


def test_arms_have_found_together_only_over_an_object_that_all_of_them_kept() -> None:
    def said(log: RunLog) -> str:
        return next(line.figure for line in lines(summarise(log)) if line.what.startswith("arms disagree"))

    def shifted() -> RunLog:
        log = small_run()
        for rows in log.agents.values():
            rows["shift"][:, 0] = 1e-3
        log.agents["right"]["p_object"][:, 0] += 2e-3
        log.agents["left"]["shift"][:, 0] = 0.0
        return log

    assert TOGETHER in said(shifted())
    opened, lost = shifted(), shifted()
    opened.plant["contact_error_m"][300:, 0] = math.nan
    lost.plant["p_object"][300:, 0] += 0.2
    assert TOGETHER not in said(opened)
    assert TOGETHER not in said(lost)


def test_arms_disagree_only_while_both_of_them_have_the_object_in_their_grippers() -> None:
    """What an empty gripper sees is no object: from the first row with its grasp open on, the arm counts no more."""
    log = small_run()
    seen = log.agents["right"]["p_object"]
    seen[:, 0] = 1e-6 * np.arange(TICKS)
    seen[300:, 0] += 0.5
    log.agents["right"]["shift"][:, 1] = 2e-4
    assert summarise(log).arm_disagreement_m == pytest.approx(0.5 + 1e-6 * (TICKS - 1))
    log.plant["contact_error_m"][300:, 1] = math.nan
    found = summarise(log)
    assert found.arm_disagreement_m == pytest.approx(299e-6)
    assert found.arm_disagreement_left_m == pytest.approx(math.hypot(299e-6, 2e-4))
    assert found.loss.grasp_open_s == {"right": 300 / RATE_HZ}
    ((_, _, t, _),) = apart_by_pair(prepare(log))
    assert t.tolist() == pytest.approx((np.arange(300) / RATE_HZ).tolist())
    log.agents["right"]["shift"][:] = 0.0
    log.agents["right"]["shift"][300:, 1] = 2e-4  # by what it sees without the object
    assert math.isnan(summarise(log).arm_disagreement_left_m)


def test_a_grasp_that_opens_as_the_object_is_handed_over_ends_no_disagreement_before() -> None:
    log = small_run()
    log.agents["right"]["p_object"][:, 0] = 1e-3
    log.agents["left"]["mode"][OPENED_AT:] = Mode.RELEASE
    log.plant["contact_error_m"][OPENED_AT + 1 :, 1] = math.nan
    assert opened_s(prepare(log)) == {}
    assert summarise(log).arm_disagreement_m == pytest.approx(1e-3)


@pytest.mark.parametrize("how", ["falls", "turns"])
def test_an_arm_that_cannot_be_commanded_desires_nothing_and_the_loss_is_seen_all_the_same(how: str) -> None:
    log = dropped()
    for rows in log.agents.values():
        rows["mode"][215:] = Mode.FAULT
        rows["p_object_des"][215:] = rows["quat_object_des"][215:] = math.nan
    if how == "turns":
        log.plant["p_object"][:] = 0.0
        log.plant["quat_object"][FELL_AT:] = turn(0, np.full(TICKS - FELL_AT, 1.5))
    assert summarise(log).loss.object_lost_s == FELL_AT / RATE_HZ


def test_what_comes_after_a_session_hands_its_object_over_is_no_loss() -> None:
    log = dropped()
    log.agents["left"]["mode"][OPENED_AT:] = Mode.RELEASE
    assert summarise(log).loss.kept


def test_a_plant_that_tells_of_no_grasp_has_none_open() -> None:
    log = small_run()
    log.plant["contact_error_m"][:] = math.nan
    assert summarise(log).loss.grasp_open_s == {}


def test_without_the_truth_nothing_is_said() -> None:
    results = summarise(small_run(plant=False))
    assert not warned(results)
    told = results.to_json()
    keys = ("object_lost", "object_lost_s", "object_off_max_m", "grasp_open_s", "grasp_gap_max_m")
    assert [told[key] for key in keys] == [None] * 5


def test_what_happened_lists_the_open_grasp_and_the_loss_as_the_plants() -> None:
    run = prepare(dropped())
    found = told(run)
    assert [(e.data["t"], e.source, e.text) for e in found] == [
        (OPENED_AT / RATE_HZ, "plant", "the grasp of right is open"),
        (FELL_AT / RATE_HZ, "plant", "the object is lost"),
    ]
    assert [e.utc_ns for e in found] == [int(run.log.plant["utc_ns"][k]) for k in (OPENED_AT, FELL_AT)]
    assert all(e.level is Level.ERROR for e in found)
    assert [(m.t, m.text, m.grave) for m in moments_of(run)] == [(e.data["t"], e.text, True) for e in found]
    assert summarise(run.log).events == 0
    assert told(prepare(small_run())) == []


def test_the_page_has_them_among_its_events(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agent.report.report.pictures", lambda _: ())  # nothing is said of them
    write_report(dropped(), tmp_path)
    page = (tmp_path / PAGE).read_text(encoding="utf-8")
    assert "<td>the object is lost</td>" in page
    assert "OBJECT LOST" in page
    assert json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))["object_lost"] is True
    assert "the object is lost" not in render(summarise(small_run()), [], [])


@pytest.mark.parametrize(
    ("off_m", "off_rad", "lost"),
    [(0.1, 1.0, False), (0.1001, 0.0, True), (0.0, 1.001, True), (math.nan, math.nan, False), (math.inf, 0.0, True)],
)
def test_lost_is_farther_than_a_tenth_of_a_metre_or_turned_by_more_than_a_radian(
    off_m: float, off_rad: float, lost: bool
) -> None:
    assert (LOST_M, LOST_RAD) == (0.1, 1.0)
    assert bool(is_lost(off_m, off_rad)) is lost


def test_a_study_goes_by_the_criterion_of_the_report() -> None:
    assert measure.is_lost is is_lost


def test_a_log_of_a_release_in_which_no_grasp_slipped_has_no_slip(tmp_path: Path) -> None:
    """`coop view` of one ended in a traceback."""
    log = dropped()
    assert log.plant is not None
    names = [name for name in log.plant.dtype.names or () if name not in ("slip_m", "slip_rad")]
    older = np.zeros(len(log.plant), [(name, log.plant.dtype[name]) for name in names])
    for name in names:
        older[name] = log.plant[name]
    found = loss_of(prepare(replace(log, plant=older)))
    assert found is not None
    assert found.grasp_slip_s == {}
    assert found.grasp_open_s == {"right": OPENED_AT / RATE_HZ}
