"""The control loop of one arm: wait, read, step, write, log, on an open driver and a clock that are given to it.

Deadlines are absolute: a late cycle keeps the phase of the trajectory, and cycles that were missed are left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from agent.control.memory import Memory
from agent.loop import Agent, Outcome, entered, explained, hold_after, initial_memory, step, wait_here
from agent.modes import Event, Mode, next_mode
from agent.safety import Flag
from agent.session import SessionLoop
from agent.session_modes import next_in_session
from agent.telemetry.row.fill import AgentRow
from drivers.interface import Clock, Driver, DriverError, JointState, ServoFault, StaleStateError, Vector

NOT_YET_NS = 86_400_000_000_000  # the trajectory's zero while nobody has set it: a day ahead
_TROUBLE = int(Flag.NOT_FINITE | Flag.SINGULAR | Flag.OFF_TRACK | Flag.UNEXPECTED)  # joining flags takes 1 µs
_IDLE = frozenset({Mode.OFF, Mode.FAULT})


class LoopLog(Protocol):
    """Where rows go; the control thread only ever fills and commits."""

    def commit(self) -> None:
        """Make the filled row visible to readers; never blocks."""
        ...

    def wait_for_space(self) -> None:
        """Lockstep simulation only: let time wait for the reader, so that nothing is lost."""
        ...


@dataclass(frozen=True)
class Schedule:
    """When the ticks are."""

    period_ns: int
    ticks: int  # of the trajectory, from its zero on
    lockstep: bool  # simulated time: the trajectory's zero is ready_ns after the first tick
    hold_after_stale: int  # cycles in a row without a fresh state, after which the object is held
    fault_after_stale: int  # and after which the arm is given up: its servos' own watchdog has fired by then
    hold_at_end: bool  # after the last tick hold the object until an operator releases it (real arms)
    ready_ns: int = 0  # lockstep: how long the arm waits for the common start


@dataclass(frozen=True)
class Surroundings:
    """What the loop asks of the process around it; no call may block."""

    wall_ns: Callable[[], int]  # measures durations for the log and nothing else
    operator: Callable[[], Event]  # requests of an operator
    start_ns: Callable[[], int | None]  # the trajectory's zero on the driver's clock, once somebody has set it
    heartbeat: Callable[[], None]  # after every cycle with a fresh state
    mode_changed: Callable[[Mode], None]
    trouble: Callable[[str], None] | None = None  # is told why the arm holds when nobody asked it to


@dataclass(frozen=True)
class RunSummary:
    """What `Runner.run` did."""

    ticks: int
    late_cycles: int
    stale_cycles: int
    mode: Mode  # in which it ended
    reason: str  # of a hold or a fault, empty without one
    tracked_s: float  # of the wall clock, from the first to the last tick of the trajectory


class Runner:
    """The loop of one arm on an enabled driver."""

    def __init__(
        self,
        agent: Agent,
        driver: Driver,
        clock: Clock,
        schedule: Schedule,
        row: AgentRow,
        sink: LoopLog,
        around: Surroundings,
        session: SessionLoop | None = None,
    ) -> None:
        """session: of an arm that begins at its rest, and whose agent has one too."""
        self._agent = agent
        self._session = session
        self._driver = driver
        self._clock = clock
        self._schedule = schedule
        self._row = row
        self._sink = sink
        self._around = around
        self._memory: Memory = initial_memory(agent)
        self._outcome: Outcome | None = None  # of the last tick with a fresh state
        self._mode = Mode.TRACK if schedule.lockstep and not schedule.ready_ns else Mode.READY
        if session is not None:
            self._mode = Mode.REST
        self._reason = ""
        self._rows = 0
        self._late_cycles = 0
        self._stale_cycles = 0
        self._stale_in_a_row = 0
        self._tick = 0  # of the period since the phase
        self._phase_ns = clock.now_ns()  # instant of tick 0
        self._utc_offset_ns = clock.utc_offset_ns
        self._zero_ns = self._phase_ns + (schedule.ready_ns if schedule.lockstep else NOT_YET_NS)
        self._tracking_since_ns: int | None = None
        self._tracked_s = 0.0

    def run(self) -> RunSummary:
        """Run until the last tick, a release or a fault; leaves the torque as it is."""
        while self._mode not in _IDLE and not self._over():
            deadline_ns = self._phase_ns + self._tick * self._schedule.period_ns
            self._clock.sleep_until(deadline_ns)
            self._cycle(deadline_ns)
        return RunSummary(
            ticks=self._rows,
            late_cycles=self._late_cycles,
            stale_cycles=self._stale_cycles,
            mode=self._mode,
            reason=self._reason,
            tracked_s=self._tracked_s,
        )

    def _over(self) -> bool:
        return not self._schedule.hold_at_end and self._past_end(self._phase_ns + self._tick * self._schedule.period_ns)

    def _past_end(self, instant_ns: int) -> bool:
        return instant_ns - self._zero_ns >= self._schedule.ticks * self._schedule.period_ns

    def _cycle(self, deadline_ns: int) -> None:
        schedule, period_ns = self._schedule, self._schedule.period_ns
        late_ns = 0
        if schedule.lockstep:
            self._sink.wait_for_space()
        else:
            late_ns = self._clock.now_ns() - deadline_ns
        begin_ns = self._around.wall_ns()
        happened = self._around.operator()
        state, trouble = self._read()
        if trouble:
            happened |= Event.TROUBLE
            self._reason = self._reason or trouble
        if state is not None:
            happened |= self._act(state, late_ns, begin_ns)
            self._around.heartbeat()
        else:
            self._note_lost_state(deadline_ns)
        if schedule.hold_at_end and self._tracks_to_end() and self._past_end(deadline_ns + period_ns):
            happened |= Event.STOP
        if self._mode is Mode.READY and self._may_start() and self._started(deadline_ns):
            happened |= Event.STARTED
        if self._session is not None:
            happened = self._judged(self._session, happened)
        if happened:
            self._change_mode(happened, state)
        self._late_cycles += late_ns > period_ns
        self._tick += 1
        if not schedule.lockstep:
            self._tick += max(0, (self._clock.now_ns() - deadline_ns) // period_ns)

    def _read(self) -> tuple[JointState | None, str]:
        """Fresh state or None, and what is wrong with the arm or nothing.  A lost state keeps the last torque."""
        try:
            state = self._driver.read()
        except StaleStateError as error:
            self._stale_cycles += 1
            self._stale_in_a_row += 1
            if self._schedule.lockstep or self._stale_in_a_row > self._schedule.fault_after_stale:
                self._mode, self._reason = Mode.FAULT, str(error)
                return None, str(error)
            self._send(self._memory.tau)
            return None, str(error) if self._stale_in_a_row > self._schedule.hold_after_stale else ""
        except ServoFault as error:
            self._stale_in_a_row = 0
            if error.state is None:
                self._mode, self._reason = Mode.FAULT, str(error)
            return error.state, str(error)
        self._stale_in_a_row = 0
        return state, ""

    def _act(self, state: JointState, late_ns: int, begin_ns: int) -> Event:
        """One step on a fresh state: torque out, row in the log."""
        row, wall_ns, mode = self._row, self._around.wall_ns, self._mode
        if mode is not Mode.TRACK and self._memory.hold is None:
            self._memory = wait_here(self._agent, state.q, self._memory)
        after_read_ns = wall_ns()
        t = (state.stamp_ns - self._zero_ns) * 1e-9
        outcome = step(self._agent, state, t, mode, self._memory)
        after_step_ns = wall_ns()
        tau_sent = self._send(outcome.tau)
        after_write_ns = wall_ns()
        utc_ns = self._utc_offset_ns + state.stamp_ns
        row.fill(self._rows, t, utc_ns, mode, state, self._memory, outcome, tau_sent)
        row.fill_timing(
            late_ns * 1e-9,
            (after_read_ns - begin_ns) * 1e-9,
            (after_step_ns - after_read_ns) * 1e-9,
            (after_write_ns - after_step_ns) * 1e-9,
            self._driver.counters,
        )
        self._sink.commit()
        self._memory = outcome.memory
        self._outcome = outcome
        self._rows += 1
        if mode is Mode.TRACK:
            if self._tracking_since_ns is None:
                self._tracking_since_ns = begin_ns
            self._tracked_s = (after_write_ns - self._tracking_since_ns) * 1e-9
        if int(outcome.flags) & _TROUBLE:
            self._reason = (
                self._reason or f"t = {t:.3f} s: {outcome.flags!r} {explained(self._agent, outcome)}".rstrip()
            )
            return Event.TROUBLE
        return Event.NONE

    def _send(self, tau: Vector) -> Vector:
        """Write torques; NaN where the bus did not take them, which the next read tells more about."""
        try:
            return self._driver.write(tau)
        except DriverError as error:
            if self._schedule.lockstep:
                raise
            self._reason = self._reason or str(error)
            return np.full_like(tau, np.nan)

    def _note_lost_state(self, deadline_ns: int) -> None:
        """A row that says that this cycle had no fresh state."""
        memory, row, mode = self._memory, self._row, self._mode
        nothing = np.full(self._agent.model.n, np.nan)
        t = (deadline_ns - self._zero_ns) * 1e-9
        lost = JointState(deadline_ns, nothing, nothing, nothing)
        outcome = Outcome(nothing, nothing, None, memory.tau, Flag.STALE, memory)
        utc_ns = self._utc_offset_ns + deadline_ns
        row.fill(self._rows, t, utc_ns, mode, lost, memory, outcome, memory.tau)
        self._sink.commit()
        self._rows += 1

    def _started(self, deadline_ns: int) -> bool:
        """Whether the next tick belongs to the trajectory; takes over the common start once it is known (READY)."""
        zero_ns = self._around.start_ns()
        if zero_ns is not None and zero_ns != self._zero_ns:
            self._zero_ns = zero_ns
            self._phase_ns = zero_ns - (zero_ns - deadline_ns) // self._schedule.period_ns * self._schedule.period_ns
            self._tick = 0
        return self._phase_ns + (self._tick + 1) * self._schedule.period_ns >= self._zero_ns

    def _tracks_to_end(self) -> bool:
        return self._session is None or self._mode is Mode.TRACK

    def _may_start(self) -> bool:
        return self._session is None or self._session.taken_up(self._mode, self._memory)

    def _judged(self, session: SessionLoop, happened: Event) -> Event:
        """What counts of what happened, with what the arm found out by itself; a refused word is told."""
        happened = session.judge(self._mode, happened, self._memory)
        said, session.reason = session.reason, ""
        if said and happened & (Event.TROUBLE | Event.STOP):
            self._reason = said
        elif said and self._around.trouble is not None:
            self._around.trouble(said)
        return happened

    def _change_mode(self, happened: Event, state: JointState | None) -> None:
        before = self._mode
        mode = next_mode(before, happened) if self._session is None else next_in_session(before, happened)
        if mode is before:
            return
        if self._session is not None:
            self._session.entered(mode)
        if self._agent.session is not None:
            self._memory = entered(self._agent, mode, self._memory, self._outcome if state is not None else None)
        elif mode is Mode.HOLD and state is not None and self._outcome is not None:
            self._memory = hold_after(self._agent, self._outcome)
        elif mode is Mode.TRACK:
            self._memory = self._memory._replace(hold=None, q_hold=None)
        self._mode = mode
        self._around.mode_changed(mode)
        if mode in (Mode.HOLD, Mode.HALT) and Event.TROUBLE in happened and self._around.trouble is not None:
            self._around.trouble(self._reason)
