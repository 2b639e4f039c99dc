"""Errors, completeness and form of a run's figures against rows whose every figure is known in closed form."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from agent.control.alignment import shifted
from agent.control.trajectory import Desired
from agent.log.lacking import missing
from agent.log.read import RunLog
from agent.log.runinfo import Bounded
from agent.modes import Mode
from agent.report.compare import label
from agent.report.metrics import summarise
from agent.report.page import _summary
from agent.report.quantity import Better
from agent.report.rehearsal import HilResults
from agent.report.results import Judgement, Results
from agent.report.series import attitude_error, rotation_angle, rotation_vector
from agent.report.tables import lines
from agent.safety import Flag
from agent.telemetry.row.event import Event, Level
from tests.support.telemetry.small_run import RATE_HZ, TICKS, keep, small_run
from tests.support.telemetry.synthetic_run import (
    agent_rows,
    as_log,
    product,
    turn,
)

STILL = (0.0,) * 6

# ------------------------------------------------------------------------------------------------------------- errors


def test_a_run_without_error_has_none() -> None:
    results = summarise(small_run())
    assert results.headline("max_position_error_m") == 0.0
    assert results.headline("max_attitude_error_rad") == 0.0
    assert results.by_plant.longest_gap_s == 0.0
    assert math.isnan(results.by_plant.t_gap_s)
    assert results.missing == ()
    assert results.complete


def test_largest_and_rms_position_error_are_exact() -> None:
    log = small_run()
    log.plant["p_object"][:, 0] = np.where(log.plant["sequence"] % 2, 3e-4, -1e-4)
    errors = summarise(log).by_plant
    assert errors.max_position_error_m == pytest.approx(3e-4, rel=1e-12)
    assert errors.rms_position_error_m == pytest.approx(math.sqrt((9e-8 + 1e-8) / 2), rel=1e-12)
    assert errors.rows == 300


@pytest.mark.parametrize("angle_rad", [1e-10, 1e-7, 1e-3, 1.0, 3.0])
def test_attitude_error_is_accurate_from_tiny_to_large(angle_rad: float) -> None:
    log = small_run()
    log.plant["quat_object"] = turn(1, np.full(TICKS, angle_rad))
    assert summarise(log).headline("max_attitude_error_rad") == pytest.approx(angle_rad, rel=1e-9)


def test_a_quaternion_and_its_negative_are_one_attitude() -> None:
    log = small_run()
    log.plant["quat_object"] = -turn(2, np.full(TICKS, 2e-3))
    assert summarise(log).headline("max_attitude_error_rad") == pytest.approx(2e-3)


def test_errors_of_the_transient_do_not_count() -> None:
    log = small_run()
    log.plant["p_object"][:100, 1] = 0.01
    results = summarise(log)
    assert results.headline("max_position_error_m") == 0.0
    assert results.by_plant.position.initial == pytest.approx(0.01)


def test_in_plane_and_out_of_plane_are_parts_of_the_norm() -> None:
    log = small_run()
    log.plant["p_object"][:] = [3e-4, 0.0, 4e-4]
    errors = summarise(log).by_plant
    assert errors.max_position_error_m == pytest.approx(5e-4)
    assert errors.max_in_plane_error_m == pytest.approx(3e-4)
    assert errors.max_out_of_plane_error_m == pytest.approx(4e-4)


def test_headline_is_the_true_pose_though_the_arms_see_another() -> None:
    log = small_run()
    log.agents["left"]["p_object"][:, 0] = 1e-3
    results = summarise(log)
    assert results.headline("max_position_error_m") == 0.0
    assert results.by_arm["left"].max_position_error_m == pytest.approx(1e-3)
    assert results.arm_disagreement_m == pytest.approx(1e-3)


@pytest.mark.parametrize("rho", [(0.0, 0.0, 0.0), (0.02, -0.01, 0.03), (0.0, 0.0, 1e-9)])
def test_a_shift_by_which_an_arm_sees_the_object_beside_is_no_error_of_the_object(rho: tuple[float, ...]) -> None:
    """The object is where the cell wants it; the arm follows what it sees of that."""
    log, shift = small_run(), (5e-3, -1e-3, 2e-3, *rho)
    for arm, rows in log.agents.items():
        rows["p_object_des"], rows["quat_object_des"] = (0.3, 0.1, 0.2), turn(1, np.full(1, 0.4))
        log.plant["p_object"], log.plant["quat_object"] = rows["p_object_des"][:1], rows["quat_object_des"][:1]
        if arm == "left":
            there = Desired((0.3, 0.1, 0.2), tuple(rows["quat_object_des"][0].tolist()), STILL, STILL)
            followed = shifted(there, shift)
            rows["p_object_des"], rows["quat_object_des"], rows["shift"] = followed.p, followed.quat, shift
            rows["p_object"], rows["quat_object"] = followed.p, followed.quat
    results = summarise(log)
    assert results.headline("max_position_error_m") == pytest.approx(0.0, abs=1e-12)
    assert results.headline("max_attitude_error_rad") == pytest.approx(0.0, abs=1e-12)
    assert results.by_arm["left"].max_position_error_m == 0.0
    log.plant["p_object"][:, 0] += 1e-3
    assert summarise(log).headline("max_position_error_m") == pytest.approx(1e-3)


def test_headline_without_a_plant_is_the_worst_arm() -> None:
    log = small_run(plant=False)
    log.agents["right"]["p_object"][:, 0] = 7e-4
    results = summarise(log)
    assert results.by_plant is None
    assert results.headline("max_position_error_m") == pytest.approx(7e-4)
    assert any("no simulation in the log" in text for text in results.missing)


def test_true_pose_is_matched_by_sequence_number_and_not_by_place() -> None:
    log = small_run()
    for rows in (*log.agents.values(), log.plant):
        ramp = 0.01 * rows["sequence"]
        field = "p_object" if rows is log.plant else "p_object_des"
        rows[field][:, 0] = ramp
    log.agents["left"] = log.agents["left"][50:]
    log.agents["right"] = log.agents["right"][60:]
    assert summarise(replace(log, plant=log.plant[7:])).headline("max_position_error_m") == 0.0


def test_one_arm_fills_the_ticks_that_the_other_did_not_log() -> None:
    log = keep(small_run(), "left", slice(0, 200))
    assert summarise(log).by_plant.rows == 300


@pytest.mark.parametrize("common", ["stamp_ns", "utc_ns"])
def test_plant_that_began_before_the_trajectory_is_matched_by_a_common_clock(common: str) -> None:
    log, ticks_before = small_run(), 10  # the plant's own zero, of number and time, is ten ticks before the arms'
    ramp = 0.01 * np.arange(TICKS)
    for rows in log.agents.values():
        rows["p_object_des"][:, 0] = ramp
    log.plant["p_object"][:, 0] = ramp - 0.01 * ticks_before
    log.plant["stamp_ns"] -= ticks_before * 5_000_000 if common == "stamp_ns" else 10**15
    log.plant["utc_ns"] -= ticks_before * 2_500_000
    results = summarise(log)
    assert results.headline("max_position_error_m") == pytest.approx(0.0, abs=1e-12)
    assert any(f"matched by {common}" in text for text in results.missing)


def test_arms_whose_clocks_are_skewed_in_lockstep_are_matched_by_tick_and_share_their_windows() -> None:
    """As a study does it: each pose against what the first arm wants at that tick."""
    log = small_run()
    for name, skew_ns in (("left", 3_500_000), ("right", -4_000_000)):
        rows = log.agents[name]
        rows["p_object_des"][:, 0] = 0.01 * np.arange(TICKS)
        rows["stamp_ns"] += skew_ns
        rows["t"] += 1e-9 * skew_ns
    log.plant["p_object"][:, 0] = 0.01 * np.arange(TICKS)
    for rows in (*log.agents.values(), log.plant):
        rows["utc_ns"] = rows["stamp_ns"] + 7_000_000_000
    results = summarise(log)
    assert results.headline("max_position_error_m") == 0.0
    assert not any("matched by" in text for text in results.missing)
    ticks = {found.rows for found in (results.by_plant, *results.by_arm.values())}
    assert len(ticks) == 1, "of all the same"


@pytest.mark.parametrize("arm", ["left", "right"])
def test_an_arm_that_missed_cycles_is_matched_by_its_clock(arm: str) -> None:
    """Its rows are numbered one after the other, so that from the first cycle that it missed on they are of others."""
    log, missed = small_run(), 4
    for rows in (*log.agents.values(), log.plant):
        for field in ("p_object", "p_object_des"):
            if field in rows.dtype.names:
                rows[field][:, 0] = 0.01 * np.arange(TICKS)
    late = np.delete(log.agents[arm], slice(TICKS - 50, TICKS - 50 + missed))
    late["sequence"] = np.arange(len(late))
    log.agents[arm] = late
    results = summarise(log)
    assert results.headline("max_position_error_m") == 0.0
    assert results.arm_disagreement_m == 0.0
    assert any("matched by stamp_ns" in text for text in results.missing)


def test_plant_rows_of_other_instants_are_refused_and_said() -> None:
    log = small_run()
    for clock in ("t", "stamp_ns", "utc_ns"):
        log.plant[clock] += 10**12
    results = summarise(log)
    assert results.by_plant is None
    assert any("no tick is in both" in text for text in results.missing)


def test_decay_of_the_initial_error_is_that_of_the_closed_form() -> None:
    log = small_run(transient_s=1.9)
    log.plant["p_object"][:, 1] = 4e-3 * np.exp(-log.plant["t"] / 0.25)
    decay = summarise(log).by_plant.position
    assert decay.initial == pytest.approx(4e-3)
    assert decay.half_s == pytest.approx(0.25 * math.log(2), abs=1 / RATE_HZ)
    assert decay.tenth_s == pytest.approx(0.25 * math.log(10), abs=1 / RATE_HZ)


def test_a_start_error_that_a_hold_cut_short_has_not_decayed() -> None:
    """An arm that holds wants the object where it is: there is no error, and nothing that went away."""
    log = small_run()
    log.plant["p_object"][:100, 1] = 1e-3
    log.agents["left"]["mode"][100:] = Mode.HOLD
    decay = summarise(log).by_plant.position
    assert decay.initial == pytest.approx(1e-3, rel=1e-12)
    assert math.isnan(decay.half_s)
    assert math.isnan(decay.tenth_s)


@pytest.mark.parametrize("part", [0, 3])
def test_the_velocity_error_is_of_fresh_rows_that_follow_the_trajectory(part: int) -> None:
    log = small_run()
    rows = log.agents["left"]
    rows["v_object"][:, part] = np.where(rows["sequence"] < 300, 2e-3, 0.0)
    rows["mode"][300:] = Mode.HOLD
    rows["v_object"][250, part], rows["flags"][250] = 1.0, Flag.STALE.value
    arms = summarise(log).arms
    found = {0: "rms_velocity_error_m_per_s", 3: "rms_angular_velocity_error_rad_per_s"}[part]
    assert getattr(arms["left"], found) == pytest.approx(2e-3, rel=1e-12)
    rows["mode"][:] = Mode.HOLD
    assert math.isnan(getattr(summarise(log).arms["left"], found))


def test_an_error_that_stays_has_not_decayed() -> None:
    log = small_run()
    log.plant["p_object"][:, 1] = 1e-3
    decay = summarise(log).by_plant.position
    assert math.isnan(decay.half_s)
    assert math.isnan(decay.tenth_s)


# ------------------------------------------------------------------------------------------------ what cannot be judged


def test_bounds_give_verdicts() -> None:
    log = small_run()
    log.plant["p_object"][:, 0] = 6e-4
    results = summarise(log)
    assert results.verdict(Bounded.POSITION) is Judgement.NOT_MET
    assert results.verdict(Bounded.ATTITUDE) is Judgement.MET
    assert not results.within_bounds
    unbounded = summarise(small_run(bounds={}))
    assert unbounded.verdict(Bounded.POSITION) is None
    assert unbounded.within_bounds


def test_rows_that_are_no_numbers_are_said_and_leave_the_bound_open() -> None:
    log = small_run()
    log.plant["p_object"][350] = np.nan
    results = summarise(log)
    assert results.headline("max_position_error_m") == 0.0
    assert results.verdict(Bounded.POSITION) is Judgement.NOT_SHOWN
    assert any("1 rows of plant hold a pose that is not a number" in text for text in results.missing)


def test_an_exceeded_bound_stays_exceeded_though_rows_are_missing() -> None:
    log = small_run()
    log.plant["p_object"][340] = np.nan
    log.plant["p_object"][341, 0] = 1.0
    assert summarise(log).verdict(Bounded.POSITION) is Judgement.NOT_MET


@pytest.mark.parametrize(
    ("absent", "said"),
    [
        (slice(300, None), "for 0.5 s from 1.50 s on"),  # the run was stopped, or an arm has failed
        (slice(200, 225), "for 0.125 s from 1.00 s on"),
        (slice(100, 130), "for 0.15 s from 0.50 s on"),  # right behind the transient
        (slice(90, 119), None),  # of it 0.095 s count
        (slice(200, 219), None),
        (slice(399, None), None),
    ],
)
def test_a_stretch_without_a_pose_leaves_the_bound_open(absent: slice, said: str | None) -> None:
    log = small_run()
    log = replace(log, plant=np.delete(log.plant, absent))
    results = summarise(log)
    assert results.verdict(Bounded.POSITION) is (Judgement.NOT_SHOWN if said else Judgement.MET)
    assert results.missing == ((f"no pose of plant {said}",) if said else ())
    assert results.by_plant.whole == (said is None)


def test_a_pose_that_is_seldom_observed_is_not_missing_in_between() -> None:
    log = small_run(transient_s=0.6)
    results = summarise(replace(log, plant=log.plant[::100]))
    assert results.by_plant.rows == 2
    assert results.verdict(Bounded.POSITION) is Judgement.MET


@pytest.mark.parametrize(("plant", "verdict"), [(True, Judgement.MET), (False, Judgement.NOT_SHOWN)])
def test_an_arm_without_rows_leaves_the_bound_open_where_nothing_else_sees_the_object(
    plant: bool, verdict: Judgement
) -> None:
    log = small_run(plant=plant)
    del log.agents["right"]
    assert summarise(log).verdict(Bounded.POSITION) is verdict


def waited(log: RunLog) -> RunLog:
    """The same log with its first half second as a wait for the start."""
    for rows in log.agents.values():
        rows["t"] = (rows["stamp_ns"] - 500_000_000) * 1e-9
        rows["mode"][:100] = Mode.READY
    return log


def held(results: Results) -> list[str]:
    """What the table of results says of arms that held."""
    return [line.figure for line in lines(results) if line.what == "HELD before its end"]


def test_a_held_object_counts_in_no_error_and_leaves_the_bound_open() -> None:
    log = small_run()
    log.agents["right"]["mode"][300:] = Mode.HOLD
    log.plant["p_object"][300:, 0] = 0.1
    results = summarise(log)
    assert results.headline("max_position_error_m") == 0.0
    assert results.by_plant.not_tracking_rows == 100
    assert results.verdict(Bounded.POSITION) is Judgement.NOT_SHOWN
    assert results.arms["right"].modes == ((0.0, "TRACK"), (1.5, "HOLD"))
    assert held(results) == ["right from 1.500\N{NO-BREAK SPACE}s"]


def test_a_hold_at_the_end_of_the_motion_is_none_before_it() -> None:
    log = small_run()
    log.agents["right"]["mode"][-1:] = Mode.HOLD
    for t, found in ((1.995, ["right from 1.995\N{NO-BREAK SPACE}s"]), (2.0, [])):
        log.agents["right"]["t"][-1:] = t
        assert held(summarise(log)) == found


def test_a_hold_is_told_when_it_was_and_the_first_of_them_first() -> None:
    log = waited(small_run())
    log.agents["left"]["mode"][300:] = Mode.HOLD
    log.agents["right"]["mode"][299:] = Mode.HOLD
    assert held(summarise(log)) == ["right from 0.995\N{NO-BREAK SPACE}s", "left from 1.000\N{NO-BREAK SPACE}s"]
    log.agents["left"]["mode"][1:] = Mode.HOLD
    assert held(summarise(log))[0] == "left from -0.495\N{NO-BREAK SPACE}s"


def test_what_an_arm_does_behind_the_end_is_no_hold_before_it() -> None:
    """On the way home nobody has given another start: the time counts towards a day ahead again."""
    log = small_run()
    for rows in log.agents.values():
        rows["t"] += 1.0
        rows["mode"][200:] = Mode.LOWER
        rows["mode"][300:], rows["t"][300:] = Mode.HOLD, rows["t"][300:] - 86_400.0
    assert held(summarise(log)) == []


def test_an_arm_that_held_before_a_start_is_told_with_its_reason_and_its_figures() -> None:
    log = small_run()
    rows = log.agents["right"]
    rows["t"] -= 86_400.0
    rows["mode"][:10], rows["mode"][10:] = Mode.READY, Mode.HOLD
    rows["late_s"][:7], rows["tau_sent"][5, 1] = 0.02, 2.9
    told = [Event(5, "left", Level.WARN, "holds: left's own"), Event(6, "right", Level.WARN, "holds: monitor speed")]
    results = summarise(replace(log, events=told))
    assert held(results) == ["right from before a start"]
    assert results.missing[0] == "no row of the arm right is of the motion: right holds: monitor speed"
    assert results.arms["right"].late_cycles == results.late_cycles == 7
    assert results.arms["right"].joints["elbow"].peak_torque_Nm == 2.9
    assert math.isnan(results.arms["right"].e_eta_start)
    assert set(results.by_arm) == {"left"}
    assert results.verdict(Bounded.POSITION) is Judgement.MET, "the object was seen all the time"
    text = json.dumps(results.to_json(), allow_nan=False)
    assert json.loads(text)["arms"]["right"]["joints"]["elbow"]["rms_torque_Nm"] is None


def test_a_rehearsal_is_called_one_and_says_what_was_added_and_how_far_the_twin_was() -> None:
    log = small_run()
    rows = log.agents["right"]
    tau_max = summarise(log).info.arm("right").tau_max_Nm
    assert not summarise(log).rehearsing
    rows["twin_age_s"], rows["twin_age_s"][:100], rows["twin_age_s"][7] = 0.002, np.inf, 0.02
    rows["tau_bridge"][100:, 0], rows["tau_bridge"][200, 1] = 0.1 * tau_max[0], -0.25 * tau_max[1]
    rows["q_twin"] = rows["q_measured"]
    rows["q_twin"][300, 0] -= 0.01
    results = summarise(log)
    assert results.rehearsing == ["right"]
    assert results.arms["right"].hil == HilResults(
        added_max=pytest.approx(0.25), apart_max_rad=pytest.approx(0.01), twin_age_max_s=0.02, coupled=0.75
    )
    assert "sim, REHEARSAL of right, 200 Hz" in label(results)
    assert "200 Hz in a rehearsal of right with a simulated object" in _summary(results)
    assert "REHEARSAL" not in label(summarise(small_run()))


def test_servos_are_called_emulated_where_a_plant_told_the_truth_beside_them() -> None:
    assert "200 Hz on emulated servos, " in _summary(summarise(small_run(driver="dynamixel")))
    assert "200 Hz on real servos, " in _summary(summarise(small_run(driver="dynamixel", plant=False)))
    assert "200 Hz in simulation, " in _summary(summarise(small_run()))


def test_a_log_that_ends_in_the_transient_has_no_errors_and_says_so() -> None:
    log = small_run()
    results = summarise(replace(log, agents={n: r[:50] for n, r in log.agents.items()}, plant=log.plant[:50]))
    assert math.isnan(results.headline("max_position_error_m"))
    assert results.verdict(Bounded.POSITION) is Judgement.NOT_SHOWN
    assert any("no usable row of plant after the transient" in text for text in results.missing)


def test_an_empty_log_has_results_and_says_what_is_missing() -> None:
    results = summarise(replace(small_run(), agents={}, plant=None, complete=False))
    assert results.rows_recorded == 0
    assert not results.complete
    assert "no row of the arm left" in results.missing
    assert json.dumps(results.to_json(), allow_nan=False)


def test_a_log_without_run_file_takes_what_it_can_from_its_rows() -> None:
    results = summarise(replace(small_run(), attachments={}))
    assert results.info.rate_hz == pytest.approx(RATE_HZ)
    assert results.rows_expected == 2 * TICKS
    assert any("does not say which run it is" in text for text in results.missing)


# ------------------------------------------------------------------------------------------------------- completeness


def test_missing_rows_are_counted_and_named() -> None:
    log = keep(small_run(), "left", np.r_[0:10, 12:200, 201:390])
    results = summarise(log)
    rows = results.rows["left"]
    assert rows.gaps == ((10, 11), (200, 200), (390, 399))
    assert (rows.recorded, rows.expected) == (TICKS - 13, TICKS)
    assert results.rows_recorded == 2 * TICKS - 13
    assert not results.complete  # whatever the recorder says


@pytest.mark.parametrize(("begins_s", "expected"), [(-1.0, TICKS + 200), (-86_400.0, TICKS)])
def test_an_arm_that_dies_should_have_run_to_its_end_after_its_wait(begins_s: float, expected: int) -> None:
    log = small_run()
    log.agents["left"] = agent_rows(550, RATE_HZ)  # of an arm that nobody starts a day is left
    log.agents["left"]["t"] += begins_s
    rows = summarise(log).rows["left"]
    assert (rows.expected, rows.recorded) == (expected, min(550, expected))
    assert rows.gaps == (((550, 599),) if expected > 550 else ())


def test_rows_after_the_end_are_counted_apart() -> None:
    log = small_run()
    log.agents["left"] = agent_rows(TICKS + 20, RATE_HZ)
    log.agents["left"]["p_object"][TICKS:] = 1.0
    results = summarise(log)
    assert results.rows["left"].after_end == 20
    assert results.complete
    assert results.by_arm["left"].max_position_error_m == 0.0


def test_a_recorder_that_lost_something_makes_the_log_incomplete() -> None:
    told = {"completeness": {"left.lost_on_the_way": "3", "left.lost_on_disk": "0"}}
    results = summarise(replace(small_run(), complete=False, metadata=told, problems=("cut in its last second",)))
    assert not results.complete
    assert "3 rows of left were lost on the way" in results.missing
    assert "cut in its last second" in results.missing
    assert not any("disk" in text for text in results.missing)


def test_a_log_that_is_not_complete_says_why_though_every_row_is_there() -> None:
    def said(**told: str) -> tuple[str, ...]:
        metadata = {"completeness": {key.replace("_", "."): value for key, value in told.items()}} if told else {}
        results = summarise(replace(small_run(), complete=False, metadata=metadata))
        assert not results.complete
        return results.missing

    assert ["nothing in the log says whether rows are missing" in text for text in said()] == [True]
    assert said(complete="false", left_end="finished", right_end="open") == (
        "right had not ended when the recorder did",
    )


def test_of_a_plant_that_sent_nothing_the_report_says_what_the_recorder_said() -> None:
    names = ("missing_before", "rows_recorded", "lost_in_ring", "lost_on_the_way", "lost_on_disk")

    def said(member: str, before: int = 0) -> tuple[list[str], list[str]]:
        """Of a member of which this log has no row: by the recorder, and by the report."""
        log = small_run()
        told = dict.fromkeys(names, "0") | {"rows_expected": "0", "rows_before": str(before), "end": "open"}
        of = {f"{member}.{key}": value for key, value in told.items()}
        agents = {name: rows for name, rows in log.agents.items() if name != member}
        lacking = replace(log, agents=agents, gaps=dict.fromkeys((*log.agents, "plant"), ()), complete=False)
        results = summarise(replace(lacking, plant=None, metadata={"completeness": of}))
        return missing(of), [text for text in results.missing if member in text]

    assert said("plant") == (["no row of plant came"], ["no row of plant came"])
    assert said("plant", before=9)[1] == ["plant had not ended when the recorder did"], "it came to the log before"
    assert said("right")[1] == ["no row of the arm right"], "once"


def test_a_mended_log_says_what_was_wrong_with_it() -> None:
    told = {"utc_ns": "1", "damaged": "1", "problems": "damaged at byte 9: a chunk\nthe file ends without its index"}
    missing = summarise(replace(small_run(), complete=False, metadata={"recovery": told})).missing
    before = "the log was mended, and before that: "
    assert {f"{before}damaged at byte 9: a chunk", f"{before}the file ends without its index"} <= set(missing)


@pytest.mark.parametrize(("end", "said"), [("continued", True), ("finished", False)])
def test_a_part_of_a_run_says_that_it_goes_on_elsewhere(end: str, said: bool) -> None:
    told = {"left.end": "finished", "right.end": end, "right.awaited": "7" if said else "0"}
    missing = summarise(replace(small_run(), metadata={"completeness": told})).missing
    assert any("goes on in the next log" in text for text in missing) is said
    assert any("7 rows of right had not come when the next log began" in text for text in missing) is said


# ----------------------------------------------------------------------------------------------------- arithmetic, form

unit_quaternions = arrays(float, 4, elements=st.floats(-1, 1)).filter(lambda q: np.linalg.norm(q) > 0.1)


@given(unit_quaternions, unit_quaternions)
def test_rotation_angle_of_the_error_is_the_angle_between_the_attitudes(a, b) -> None:
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    error = attitude_error(a[None], b[None])
    expected = product(a[None], (b * [1, -1, -1, -1])[None])
    np.testing.assert_allclose(error, expected, atol=1e-12)
    assert rotation_angle(error)[0] == pytest.approx(np.linalg.norm(rotation_vector(error)[0]), abs=1e-12)


def test_results_json_has_the_documented_keys_and_no_nan() -> None:
    results = summarise(small_run(plant=False))
    content = json.loads(json.dumps(results.to_json(), allow_nan=False))
    assert {
        "max_position_error_m",
        "max_attitude_error_rad",
        "rms_position_error_m",
        "rms_attitude_error_rad",
        "peak_torque_fraction",
        "rms_torque_Nm",
        "rows_expected",
        "rows_recorded",
        "rows",
        "real_time_factor",
        "late_cycles",
        "complete",
        "by_plant",
        "by_arm",
        "arms",
        "events",
        "missing",
    } <= content.keys()
    assert content["by_plant"] is None
    assert content["arms"]["left"]["load_share_realised"] is None
    assert content["arms"]["left"]["grip"] is None
    for joint in content["arms"]["left"]["joints"].values():
        borne = 0.2 * joint["tau_stall_Nm"]
        assert joint["rms_of_continuous"] == pytest.approx(joint["rms_torque_Nm"] / borne)


def test_every_flat_figure_has_a_unit_that_its_name_agrees_with() -> None:
    flat = summarise(small_run()).flat()
    units = {"_m_per_s": "m/s", "_rad_per_s": "rad/s"}  # first: they end in `_s` as well
    units |= {"_m": "m", "_rad": "rad", "_s": "s", "_Nm": "N·m", "_N": "N", "_J": "J"}
    for name, quantity in flat.items():
        expected = next((unit for ending, unit in units.items() if name.endswith(ending)), None)
        assert expected in (None, quantity.unit), name
    assert flat["arms.left.joints.elbow.peak_torque_Nm"].better is Better.LOWER
    assert flat["real_time_factor"].better is Better.HIGHER
    assert flat["max_position_error_m"].value == 0.0


def test_results_do_not_depend_on_the_names_of_the_arms() -> None:
    log = small_run()
    log.agents["left"]["p_object"][:, 0] = 1e-3

    def swapped() -> Results:
        content = json.loads(log.attachments["run.json"])
        for arm in content["arms"]:
            arm["name"] = {"left": "b", "right": "a"}[arm["name"]]
        agents = {"b": log.agents["left"], "a": log.agents["right"]}
        return summarise(as_log(log.path, agents, log.plant, content))

    assert swapped().by_arm["b"].max_position_error_m == summarise(log).by_arm["left"].max_position_error_m
