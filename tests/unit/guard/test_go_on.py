"""What a guard begins with: the time of the run, the torque that the servos hold, and marks for what was lost."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest

from agent.around import Beginning, Schedule
from agent.cycles import Patience
from agent.guard.takeover import (
    EMULATED_FLOATING_STALE_NS,
    FLOATING_FIRST_NS,
    FLOATING_STALE_NS,
    WATCH_NS,
    clock_of,
    go_on,
    stale_ns,
)
from agent.modes import Event, Mode
from agent.process.build import build_agent
from agent.safety import Flag
from drivers.clock import utc_offset_ns
from drivers.dynamixel.arm_map import WATCHDOG_S
from drivers.interface import JointState, Vector
from tests.support.runner_rig import paper, period_ns, run

AGENT = build_agent(paper(), paper().arms[0])
GAP_NS = 10 * period_ns()
SCHEDULE = Schedule(period_ns(), 1, lockstep=False, hold_at_end=True, patience=Patience(blind=4, quiet=5, recover=40))
LOST_NS = (4 + 5 + 40) * period_ns()
NANOSECOND = 1


@cache
def _rows() -> Any:
    """Of an agent that is stopped, up to the hold of its own."""

    def operator(reads: int) -> Event:
        stopped = Event.STOP if reads > 24 else Event.NONE
        return stopped | (Event.RELEASED if reads > 26 else Event.NONE)

    made = run(operator)
    return made.rows[made.rows["mode"] != Mode.HOLD]


def rows() -> Any:
    return _rows().copy()


@dataclass
class Servos:
    """As a guard finds them."""

    held: Vector
    resumed: bool = False
    tripped: bool = False
    limp: bool = False
    last: JointState | None = None

    def adopt(self, last: JointState | None, *, brings_back: bool) -> Vector:
        self.last, self.limp = last, self.tripped and not brings_back
        return self.held


@dataclass
class Now:
    ns: int

    def now_ns(self) -> int:
        return self.ns

    def sleep_until(self, deadline_ns: int) -> None: ...


def begun(
    late_ns: int = 0, of: Any = None, *, session: bool = False, resumed: bool = False, tripped: bool = False
) -> Beginning:
    """So long after the last row, on servos that hold a torque of their own."""
    of = rows() if of is None else of
    now: Any = Now(int(rows()[-1]["stamp_ns"]) + late_ns)
    return go_on(AGENT, Servos(np.full(3, 0.7), resumed, tripped), now, of, SCHEDULE, "x", session=session)


def test_a_guard_tells_the_time_of_the_run_and_without_rows_of_its_host() -> None:
    of_run = rows()
    of_run["stamp_ns"][-1], of_run["utc_ns"][-1] = 5_000, 1_700_000_000_000_000_123
    assert clock_of(of_run).utc_offset_ns == 1_699_999_999_999_995_123
    assert clock_of(of_run[:0]).utc_offset_ns == pytest.approx(utc_offset_ns(), abs=1e9)


def test_more_than_ten_cycles_without_a_command_are_a_gap_and_the_pose_is_found_anew() -> None:
    at_once, late = begun(GAP_NS), begun(GAP_NS + NANOSECOND)
    assert (at_once.marks, late.marks) == (Flag.NONE, Flag.GAP)
    assert at_once.memory.hold is not None
    assert late.memory.hold is None


def test_without_rows_no_time_is_known_to_be_lost() -> None:
    found = begun(1_000 * GAP_NS, rows()[:0])
    assert (found.marks, found.mode, found.rows) == (Flag.NONE, Mode.HOLD, 0)
    assert begun(0, rows()[:0], session=True).mode is Mode.REST
    now: Any = Now(0)
    assert go_on(AGENT, Servos(np.zeros(3)), now, rows()[:0], SCHEDULE, "x").mode is Mode.HOLD


def test_an_arm_that_had_stopped_by_itself_is_marked_and_a_gap_beside_it() -> None:
    assert begun(0, resumed=True).marks is Flag.RESUMED
    assert begun(GAP_NS + NANOSECOND, resumed=True).marks is Flag.RESUMED | Flag.GAP


@pytest.mark.fault("P12")
@pytest.mark.parametrize("session", [False, True])
def test_a_guard_that_comes_as_late_as_a_loop_gives_up_does_not_bring_a_limp_arm_back(session: bool) -> None:
    in_time, late = (begun(LOST_NS + more, tripped=True, session=session) for more in (0, NANOSECOND))
    assert (in_time.mode, late.mode) == (Mode.HOLD, Mode.FAULT)
    assert in_time.reason == "x"
    assert late.reason == f"x, and nobody commanded the arm for {LOST_NS * 1e-9:.1f} s: its servos have let go"
    assert begun(LOST_NS + NANOSECOND).mode is Mode.HOLD, "somebody has fed its watchdogs, and it stands as it was left"


@pytest.mark.fault("S5")
def test_a_limp_arm_that_its_agent_did_not_see_is_not_brought_back() -> None:
    of = rows()
    of["flags"] |= int(Flag.STALE)
    blind = begun(0, of, tripped=True)
    assert (blind.mode, blind.reason) == (Mode.FAULT, "x, and it had not seen the arm: its servos have let go")
    assert begun(0, of).mode is Mode.HOLD, "its servos still hold it"
    of["flags"][-1] ^= int(Flag.STALE)
    assert begun(0, of, tripped=True).mode is Mode.HOLD
    assert begun(0, rows()[:0], tripped=True).mode is Mode.HOLD, "an agent without rows has rejected nothing"


def test_the_first_step_counts_from_what_the_servos_hold_and_they_are_told_how_fast_the_arm_was() -> None:
    of, servos = rows(), Servos(np.full(3, 0.7))
    of["dq_measured"][-1, :3] = [0.1, -0.2, 0.3]
    now: Any = Now(int(of[-1]["stamp_ns"]))
    found = go_on(AGENT, servos, now, of, SCHEDULE, "the agent has died")
    assert found.memory.tau.tolist() == [0.7] * 3
    assert (found.reason, found.rows) == ("the agent has died", int(of[-1]["sequence"]) + 1)
    assert servos.last is not None
    assert servos.last.dq.tolist() == [0.1, -0.2, 0.3]


def test_a_guard_looks_often_enough_and_gives_up_on_an_agent_before_its_servos_do() -> None:
    hangs_ns = stale_ns(period_ns(), emulated=False, simulated=False)
    assert WATCH_NS == 2_000_000
    assert hangs_ns + WATCH_NS < 1e9 * WATCHDOG_S
    assert FLOATING_STALE_NS + WATCH_NS < 1e9 * WATCHDOG_S
    assert FLOATING_FIRST_NS == EMULATED_FLOATING_STALE_NS == 500_000_000
