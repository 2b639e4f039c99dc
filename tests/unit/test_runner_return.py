"""What the loop does where time was lost, with an arm that comes back, and behind another loop."""

from __future__ import annotations

import numpy as np
import pytest

from agent.around import Beginning
from agent.cycles import Patience
from agent.loop import initial_memory
from agent.modes import Event, Mode
from agent.process.build import build_agent
from agent.safety import Flag, Limits
from drivers.interface import DriverError, Vector
from tests.support.runner_rig import fault, lost, lost_at, paper, period_ns, q_start, run

STOP_AT = 15  # a read in TRACK
STEP_NM = 0.05
WEAK = Limits((5.0,) * 3, (STEP_NM,) * 3)


def flagged(rows: np.ndarray, flag: Flag) -> list[int]:
    found: list[int] = np.flatnonzero(rows["flags"] & flag.value).tolist()
    return found


def late(periods: float, sleep: int = 16) -> dict[int, int]:
    """One cycle begins so much later than it should."""
    return {sleep: round(periods * period_ns())}


def moving(read: int) -> Vector:
    return q_start() + np.array([0.0, 0.0, 1e-3 * read])


# --- lost time -------------------------------------------------------------------------------------------------------


@pytest.mark.fault("P12")
def test_a_cycle_after_lost_time_holds_where_it_finds_the_arm_before_any_torque_goes_out() -> None:
    done = run(oversleeps_ns=late(9.5), q=moving, agent={"observer": None}, ticks=60, patience=Patience())
    assert done.modes == [Mode.TRACK, Mode.HOLD]
    assert done.summary.reason == f"no cycle for {10.5 * period_ns() * 1e-9:.3f} s"
    assert flagged(done.rows, Flag.GAP) == [15], "in one row"
    gap = done.rows[15]
    assert (gap["mode"], done.rows["mode"][14]) == (Mode.HOLD, Mode.TRACK)
    np.testing.assert_allclose(gap["p_object_des"], gap["p_object"], atol=1e-12)
    assert done.troubles == [done.summary.reason]


@pytest.mark.parametrize("periods", [41, 600])
def test_however_long_nobody_looked_an_arm_without_watchdogs_is_held_where_it_is_seen_then(periods: int) -> None:
    plan = {"ticks": periods + 80, "patience": Patience()}
    for done in (run(oversleeps_ns=late(periods), **plan), run(pauses_ns={16: periods * period_ns()}, **plan)):
        assert done.modes == [Mode.TRACK, Mode.HOLD]
        assert done.summary.stale_cycles == 0
    gone = lost_at(*range(17, 80))
    assert run(oversleeps_ns=late(periods), failures=gone, **plan).summary.mode is Mode.FAULT, "but not for ever"


def test_reads_that_are_waited_for_are_no_time_in_which_nobody_looked() -> None:
    silent = range(17, 80)
    done = run(
        failures=lost_at(*silent), pauses_ns=dict.fromkeys(silent, 5 * period_ns()), ticks=600, patience=Patience()
    )
    assert done.summary.mode is Mode.FAULT
    assert done.arm.reads < silent[10]


@pytest.mark.parametrize(("periods", "ends"), [(480, Mode.HOLD), (500, Mode.FAULT)])
def test_an_arm_that_was_limp_for_longer_than_it_may_come_back_is_given_up(periods: int, ends: Mode) -> None:
    """Somebody may have a hand on it by then."""
    done = run(oversleeps_ns=late(periods), returning={}, failures=lost_at(5), ticks=periods + 80, patience=Patience())
    assert done.summary.mode is ends
    assert done.summary.reason.startswith("no cycle for"), "not what was lost long before"
    assert flagged(done.rows, Flag.RESUMED) == ([] if ends is Mode.FAULT else [16])


def test_ten_periods_are_no_lost_time() -> None:
    done = run(oversleeps_ns=late(9.0), ticks=60, patience=Patience(success_min=0.0))
    assert (done.modes, flagged(done.rows, Flag.GAP)) == ([Mode.TRACK], [])


def test_an_arm_that_holds_already_goes_on_with_what_it_holds() -> None:
    done = run(lambda n: Event.STOP if n == 12 else Event.NONE, oversleeps_ns=late(30), ticks=80, patience=Patience())
    assert done.modes == [Mode.TRACK, Mode.HOLD]
    assert flagged(done.rows, Flag.GAP) == []
    assert done.summary.reason.startswith("no cycle for")


def test_what_was_wrong_before_time_was_lost_is_what_is_told() -> None:
    done = run(failures={14: fault(True)}, oversleeps_ns=late(30), ticks=80, patience=Patience())
    assert done.summary.reason == str(fault(True))


def test_a_cycle_without_a_state_says_that_time_was_lost() -> None:
    done = run(oversleeps_ns=late(30), failures=lost_at(16), ticks=80, patience=Patience())
    assert flagged(done.rows, Flag.GAP) == flagged(done.rows, Flag.STALE) == [15]


def test_what_the_first_state_is_waited_for_is_no_lost_time() -> None:
    done = run(pauses_ns={1: 50 * period_ns()}, start_ns=lambda _, zero_ns: zero_ns + 60 * period_ns())
    assert (done.modes, done.summary.reason) == ([Mode.TRACK], "")
    later = run(
        pauses_ns={2: 50 * period_ns()},
        start_ns=lambda _, zero_ns: zero_ns + 60 * period_ns(),
        ticks=80,
        patience=Patience(blind=80),
    )
    assert later.modes == [Mode.HOLD]


# --- an arm that comes back ------------------------------------------------------------------------------------------


def held(n: int) -> Event:
    return Event.STOP if n == STOP_AT else Event.RELEASED if n == 60 else Event.NONE


def test_an_arm_that_has_stopped_is_brought_back_in_hold_and_begins_without_torque() -> None:
    done = run(held, returning={"lapses": frozenset({20})}, agent={"limits": WEAK}, hold_at_end=True)
    assert done.arm.tried == [20]  # type: ignore[attr-defined]
    assert flagged(done.rows, Flag.RESUMED) == [20]
    before, back = np.abs(done.arm.written[19:21])
    assert (before > STEP_NM).any()
    assert (back <= STEP_NM + 1e-9).all(), "from no torque within a step"


def test_an_arm_that_had_not_stopped_goes_on_with_its_torque() -> None:
    done = run(held, returning={"lapses": frozenset({20}), "answers": (False,)}, hold_at_end=True)
    assert done.arm.tried == [20]  # type: ignore[attr-defined]
    assert flagged(done.rows, Flag.RESUMED) == []
    assert np.isfinite(done.rows["q"][20][:3]).all(), "it is asked in the same cycle"


def test_an_arm_that_has_stopped_is_left_alone_while_it_tracks() -> None:
    done = run(returning={"lapses": frozenset({14})})
    assert done.arm.tried == []  # type: ignore[attr-defined]
    assert done.modes == [Mode.TRACK]


def test_in_lockstep_no_arm_is_brought_back() -> None:
    done = run(
        lambda n: Event.STOP if n == STOP_AT else Event.NONE, returning={"lapses": frozenset({18})}, lockstep=True
    )
    assert (done.modes[-1], done.arm.tried) == (Mode.HOLD, [])  # type: ignore[attr-defined]


def test_an_arm_that_does_not_come_back_is_asked_and_told_nothing_in_that_cycle() -> None:
    gone = DriverError("port", found="none", expected="one", remedy="plug it in")
    done = run(
        held,
        returning={"lapses": frozenset({20}), "answers": (gone,)},
        patience=Patience(hold=3, blind=8, quiet=5, recover=12, retry=4),
        hold_at_end=True,
    )
    # read 20 is the last: every fourth cycle it is tried, and asked in between only as long as it is not blind
    assert done.arm.tried[0] == 20  # type: ignore[attr-defined]
    assert flagged(done.rows, Flag.RESUMED) == []
    first = done.rows[20]
    assert first["flags"] & Flag.STALE.value
    assert np.isnan(first["tau_sent"][:3]).all()
    assert done.rows["flags"][21] & Flag.STALE.value == 0, "it is asked again in the next cycle"


def test_a_blind_arm_falls_silent_and_is_tried_until_the_patience_is_over() -> None:
    gone = DriverError("port", found="none", expected="one", remedy="plug it in")
    done = run(
        failures=lost_at(*range(STOP_AT, 99)),
        returning={"answers": (gone,)},
        patience=Patience(hold=3, repeat=3, blind=8, quiet=5, recover=6, retry=4),
        ticks=90,
    )
    assert done.modes == [Mode.TRACK, Mode.HOLD, Mode.FAULT]
    assert done.arm.reads == STOP_AT - 1 + 8
    assert len(done.arm.written) == done.arm.reads
    assert len(done.arm.tried) == 2  # type: ignore[attr-defined]
    assert len(done.rows) == STOP_AT - 1 + 8 + 5 + 6 + 1
    assert done.summary.reason == str(gone), "the last word is that of the last attempt"


@pytest.mark.fault("S4")
def test_a_blind_arm_that_has_lost_its_torque_is_given_up_with_the_attempt_that_finds_it_so() -> None:
    done = run(
        failures=lost_at(*range(STOP_AT, 99)),
        returning={"answers": (fault(False),)},
        patience=Patience(hold=3, repeat=3, blind=8, quiet=5, recover=60, retry=4),
        ticks=90,
    )
    assert done.modes == [Mode.TRACK, Mode.HOLD, Mode.FAULT]
    assert len(done.arm.tried) == 1  # type: ignore[attr-defined]
    assert len(done.rows) == STOP_AT - 1 + 8 + 5 + 1
    assert done.summary.reason == str(fault(False))


def test_a_blind_arm_that_comes_back_is_asked_again_and_holds() -> None:
    done = run(
        lambda n: Event.RELEASED if n == 60 else Event.NONE,
        failures=lost_at(*range(STOP_AT, STOP_AT + 8)),
        returning={},
        patience=Patience(hold=3, repeat=3, blind=8, quiet=5, recover=6, retry=4),
        hold_at_end=True,
    )
    assert done.modes == [Mode.TRACK, Mode.HOLD, Mode.OFF]
    assert flagged(done.rows, Flag.RESUMED) == [STOP_AT - 1 + 8 + 5]
    assert done.summary.reason == str(lost())


# --- behind another loop ---------------------------------------------------------------------------------------------


def test_a_loop_goes_on_where_another_one_ended() -> None:
    memory = initial_memory(build_agent(paper(), paper().arms[0]))._replace(tau=np.array([0.1, 0.2, 0.3]))
    zero_ns = 1_000_000_000 - 40 * period_ns()  # 40 cycles before this loop's first one
    begun = Beginning(Mode.HOLD, memory, zero_ns, 7, "its agent was gone", Flag.RESUMED)
    word = lambda n: Event.RELEASED if n == 5 else Event.NONE  # noqa: E731
    done = run(word, agent={"limits": WEAK}, beginning=begun, happened=Event.NONE, hold_at_end=True)
    assert done.modes == [Mode.OFF]
    assert done.rows["sequence"].tolist() == list(range(7, 13))
    assert done.rows["t"] == pytest.approx(1e-9 * period_ns() * np.arange(40, 46))
    assert (done.rows["mode"] == Mode.HOLD).all()
    assert flagged(done.rows, Flag.RESUMED) == [0]
    assert (done.summary.reason, done.summary.ticks) == ("its agent was gone", 13)
    assert (np.abs(done.arm.written[0] - memory.tau) <= STEP_NM + 1e-9).all()


def test_the_memory_of_a_loop_is_what_its_next_tick_would_begin_with() -> None:
    done = run()
    np.testing.assert_array_equal(done.memory.tau, done.arm.written[-1])
