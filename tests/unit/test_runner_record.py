"""What the loop writes into its rows and its summary: numbers, times, torques; nothing is left from the row before."""

from __future__ import annotations

import numpy as np
import pytest

from agent.modes import Mode
from agent.safety import Flag
from tests.support.runner_rig import FAULT_AFTER_STALE, WALL_NS, MovedClock, fault, lost, lost_at, period_ns, run


def test_rows_are_numbered_without_gaps() -> None:
    done = run(failures=lost_at(15))
    assert done.rows["sequence"].tolist() == list(range(len(done.rows)))
    assert done.summary.ticks == len(done.rows)


def test_every_row_is_stamped_with_the_clocks_own_tie_to_utc() -> None:
    rows = run(failures=lost_at(15)).rows
    assert set((rows["utc_ns"] - rows["stamp_ns"]).tolist()) == {MovedClock.utc_offset_ns}


def test_the_time_of_a_row_is_that_of_its_state_since_the_trajectorys_zero() -> None:
    done = run(pauses_ns={20: period_ns() // 4}, failures=lost_at(25))
    tracked = done.of(Mode.TRACK)
    expected = 1e-9 * period_ns() * np.arange(20)
    expected[20 - 11] += 0.25e-9 * period_ns()
    assert tracked["t"] == pytest.approx(expected)


def test_a_cycle_without_a_state_has_a_row_of_its_deadline_with_the_torque_kept() -> None:
    done = run(failures=lost_at(15))
    before, row = done.rows[13], done.rows[14]
    assert row["flags"] == Flag.STALE
    assert row["mode"] == Mode.TRACK
    assert row["stamp_ns"] == before["stamp_ns"] + period_ns()
    for name in ("q_measured", "dq_measured", "tau_measured", "q", "dq", "e_p", "tau_cmd", "lyapunov"):
        assert np.isnan(np.atleast_1d(row[name])[:3]).all(), name
    np.testing.assert_array_equal(row["tau_limited"], before["tau_limited"])
    np.testing.assert_allclose(row["tau_sent"][:3], before["tau_limited"][:3] + 0.001, atol=1e-15)
    assert not np.any(before["flags"] & Flag.STALE)


def test_torques_of_a_row_are_those_that_were_limited_and_those_that_were_taken() -> None:
    done = run()
    for row, written in zip(done.rows, done.arm.written, strict=True):
        np.testing.assert_array_equal(row["tau_limited"][:3], written)
        np.testing.assert_array_equal(row["tau_sent"][:3], written + 0.001)


def test_durations_of_a_cycle_are_those_of_its_parts() -> None:
    rows = run().rows
    for name, wall_ns in zip(("read_s", "step_s", "write_s"), WALL_NS[1:], strict=True):
        assert rows[name] == pytest.approx(wall_ns * 1e-9), name


def test_a_cycle_without_a_state_has_its_own_durations_and_none_of_what_it_did_not_do() -> None:
    done = run(failures=lost_at(15), oversleeps_ns={15: period_ns() // 2})
    row = done.rows[14]
    assert row["flags"] == Flag.STALE
    assert row["late_s"] == pytest.approx(0.5e-9 * period_ns())
    assert (row["read_s"], row["write_s"]) == pytest.approx((1e-9 * WALL_NS[1], 1e-9 * WALL_NS[3]))
    assert np.isnan(row["step_s"]), "it takes no step"
    assert (done.rows["late_s"][[13, 15]] == 0.0).all()
    assert row["bus_retries"] == 5


def test_a_cycle_that_says_nothing_on_the_bus_has_no_duration_of_a_read_or_write() -> None:
    quiet = {"lapses": frozenset({0}), "answers": (lost(),)}
    done = run(failures=lost_at(*range(15, 60)), returning=quiet, hold_at_end=True)
    after = done.rows[14 + FAULT_AFTER_STALE : 16 + FAULT_AFTER_STALE]
    assert len(after) == 2
    for name in ("read_s", "step_s", "write_s"):
        assert np.isnan(after[name]).all(), name
    assert (after["late_s"] == 0.0).all()


def test_counters_of_the_bus_are_in_every_row() -> None:
    rows = run().rows
    for name, count in (("bus_timeouts", 2), ("bus_corrupt", 3), ("bus_alerts", 4), ("bus_retries", 5)):
        assert set(rows[name].tolist()) == {count}


def test_the_summary_says_how_long_the_trajectory_took_from_its_first_state_to_its_last_torque() -> None:
    done = run()
    waited_ns = WALL_NS[0] + WALL_NS[1]  # for the first cycle and its state
    assert done.summary.tracked_s == pytest.approx((20 * sum(WALL_NS) - waited_ns) * 1e-9)
    held = run(failures={16: fault(True)})
    ticks = len(held.of(Mode.TRACK))
    assert ticks == 6
    assert held.summary.tracked_s == pytest.approx((ticks * sum(WALL_NS) - waited_ns) * 1e-9)


def test_a_run_that_never_tracked_took_no_time() -> None:
    assert run(failures={5: fault(False)}).summary.tracked_s == 0.0
