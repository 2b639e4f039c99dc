"""What makes the loop hold the object or give the arm up, after how many cycles, and what it says of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from agent.control.cause import Cause
from agent.control.residual import Channels, Residual
from agent.cycles import Patience
from agent.modes import Event, Mode
from agent.safety import Flag, Limits
from agent.telling import Telling
from drivers.interface import DriverError, Vector
from tests.support.runner_rig import (
    FAULT_AFTER_STALE,
    HOLD_AFTER_STALE,
    fault,
    lost,
    lost_at,
    period_ns,
    q_start,
    run,
)

FIRST = 15  # a read in TRACK


def reads(count: int, first: int = FIRST) -> tuple[int, ...]:
    return tuple(range(first, first + count))


# --- lost states -----------------------------------------------------------------------------------------------------


def test_single_lost_states_keep_the_last_torque_and_go_on() -> None:
    done = run(failures=lost_at(15, 18))
    assert done.summary.mode is Mode.TRACK
    assert (done.summary.stale_cycles, done.summary.reason) == (2, "")
    stale = np.flatnonzero(done.rows["flags"] & Flag.STALE.value)
    assert stale.tolist() == [14, 17]
    for i in stale:
        assert np.isnan(done.rows["q"][i][:3]).all()
        np.testing.assert_array_equal(done.arm.written[i], done.arm.written[i - 1])


@pytest.mark.parametrize(("count", "held"), [(HOLD_AFTER_STALE, False), (HOLD_AFTER_STALE + 1, True)])
@pytest.mark.parametrize("first", [1, FIRST])
@pytest.mark.fault("B3")
def test_more_than_three_states_lost_in_a_row_hold_the_object(first: int, count: int, held: bool) -> None:
    done = run(failures=lost_at(*reads(count, first)))
    assert (Mode.HOLD in done.modes) == held
    assert done.summary.reason == (str(lost()) if held else "")
    assert done.summary.stale_cycles == count
    if held:
        assert done.rows["mode"][first + count - 1] == Mode.HOLD, "from the next cycle on"
        assert done.rows["mode"][first + count - 2] != Mode.HOLD


@pytest.mark.parametrize(
    ("count", "ends"), [(FAULT_AFTER_STALE - 1, Mode.HOLD), (FAULT_AFTER_STALE, Mode.FAULT), (60, Mode.FAULT)]
)
def test_eight_states_lost_in_a_row_end_in_a_fault_where_the_arm_cannot_come_back(count: int, ends: Mode) -> None:
    done = run(failures=lost_at(*reads(count)))
    assert (done.summary.mode, done.summary.reason) == (ends, str(lost()))
    if ends is Mode.FAULT:
        assert done.arm.reads == FIRST - 1 + FAULT_AFTER_STALE
        assert len(done.rows) == done.arm.reads + 1, "in the last cycle nothing is asked"
        assert len(done.arm.written) == done.arm.reads, "and nothing sent"


def test_a_fresh_state_in_between_begins_the_count_anew() -> None:
    assert run(failures=lost_at(*reads(3, 14), *reads(3, 18), *reads(3, 22))).modes == [Mode.TRACK]
    assert run(failures=lost_at(*reads(3, 14), *reads(4, 18))).modes == [Mode.TRACK, Mode.HOLD]
    many = lost_at(*reads(7, 12), *reads(7, 20))
    assert run(failures=many).summary.mode is Mode.HOLD


def test_a_servo_that_complains_but_answers_begins_the_count_anew() -> None:
    failures = lost_at(*reads(7, 12), *reads(7, 20)) | {19: fault(True)}
    assert run(failures=failures).summary.mode is Mode.HOLD
    failures = lost_at(*reads(7, 12), *reads(8, 20)) | {19: fault(True)}
    assert run(failures=failures).summary.mode is Mode.FAULT


def test_every_cycle_is_a_heartbeat() -> None:
    """It says that the loop lives; an arm that nobody sees is held by that loop, so nobody may kill it for that."""
    done = run(failures=lost_at(15, 17) | {20: fault(True)})
    assert done.beats == len(done.rows)


# --- servos ----------------------------------------------------------------------------------------------------------


def test_a_servo_fault_holds_the_object_with_the_others() -> None:
    done = run(lambda n: Event.RELEASED if n == 40 else Event.NONE, failures={15: fault(True)}, hold_at_end=True)
    assert done.modes == [Mode.TRACK, Mode.HOLD, Mode.OFF]
    assert done.summary.reason == str(fault(True))
    assert done.rows["mode"][15] == Mode.HOLD, "at once"
    assert done.summary.stale_cycles == 0


def test_a_servo_fault_without_a_state_ends_in_fault() -> None:
    done = run(failures={15: fault(False)})
    assert (done.summary.mode, done.summary.reason) == (Mode.FAULT, str(fault(False)))
    assert done.arm.reads == 15


@pytest.mark.fault("S4")
def test_an_arm_that_holds_for_a_silence_tells_what_its_servo_says_once_it_answers() -> None:
    silent = lost_at(*reads(HOLD_AFTER_STALE + 1))
    back = FIRST + len(silent)
    done = run(failures=silent | {back: fault(True), back + 1: fault(True)})
    assert done.troubles == [str(lost()), str(fault(True))]
    assert done.summary.reason == str(fault(True))
    assert run(failures=silent | {back: fault(False)}).troubles == [str(lost())], "it does not hold any more"


def test_an_arm_that_was_asked_to_hold_tells_of_a_servo_that_fails_then() -> None:
    done = run(lambda n: Event.STOP if n == 14 else Event.NONE, {17: fault(True), 18: fault(True)})
    assert done.modes == [Mode.TRACK, Mode.HOLD]
    assert done.troubles == [str(fault(True))]


@pytest.mark.parametrize("seen", [True, False])
def test_whether_the_arm_answers_is_told_with_a_servo_that_fails_in_a_hold(
    monkeypatch: pytest.MonkeyPatch, seen: bool
) -> None:
    told: list[tuple[Mode, bool]] = []
    monkeypatch.setattr(Telling, "stands", lambda _, mode, __, *, seen: told.append((mode, seen)))
    failing = fault(True)
    if not seen:
        failing.state.q[1] = np.nan
    run(lambda n: Event.STOP if n == 14 else Event.NONE, {17: failing, 18: failing})
    assert told == [(Mode.HOLD, seen)]


def test_an_arm_that_is_lost_in_the_cycle_of_a_release_is_a_fault() -> None:
    words = {15: Event.STOP, 29: Event.STOP | Event.RELEASED}  # before read 30
    done = run(lambda n: words.get(n, Event.NONE), failures={30: fault(False)}, hold_at_end=True)
    assert done.modes[-2:] == [Mode.HOLD, Mode.FAULT]
    assert done.summary.mode is Mode.FAULT
    assert run(lambda n: words.get(n, Event.NONE), hold_at_end=True).summary.mode is Mode.OFF


def test_a_blind_arm_goes_to_its_weights_torque_step_by_step() -> None:
    aside = lambda read: q_start() + (0.2 if read > 5 else 0.0)  # noqa: E731 - a spring pulls it back
    weak = {"limits": Limits((5.0,) * 3, (0.01,) * 3), "error_max_m": np.inf, "error_max_rad": np.inf}
    done = run(q=aside, failures=lost_at(*reads(8)), agent=weak)
    blind = np.flatnonzero(done.rows["flags"] & Flag.BLIND.value)[:4]
    steps = np.diff(np.array(done.arm.written)[blind], axis=0)
    assert np.abs(steps).max(axis=1) == pytest.approx(0.01)


def test_in_lockstep_a_lost_state_makes_no_arm_blind() -> None:
    done = run(failures=lost_at(5), lockstep=True, patience=Patience(repeat=0))
    assert done.summary.mode is Mode.FAULT
    assert not (done.rows["flags"] & Flag.BLIND.value).any()


@pytest.mark.parametrize("of", ["q", "dq"])
def test_a_fault_without_a_whole_state_is_a_cycle_without_one(of: str) -> None:
    part = fault(True)
    getattr(part.state, of)[1] = np.nan
    done = run(failures=dict.fromkeys(reads(60), part), patience=Patience(blind=8))
    assert done.modes == [Mode.TRACK, Mode.HOLD, Mode.FAULT]
    stale = done.rows[FIRST - 1 :]
    assert (stale["flags"] & Flag.STALE.value > 0).all()
    assert (stale["flags"] & Flag.BLIND.value > 0).tolist() == [False] * 3 + [True] * 6
    assert len(done.arm.written) == FIRST - 1 + 8
    assert done.rows["mode"][FIRST] == Mode.HOLD, "a fault is trouble at once"


def test_ninety_good_cycles_of_a_hundred_are_enough_and_fewer_hold() -> None:
    """Single lost states, never two in a row."""
    some = lost_at(*range(15, 35, 2))
    assert run(failures=some, ticks=90).modes == [Mode.TRACK]
    done = run(failures=some | lost_at(36), ticks=90)
    assert done.modes == [Mode.TRACK, Mode.HOLD]
    assert done.summary.reason == "89% of the last 100 cycles brought a state in time"
    assert done.rows["mode"][35] == Mode.TRACK
    assert done.rows["mode"][36] == Mode.HOLD


def test_late_cycles_are_no_good_ones() -> None:
    late = {sleep: round(1.5 * period_ns()) for sleep in range(15, 45, 3)}
    assert run(oversleeps_ns=late, ticks=90).summary.mode is Mode.HOLD


def test_in_lockstep_no_time_is_lost() -> None:
    slow = {read: 40 * period_ns() for read in range(1, 21)}
    done = run(lockstep=True, pauses_ns=slow, start_ns=lambda *_: None)
    assert (done.summary.mode, done.summary.reason) == (Mode.TRACK, "")


def test_the_first_trouble_is_what_is_told_and_a_fault_has_the_last_word() -> None:
    late_fault = {15: fault(True)} | lost_at(*reads(4, 20))
    assert run(failures=late_fault).summary.reason == str(fault(True))
    given_up = {15: fault(True)} | lost_at(*reads(9, 20))
    assert run(failures=given_up).summary.reason == str(lost())


# --- the bus takes no torque -----------------------------------------------------------------------------------------


def test_a_torque_that_was_not_taken_is_no_number_in_the_log_and_a_reason_but_no_end() -> None:
    done = run(refused=frozenset({15, 16}))
    assert done.modes == [Mode.TRACK]
    assert "0 bytes taken" in done.summary.reason
    assert np.isnan(done.rows["tau_sent"][[14, 15], :3]).all()
    assert np.isfinite(np.delete(done.rows["tau_sent"], [14, 15], axis=0)[:, :3]).all()


def test_a_torque_that_was_not_taken_before_the_start_is_told_at_the_end() -> None:
    assert "0 bytes taken" in run(refused=frozenset({3})).summary.reason
    assert run(failures={15: fault(True)}, told=False).summary.reason == str(fault(True))


def test_the_reason_of_a_refused_torque_is_the_first_one_too() -> None:
    done = run(refused=frozenset({20}), failures={15: fault(True)})
    assert done.summary.reason == str(fault(True))


def test_a_torque_that_was_not_taken_once_is_not_why_the_arm_holds_later() -> None:
    done = run(refused=frozenset({12}), failures={16: fault(True)})
    assert (done.modes, done.troubles) == ([Mode.TRACK, Mode.HOLD], [str(fault(True))])
    assert done.summary.reason == str(fault(True))


@pytest.mark.fault("P7")
def test_an_arm_that_holds_for_its_host_says_why() -> None:
    def gone(reads: int) -> Event:
        return Event.TROUBLE if reads == 14 else Event.NONE

    done = run(gone, of_host="the guard is gone")
    assert (done.modes, done.troubles) == ([Mode.TRACK, Mode.HOLD], ["the guard is gone"])
    assert done.summary.reason == "the guard is gone"
    assert run(gone, {14: fault(True)}, of_host="the guard is gone").troubles == [str(fault(True))]
    assert run(failures={15: fault(True)}, of_host="").troubles == [str(fault(True))]


def test_simulated_time_stops_at_a_torque_that_was_not_taken() -> None:
    with pytest.raises(DriverError, match="0 bytes taken"):
        run(refused=frozenset({5}), lockstep=True)


# --- flags -----------------------------------------------------------------------------------------------------------


def no_number(read: int) -> Vector:
    return q_start() * (np.nan if read == FIRST else 1.0)


FLAGGED: dict[str, dict[str, Any]] = {
    "NOT_FINITE": {"q": no_number},
    "SINGULAR": {"agent": {"sigma_min": 10.0, "observer": None}},
    "OFF_TRACK": {"agent": {"error_max_m": 1e-6, "observer": None}},
    "UNEXPECTED": {"agent": {"residual": Residual(0.005, 1.5, Channels(-1.0, -1.0, -1.0, -1.0))}},
}


@pytest.mark.parametrize("flag", FLAGGED)
def test_what_step_flags_as_trouble_holds_the_object_and_is_told_with_its_time(flag: str) -> None:
    done = run(lambda n: Event.RELEASED if n == 40 else Event.NONE, **FLAGGED[flag])
    first = done.rows[np.flatnonzero(done.rows["flags"] & Flag[flag].value)[0]]
    cause = f" {Cause.BEGIN} (" if flag == "UNEXPECTED" else ""
    when = f"t = {first['t']:.3f} s: " if first["t"] > -1e3 else "before a start: "
    assert done.summary.reason.startswith(f"{when}{flag}{cause}")
    assert bool(cause) or done.summary.reason.endswith(f": {flag}"), "the names of flags, as docs/failures.md has them"
    assert done.troubles == [done.summary.reason]
    assert Mode.HOLD in done.modes
    assert done.rows["mode"][first["sequence"] + 1] == Mode.HOLD


def test_braking_in_a_hold_is_no_trouble_of_its_own() -> None:
    swings = [k % 2 * 1e-3 for k in range(100)]
    done = run(
        lambda n: Event.STOP if n == 15 else Event.RELEASED if n == 40 else Event.NONE,
        q=lambda read: q_start() + swings[read],
        agent={"damp_above_rad_per_s": 1e-6},
    )
    held = done.of(Mode.HOLD)
    assert (held["flags"] & Flag.DAMPED.value).any()
    assert done.summary.reason == ""
    assert done.troubles == []


def test_torque_that_was_limited_is_no_trouble() -> None:
    done = run(agent={"limits": Limits((0.05,) * 3, (0.01,) * 3)})
    assert np.bitwise_or.reduce(done.rows["flags"]) == (Flag.SATURATED | Flag.RATE_LIMITED).value
    assert (done.modes, done.summary.reason) == ([Mode.TRACK], "")


def test_of_two_flagged_ticks_the_first_is_told() -> None:
    done = run(q=lambda read: q_start() * (np.nan if read in (15, 18) else 1.0), failures={20: fault(True)})
    assert done.summary.reason.startswith(f"t = {done.rows['t'][14]:.3f} s")


def test_a_reason_that_was_there_before_a_flag_stays() -> None:
    done = run(q=lambda read: q_start() * (np.nan if read == 18 else 1.0), failures={15: fault(True)})
    assert done.summary.reason == str(fault(True))
