"""The loop around `step`: start, stop, release and its ticks; on a clock that the test moves."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from agent.around import Schedule
from agent.modes import Event, Mode, next_mode
from agent.ticks import NOT_YET_NS, Ticks
from drivers.interface import Vector
from tests.support.runner_rig import START_AFTER, Done, lost, lost_at, period_ns, q_start, run


def moving(read: int) -> Vector:
    """A joint more at every read."""
    return q_start() + np.array([0.0, 0.0, 1e-3 * read])


# --- start -----------------------------------------------------------------------------------------------------------


def test_the_start_pose_is_held_until_the_common_instant() -> None:
    done = run()
    rows = done.rows
    assert done.modes == [Mode.TRACK]
    ready = rows["mode"] == Mode.READY
    assert (rows["t"][~ready] >= 0).all()
    assert rows["t"][~ready][0] == pytest.approx(0.0, abs=1e-9)
    assert np.diff(rows["t"][~ready]) == pytest.approx(period_ns() * 1e-9)
    assert rows["e_p"][ready] == pytest.approx(0.0, abs=1e-9)
    assert np.abs(rows["e_p"][~ready]).max() > 1e-3, "the trajectory starts 3 mm away"
    assert len(rows[~ready]) == 20


def test_in_lockstep_the_arm_waits_as_long_as_the_schedule_says() -> None:
    done = run(start_ns=lambda *_: None, lockstep=True, ready_ns=6 * period_ns())
    assert done.modes == [Mode.TRACK]
    assert done.of(Mode.READY)["t"] == pytest.approx(1e-9 * period_ns() * np.arange(-6, 0))
    assert done.of(Mode.TRACK)["t"] == pytest.approx(1e-9 * period_ns() * np.arange(20))
    assert done.of(Mode.READY)["e_p"] == pytest.approx(0.0, abs=1e-9)


def test_in_lockstep_without_a_wait_the_first_tick_is_the_trajectorys() -> None:
    done = run(start_ns=lambda *_: None, lockstep=True)
    assert done.modes == [Mode.TRACK], "which is what an operator is told, too"
    assert (done.rows["mode"] == Mode.TRACK).all()
    assert done.rows["t"] == pytest.approx(1e-9 * period_ns() * np.arange(20))


def test_without_a_start_the_arm_goes_on_holding_its_start_pose() -> None:
    done = run(lambda reads: Event.STOP | Event.RELEASED if reads > 40 else Event.NONE, start_ns=lambda *_: None)
    assert done.modes == [Mode.HOLD, Mode.OFF]
    assert (done.rows["mode"][:40] == Mode.READY).all()
    assert done.rows["t"][0] == pytest.approx(-86_400.0), "the trajectory is a day ahead until somebody says when"


def no_start(_: int, __: int) -> None:
    """Nobody gives one."""


def taken_back(reads: int, zero_ns: int) -> int | None:
    """A start until the fifth read, and none behind it."""
    return zero_ns if reads <= 5 else None


@pytest.mark.parametrize("start_ns", [no_start, taken_back])
def test_an_arm_that_nobody_starts_stays_where_it_is_longer_than_a_day(
    start_ns: Callable[[int, int], int | None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("agent.ticks.NOT_YET_NS", 30 * period_ns())
    done = run(lambda n: Event.STOP | Event.RELEASED if n > 80 else Event.NONE, start_ns=start_ns, hold_at_end=True)
    assert done.modes == [Mode.HOLD, Mode.OFF]
    assert len(done.of(Mode.READY)) == 82
    assert done.of(Mode.READY)["t"][-1] > 40 * period_ns() * 1e-9, "its day is over"
    assert done.of(Mode.READY)["e_p"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("t", "told"), [(1.5, "t = 1.500 s: "), (-2.0, "t = -2.000 s: "), (-0.5e-9 * NOT_YET_NS, "before a start: ")]
)
def test_what_happens_is_told_with_its_instant_once_there_is_a_start(t: float, told: str) -> None:
    assert Ticks(Schedule(period_ns(), 10, lockstep=False, hold_at_end=True), 0).told(t) == told


def test_the_common_start_moves_the_phase_once_and_makes_no_cycle_late() -> None:
    done = run()
    steps = np.diff(done.rows["stamp_ns"].astype(np.int64))
    moved = np.flatnonzero(steps != period_ns())
    assert len(moved) == 1
    assert period_ns() < steps[moved[0]] < 2 * period_ns()
    assert (done.rows["late_s"] == 0.0).all()
    assert len(done.of(Mode.READY)) == START_AFTER


def test_a_start_that_changes_while_the_arm_waits_counts_as_it_was_said_last() -> None:
    done = run(start_ns=lambda reads, zero: zero + 3 * period_ns() if reads > 5 else zero)
    assert len(done.of(Mode.READY)) == START_AFTER + 3
    assert done.of(Mode.TRACK)["t"][0] == pytest.approx(0.0, abs=1e-9)


def test_a_start_that_changes_while_the_arm_tracks_is_not_listened_to() -> None:
    done = run(start_ns=lambda reads, zero: zero + 7 * period_ns() if reads > 15 else zero)
    assert done.of(Mode.TRACK)["t"] == pytest.approx(1e-9 * period_ns() * np.arange(20))


def test_an_idle_cycle_changes_no_mode() -> None:
    """The loop asks for the next mode only when something has happened."""
    assert all(next_mode(mode, Event.NONE) is mode for mode in Mode)


# --- stop, release and end -------------------------------------------------------------------------------------------


@pytest.mark.fault("P6")
def test_a_stop_holds_and_only_a_release_ends_it() -> None:
    done = run(lambda n: Event.STOP if n == 20 else Event.RELEASED if n == 60 else Event.NONE, hold_at_end=True)
    assert done.modes == [Mode.TRACK, Mode.HOLD, Mode.OFF]
    hold = done.of(Mode.HOLD)
    assert np.abs(hold["e_p"]).max() < 5e-4, "but for what the observer still expects of the motion"
    assert len(hold) == 40
    assert done.summary.mode is Mode.OFF


def test_the_end_of_the_trajectory_is_held_on_real_arms() -> None:
    done = run(lambda n: Event.RELEASED if n == 80 else Event.NONE, hold_at_end=True)
    assert done.modes == [Mode.TRACK, Mode.HOLD, Mode.OFF]
    assert len(done.of(Mode.TRACK)) == 20
    assert (done.summary.reason, done.troubles) == ("", []), "an end is nothing wrong"


def test_a_hold_in_simulation_lasts_until_the_trajectory_ends() -> None:
    done = run(lambda n: Event.STOP if n == 20 else Event.NONE)
    assert done.modes == [Mode.TRACK, Mode.HOLD]
    assert len(done.of(Mode.TRACK)) + len(done.of(Mode.HOLD)) == 20


def test_who_follows_the_trajectory_has_nothing_to_hold() -> None:
    memory = run().memory
    assert (memory.hold, memory.q_hold) == (None, None)


def test_an_early_release_does_nothing_while_tracking() -> None:
    done = run(lambda n: Event.RELEASED if n == 20 else Event.NONE)
    assert done.modes == [Mode.TRACK]
    assert done.summary.mode is Mode.TRACK


def held_pose(done: Done, read: int) -> Vector:
    """Where the object was at a read, from the row of that cycle."""
    assert done.rows["q_measured"][read - 1][:3] == pytest.approx(moving(read))
    return np.concatenate([done.rows["p_object"][read - 1], done.rows["quat_object"][read - 1]])


def desired(rows: np.ndarray) -> np.ndarray:
    return np.concatenate([rows["p_object_des"], rows["quat_object_des"]], axis=1)


STILL = {"observer": None}


def test_the_object_is_held_where_it_was_when_the_stop_came_however_it_moves_on() -> None:
    done = run(lambda n: Event.STOP if n == 19 else Event.NONE, q=moving, agent=STILL)  # in the cycle of read 20
    hold = done.of(Mode.HOLD)
    assert len(hold) == 10
    for pose in desired(hold):
        np.testing.assert_allclose(pose, held_pose(done, 20), atol=1e-12)


def test_an_object_that_was_lost_from_sight_is_held_where_it_is_seen_again() -> None:
    done = run(failures=lost_at(18, 19, 20, 21), q=moving, agent=STILL)
    assert done.modes == [Mode.TRACK, Mode.HOLD]
    hold = done.of(Mode.HOLD)
    assert len(hold) == 9
    for pose in desired(hold):
        np.testing.assert_allclose(pose, held_pose(done, 22), atol=1e-12)


def test_the_start_pose_is_the_first_one_seen_until_the_start() -> None:
    done = run(q=moving, agent=STILL)
    for pose in desired(done.of(Mode.READY)):
        np.testing.assert_allclose(pose, held_pose(done, 1), atol=1e-12)


# --- ticks -----------------------------------------------------------------------------------------------------------


@pytest.mark.fault("P3")
def test_a_late_cycle_keeps_the_phase_and_is_not_caught_up() -> None:
    done = run(pauses_ns={20: int(3.4 * period_ns())})
    tracked = done.of(Mode.TRACK)
    phase = (tracked["stamp_ns"] - tracked["stamp_ns"][0]) % period_ns()
    assert (np.minimum(phase, period_ns() - phase) == 0).sum() >= len(tracked) - 1
    assert len(tracked) == 20 - 3


@pytest.mark.parametrize(("pause", "rows"), [(0.999, 20), (1.0, 19), (1.999, 19), (2.0, 18)])
def test_a_cycle_that_ends_when_the_next_should_have_begun_skips_it(pause: float, rows: int) -> None:
    assert len(run(pauses_ns={20: round(pause * period_ns())}).of(Mode.TRACK)) == rows


@pytest.mark.parametrize(("late", "counted"), [(0.5, 0), (1.0, 0), (1.0 + 1e-6, 1), (1.9, 1)])
@pytest.mark.fault("P3")
def test_a_cycle_that_begins_more_than_a_period_late_is_counted(late: float, counted: int) -> None:
    done = run(oversleeps_ns={15: round(late * period_ns()), 18: round(late * period_ns())})
    assert done.summary.late_cycles == 2 * counted
    assert sorted(done.rows["late_s"])[-3:] == pytest.approx([0.0, *[late * period_ns() * 1e-9] * 2])


# --- lockstep --------------------------------------------------------------------------------------------------------


def test_simulated_time_tracks_from_its_first_tick_and_waits_for_the_log_every_cycle() -> None:
    done = run(lockstep=True, start_ns=lambda *_: None)
    assert done.modes == [Mode.TRACK]
    assert done.summary.mode is Mode.TRACK
    assert done.rows["t"] == pytest.approx(1e-9 * period_ns() * np.arange(20), abs=1e-15)
    assert done.waits == 20
    assert run().waits == 0


def test_simulated_time_is_never_late_and_skips_nothing() -> None:
    slow = {read: 3 * period_ns() for read in range(1, 21)}
    done = run(lockstep=True, pauses_ns=slow, oversleeps_ns={3: 5 * period_ns()})
    assert len(done.rows) == 20
    assert (done.rows["late_s"] == 0.0).all()
    assert done.summary.late_cycles == 0


def test_a_lost_state_ends_simulated_time_in_a_fault() -> None:
    done = run(lockstep=True, failures=lost_at(5))
    assert (done.summary.mode, done.summary.reason) == (Mode.FAULT, str(lost()))
    assert str(done.summary.lost) == done.summary.reason
    assert len(done.rows) == 5
    assert len(done.arm.written) == 4
