"""From an agent that is gone to a loop in HOLD: what its guard does, in this order, on any clock."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

from agent.around import Beginning, Schedule
from agent.cycles import Patience
from agent.guard.pulse import SHARED_STALE_NS
from agent.guard.resume import beginning, from_torque, last_seen
from agent.guard.vigil import Vigil
from agent.loop import Agent
from agent.modes import Mode
from agent.replay.tick import Rows
from agent.safety import Flag
from drivers.clock import MonotonicClock
from drivers.interface import Clock, JointState, Vector

WATCH_NS = 2_000_000  # between two looks at the agent
STALE_NS = 18_000_000  # without a row, after which it is ended: it hangs
GAP_PERIODS = Patience.gap  # as the loop has it for itself
STALE_PERIODS = 3  # at least, of a slow loop
EMULATED_STALE_NS = 150_000_000  # where everything shares a processor; before the servos' own watchdog all the same
FLOATING_STALE_NS = 100_000_000  # its last torque is its weight's, and a hand is on it
EMULATED_FLOATING_STALE_NS = SHARED_STALE_NS  # nothing can fall, and its loop bears a line that is silent for as long
FIRST_NS = 100_000_000  # for its first row: until then its goals are zero; before the servos' watchdog
FLOATING_FIRST_NS = 500_000_000  # nothing of it holds the arm yet, and its hand waits
SIMULATED_STALE_NS = 500_000_000  # where there is no such watchdog


def stale_ns(period_ns: int, emulated: bool, simulated: bool, *, floating: bool = False) -> int:
    """How long an agent with that period may go without a row."""
    if simulated:
        return SIMULATED_STALE_NS
    if emulated:
        return EMULATED_FLOATING_STALE_NS if floating else EMULATED_STALE_NS
    return max(FLOATING_STALE_NS if floating else STALE_NS, STALE_PERIODS * period_ns)


def vigil_of(period_ns: int, *, emulated: bool, simulated: bool, floating: bool) -> Vigil:
    """Whoever watches an agent with that period from when its torque is on."""
    stale = stale_ns(period_ns, emulated, simulated, floating=floating)
    return Vigil(stale, WATCH_NS, FLOATING_FIRST_NS if floating else FIRST_NS)


class Adopts(Protocol):
    """What a guard needs of its driver before the loop: `drivers.dynamixel.standby.StandbyDriver` is one."""

    resumed: bool  # the arm had stopped by itself, and has obeyed again since `adopt`: its torque is zero
    limp: bool  # it had stopped by itself, or does not answer, and `adopt` was not to bring it back

    def adopt(self, last: JointState | None, *, brings_back: bool) -> Vector:
        """Take the arm over as it is; the joint torques (n,) that it holds.

        last: the last fresh state that the agent had; None where there is none.
        brings_back: an arm that has stopped by itself shall obey again.
        """
        ...


def clock_of(rows: Rows) -> MonotonicClock:
    """A clock with the time of the run that these rows (k,) are of; with this host's where there are none."""
    return MonotonicClock(int(rows[-1]["utc_ns"] - rows[-1]["stamp_ns"]) if len(rows) else None)


def go_on(
    agent: Agent,
    driver: Adopts,
    clock: Clock,
    rows: Rows,
    schedule: Schedule,
    reason: str,
    *,
    session: bool = False,
) -> Beginning:
    """Where the loop begins; rows: the last ones of the agent, which is dead.  Raises what `adopt` does.

    session: the agent had one.  A guard that comes too late, as one that was stopped itself, finds an arm that was limp
    for as long as a loop does not bring one back after: it begins in FAULT.  So does a limp arm of which no row is
    fresh: its agent may have rejected what an encoder said, and nobody could tell where the joints are.
    """
    away_ns, period_ns = clock.now_ns() - int(rows[-1]["stamp_ns"]) if len(rows) else 0, schedule.period_ns
    in_time = away_ns <= schedule.patience.lost * period_ns
    seen = last_seen(rows, agent.model.n)
    blind = seen is None and bool(len(rows))
    held = driver.adopt(seen, brings_back=in_time and not blind)
    marks = Flag.RESUMED if driver.resumed else Flag.NONE
    if away_ns > GAP_PERIODS * period_ns:
        marks |= Flag.GAP
    begun = from_torque(beginning(agent, rows, reason, marks, session=session), rows, held)
    if not driver.limp:
        return begun
    since = "it had not seen the arm" if blind else f"nobody commanded the arm for {away_ns * 1e-9:.1f} s"
    return replace(begun, mode=Mode.FAULT, reason=f"{reason}, and {since}: its servos have let go")
