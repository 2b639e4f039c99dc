"""Torques, timing and internal force of a run against rows whose every figure is known in closed form."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from agent.log.columns import Table
from agent.log.servos import servo_table
from agent.modes import Mode
from agent.report import prepared
from agent.report.metrics import summarise
from agent.report.prepared import prepare
from agent.report.series import durations, internal_wrenches, meant_by_shares, rotate
from agent.safety import Flag
from agent.telemetry.row.event import Event, Level
from agent.telemetry.row.health import Health
from tests.support.telemetry.small_run import RATE_HZ, TICKS, keep, small_run
from tests.support.telemetry.synthetic_run import (
    paper_run,
    run_file,
)

# -------------------------------------------------------------------------------------------------- torques and timing


def test_peak_torque_is_a_fraction_of_stall_and_the_worst_is_named() -> None:
    log = small_run()
    log.agents["left"]["tau_sent"][3, 0] = -1.5
    log.agents["right"]["tau_sent"][5, 2] = 1.0
    results = summarise(log)
    assert results.arms["left"].joints["shoulder"].peak_torque_fraction == pytest.approx(1.5 / 6.0)
    assert results.worst_torque == (pytest.approx(0.4), "right", "wrist_angle")
    assert results.to_json()["peak_torque_fraction"]["worst"] == {
        "value": pytest.approx(0.4),
        "arm": "right",
        "joint": "wrist_angle",
    }


def test_peaks_and_limits_are_of_the_whole_run_and_means_of_the_motion() -> None:
    """Half a second of waiting for the start, and half a second of holding behind the end."""
    log = small_run()
    for rows in log.agents.values():
        rows["t"] = (rows["stamp_ns"] - 500_000_000) * 1e-9
        rows["t"][350:] += 1.0
        rows["mode"][:100] = Mode.READY
    rows = log.agents["left"]
    rows["tau_sent"][:, 0], rows["tau_sent"][10:20, 0], rows["tau_sent"][350, 0] = 0.5, -3.0, 2.0
    rows["tau_cmd"][10:20, 0] = 1.0
    rows["flags"][10:14], rows["late_s"][10:13], rows["late_s"][390] = Flag.SATURATED, 0.02, 0.03
    rows["bus_timeouts"], rows["bus_timeouts"][360:] = 1, 4
    rows["shift"][:50, 0], rows["unexpected"][20, 0] = 0.004, 1.25
    results = summarise(log)
    left, shoulder = results.arms["left"], results.arms["left"].joints["shoulder"]
    assert (shoulder.peak_torque_Nm, shoulder.rms_torque_Nm, shoulder.chatter_Nm) == (3.0, 0.5, 0.0)
    assert (shoulder.limited_s, shoulder.at_limit_s) == (pytest.approx(0.05), pytest.approx(0.05))
    assert (left.flags["SATURATED"], left.late_cycles, left.overruns, left.bus["bus_timeouts"]) == (4, 4, 4, 4)
    assert (left.timing["late_s"].max_s, left.load_max) == (0.03, 1.0)
    assert (left.shift_max_m, left.unexpected_fast_max_N) == (0.004, 1.25)
    assert left.modes == ((-0.5, "READY"), (0.0, "TRACK"))
    assert results.worst_torque == (0.5, "left", "shoulder")


def test_a_gripper_that_held_while_its_arm_waited_for_a_start_is_told_of() -> None:
    log = small_run()
    rows = log.agents["left"]
    rows["t"] -= 86_400.0
    rows["mode"] = Mode.READY
    none, one = (float("nan"),), int(rows["utc_ns"][50])
    said = Health(one, (1,), ("shoulder",), none, none, (0,), *[none] * 6, 0.04, 0.03, 8.0, 9.0)
    log = replace(log, servos={"left": servo_table([said], rows["utc_ns"], rows["t"])})
    grip = summarise(log).arms["left"].grip
    assert grip is not None
    assert (grip.width_max_m, grip.force_max_N) == (0.04, 8.0)


def test_the_mean_internal_force_is_of_the_arm_with_the_most_until_the_first_hold() -> None:
    log = small_run()
    wrench = log.plant["grasp_wrench"]
    wrench[:100, 0], wrench[100:200, 0], wrench[200:, 0] = 99.0, 2.0, 6.0  # the arms pull for half of it each
    assert summarise(log).internal_force_mean_N == pytest.approx((100 * 1.0 + 200 * 3.0) / 300)
    log.agents["right"]["mode"][300:] = Mode.HOLD
    results = summarise(log)
    assert results.internal_force_mean_N == pytest.approx(2.0)
    assert results.to_json()["internal_force_mean_N"] == results.internal_force_mean_N
    assert math.isnan(summarise(small_run(plant=False)).internal_force_mean_N)


def test_what_arms_are_to_press_by_is_none_of_it_while_rows_say_so() -> None:
    log = small_run()
    log.plant["grasp_wrench"][:, 0], log.plant["grasp_wrench"][:, 6] = 3.0, -3.0
    assert summarise(log).internal_force_mean_N == pytest.approx(3.0)
    for arm, N in (("left", 2.0), ("right", -2.0)):
        log.agents[arm]["wrench_internal"][:, 0] = N
        log.agents[arm]["wrench_internal"][10] = math.nan  # a tick without a law
    assert summarise(log).internal_force_mean_N == pytest.approx(1.0, abs=0.02)
    assert summarise(log).arms["left"].internal_realised.max_force_N == pytest.approx(3.0), "all of it"


def sharing(*load_shares: float) -> list[dict[str, Any]]:
    """The arms of run.json with these shares."""
    return [arm | {"load_share": share} for arm, share in zip(run_file()["arms"], load_shares, strict=True)]


def test_what_the_load_shares_mean_is_none_of_the_mean_and_all_of_the_paper_s_projection() -> None:
    """In the plane of the arms; out of it they share nothing, whatever plane it is."""
    for normal, most_N in (([0, 0, 1], 0.0), (None, 0.0), ([0.6, 0.8, 0.0], 0.8 * 0.8), ([0, 1, 0], 0.8)):
        log = small_run(plane_normal=normal, arms=sharing(0.1, 0.9))
        log.plant["grasp_wrench"][:, 1], log.plant["grasp_wrench"][:, 7] = 0.2, 1.8
        results = summarise(log)
        assert results.internal_force_mean_N == pytest.approx(most_N, abs=1e-12), normal
        assert results.arms["left"].internal_realised.max_force_N == pytest.approx(0.8)
        assert results.arms["left"].load_share_realised == pytest.approx(0.1)


def test_a_log_that_does_not_say_all_shares_counts_as_one_of_equal_shares() -> None:
    arms = sharing(0.1, 0.9)
    del arms[1]["load_share"]
    log = small_run(arms=arms)
    log.plant["grasp_wrench"][:, 1], log.plant["grasp_wrench"][:, 7] = 0.2, 1.8
    assert summarise(log).internal_force_mean_N == pytest.approx(0.8)


def test_a_plant_s_row_takes_what_an_arm_was_to_give_from_a_row_of_about_that_time_or_none() -> None:
    rows = small_run().agents["left"][:1].copy()
    rows["t"], rows["wrench_internal"] = 1.0, 2.0
    found = prepared._asked_force(Table.of(rows), np.array([0.975, 0.985, 1.0, 1.015, 1.025]))
    assert found[:, 0].tolist() == [0.0, 2.0, 2.0, 2.0, 0.0]
    assert not prepared._asked_force(None, np.array([1.0])).any()


def test_chatter_is_the_mean_change_per_tick_and_a_gap_is_no_change() -> None:
    log = small_run()
    rows = log.agents["left"]
    rows["tau_sent"][:, 1] = np.where(rows["sequence"] % 2, 0.1, -0.1)
    rows["tau_sent"][200:, 1] += 5.0
    keep(log, "left", np.r_[0:199, 201:TICKS])
    assert summarise(log).arms["left"].joints["elbow"].chatter_Nm == pytest.approx(0.2)


def test_time_at_and_beyond_the_limit() -> None:
    log = small_run()
    rows = log.agents["left"]
    rows["tau_cmd"][:, 0] = 4.0
    rows["tau_limited"][:, 0] = np.where(rows["t"] < 0.5, 3.0, 4.0)
    rows["tau_sent"][:, 0] = np.where(rows["t"] < 0.25, -3.0, 0.0)
    shoulder = summarise(log).arms["left"].joints["shoulder"]
    assert shoulder.limited_s == pytest.approx(0.5)
    assert shoulder.at_limit_s == pytest.approx(0.25)


@pytest.mark.parametrize(("share", "at_limit_s"), [(0.9991, 2.0), (0.9989, 0.0)])
def test_a_torque_is_at_its_limit_but_for_the_rounding_of_servos(share: float, at_limit_s: float) -> None:
    log = small_run()
    log.agents["left"]["tau_sent"][:, 0] = share * 3.0
    assert summarise(log).arms["left"].joints["shoulder"].at_limit_s == pytest.approx(at_limit_s)


def test_flags_are_counted_by_name() -> None:
    log = small_run()
    log.agents["left"]["flags"][:7] = Flag.SATURATED | Flag.STALE
    log.agents["left"]["flags"][7] = Flag.STALE
    flags = summarise(log).arms["left"].flags
    assert (flags["SATURATED"], flags["STALE"], flags["SINGULAR"]) == (7, 8, 0)


def test_late_cycles_and_overruns() -> None:
    log = small_run()
    rows = log.agents["left"]
    rows["late_s"][:3], rows["late_s"][3] = 1.01 / RATE_HZ, 0.99 / RATE_HZ
    rows["step_s"][10:12] = 1.5 / RATE_HZ
    results = summarise(log)
    assert results.arms["left"].late_cycles == results.late_cycles == 3
    assert results.arms["left"].overruns == 5


def test_durations_that_a_row_without_a_state_has_of_the_one_before_count_once() -> None:
    """Rows of releases before this one; those of this one have their own."""
    log = small_run()
    rows = log.agents["left"]
    rows["flags"][100:104] = Flag.STALE
    for name, took_s in (("late_s", 1.5), ("read_s", 0.7), ("step_s", 0.3), ("write_s", 0.2)):
        rows[name][99:103] = took_s / RATE_HZ
    rows["late_s"][103], rows["step_s"][103], rows["write_s"][103] = 1.2 / RATE_HZ, np.nan, np.nan
    left = summarise(log).arms["left"]
    assert (left.late_cycles, left.overruns) == (2, 2)
    assert np.flatnonzero(np.isnan(durations(prepare(log).whole["left"])["read_s"])).tolist() == [100, 101, 102]


def test_percentiles_of_the_loop() -> None:
    log = small_run()
    log.agents["left"]["step_s"] = np.arange(TICKS) * 1e-6
    spread = summarise(log).arms["left"].timing["step_s"]
    assert spread.p50_s == pytest.approx(200e-6)
    assert spread.p99_s == pytest.approx(396e-6)
    assert spread.max_s == pytest.approx(399e-6)


def test_a_torque_that_is_infinite_counts_in_no_figure_and_is_told() -> None:
    log = small_run()
    expected = summarise(log).arms["left"]
    log.agents["left"]["tau_sent"][[7, 9], 1] = np.inf, -np.inf
    log.agents["left"]["tau_sent"][11, 0] = np.nan
    results = summarise(log)
    left = results.arms["left"]
    assert results.missing[-1] == "2 torques sent to elbow of left are infinite and count in no figure"
    assert len(results.missing) == len(summarise(small_run()).missing) + 1, "NaN is of a cycle in which none was sent"
    for name in ("peak_torque_Nm", "peak_torque_fraction", "at_limit_s"):
        assert getattr(left.joints["elbow"], name) == getattr(expected.joints["elbow"], name), name
    assert left.load_max == expected.load_max


def test_a_real_time_factor_that_is_not_known_has_its_reason() -> None:
    log = small_run()
    for rows in log.agents.values():
        rows["mode"][1:] = Mode.HOLD
    results = summarise(log)
    assert math.isnan(results.real_time_factor)
    assert "the real-time factor is not known: no arm followed the trajectory for two cycles" in results.missing
    log = small_run()
    for rows in log.agents.values():
        rows["utc_ns"] = 5
    assert "the real-time factor is not known: the rows' UTC does not go on" in summarise(log).missing


def test_real_time_factor_is_run_time_over_wall_time() -> None:
    assert summarise(small_run()).real_time_factor == pytest.approx(2.0)


def test_real_time_factor_of_simulated_utc_is_not_known_and_said() -> None:
    log = small_run()
    for rows in log.agents.values():
        rows["utc_ns"] = 1_800_000_000_000_000_000 + rows["stamp_ns"]
    results = summarise(log)
    assert math.isnan(results.real_time_factor)
    assert any("follows the simulated clock" in text for text in results.missing)


def test_real_time_factor_is_by_the_agents_own_wall_time_where_they_tell_it() -> None:
    log = small_run()
    for arm, wall_s in (("left", 0.1), ("right", 0.2)):
        log.events.append(Event(1, arm, Level.INFO, "run ended", {"wall_s": wall_s}))
    assert summarise(log).real_time_factor == pytest.approx((TICKS - 1) / RATE_HZ / 0.2)


def test_unwinding_is_seen_in_the_sign_of_e_eta() -> None:
    log = small_run()
    log.agents["left"]["e_eta"] = np.linspace(-0.5, 1.0, TICKS)
    arm = summarise(log).arms["left"]
    assert (arm.e_eta_start, arm.e_eta_end, arm.e_eta_sign_changes) == (-0.5, 1.0, 1)


# ----------------------------------------------------------------------------------------------------- internal force

unit_quaternions = arrays(float, 4, elements=st.floats(-1, 1)).filter(lambda q: np.linalg.norm(q) > 0.1)
three = arrays(float, (3, 3), elements=st.floats(-0.3, 0.3))
wrench_stacks = arrays(float, (3, 6), elements=st.floats(-10, 10))


def grasp_matrix(p_ee_object: np.ndarray) -> np.ndarray:
    blocks = []
    for x, y, z in p_ee_object:
        J = np.eye(6)
        J[:3, 3:] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
        blocks.append(J)
    return np.vstack(blocks)


@given(unit_quaternions, three, wrench_stacks)
def test_internal_wrench_is_the_papers_projection_and_has_no_net_wrench(q, offsets, wrenches) -> None:
    quat = (q / np.linalg.norm(q))[None]
    internal = internal_wrenches(wrenches[None], quat, offsets)[0]
    p_ee_object = np.array([-rotate(quat, offset)[0] for offset in offsets])
    G = grasp_matrix(p_ee_object)
    G_star = np.hstack([np.linalg.inv(G[6 * i : 6 * i + 6]) for i in range(3)]).T / 3.0
    expected = (np.eye(18) - G_star @ G.T) @ wrenches.ravel()
    np.testing.assert_allclose(internal.ravel(), expected, atol=1e-11)
    np.testing.assert_allclose(G.T @ internal.ravel(), 0.0, atol=1e-11)


@given(st.lists(st.floats(0.01, 1.0), min_size=3, max_size=3), wrench_stacks)
def test_an_arm_s_force_is_its_share_of_the_load_and_what_no_share_means(weights, wrenches) -> None:
    shares = np.array(weights) / np.sum(weights)
    beside = internal_wrenches(wrenches[None], np.array([[1.0, 0.0, 0.0, 0.0]]), None)[:, :, :3]
    beside = beside - meant_by_shares(wrenches[None], shares.tolist(), None)
    load = wrenches[:, :3].sum(axis=0)
    np.testing.assert_allclose(shares[:, None] * load + beside[0], wrenches[:, :3], atol=1e-11)
    np.testing.assert_allclose(beside.sum(axis=1), 0.0, atol=1e-11)


@pytest.mark.parametrize("count", range(1, 9))
def test_equal_shares_mean_nothing_beside_the_paper_s_projection_to_the_bit(count: int) -> None:
    forces = np.random.default_rng(count).normal(size=(5, count, 6))
    for share in (1.0 / count, round(1.0 / count, 6)):
        assert not meant_by_shares(forces, [share] * count, None).any()


def test_a_squeeze_is_all_internal_and_the_weight_is_shared() -> None:
    results = summarise(paper_run(Path("run.mcap"), duration_s=25.0))
    for arm in results.arms.values():
        assert arm.internal_cmd.max_force_N == pytest.approx(1.5)
        assert arm.internal_realised.max_force_N == pytest.approx(1.5 * 1.05, rel=1e-3)
        assert arm.load_share_realised == pytest.approx(0.5)


def test_load_shares_realised_add_up_to_one() -> None:
    log = small_run()
    wrench = log.plant["grasp_wrench"].reshape(TICKS, -1, 6)
    wrench[:, 0, 1], wrench[:, 1, 1] = 0.9, 0.3
    arms = summarise(log).arms
    assert arms["left"].load_share_realised == pytest.approx(0.75)
    assert arms["right"].load_share_realised == pytest.approx(0.25)


def test_without_grasp_offsets_the_internal_force_is_known_and_its_moment_is_not() -> None:
    content = run_file(TICKS / RATE_HZ, RATE_HZ, transient_s=0.5)
    for arm in content["arms"]:
        del arm["p_object_ee_m"]
    log = small_run(arms=content["arms"])
    log.plant["grasp_wrench"][:, 0], log.plant["grasp_wrench"][:, 6] = 2.0, -2.0
    results = summarise(log)
    assert results.arms["left"].internal_realised.max_force_N == pytest.approx(2.0)
    assert math.isnan(results.arms["left"].internal_realised.max_moment_Nm)
    assert any("grasp offsets" in text for text in results.missing)
