"""The control loop of one arm: wait, read, step, write, log, on an open driver and a clock that are given to it.

Deadlines are absolute: a late cycle keeps the phase of the trajectory, and cycles that were missed are left out.  An
arm that nobody sees gets the torque of its weight and load share, then none, so that its servos' watchdogs stop it;
which mode follows what happened is for `agent.modes`, how long what may last for `agent.cycles`.
"""

from __future__ import annotations

import numpy as np

from agent import floats
from agent.around import Beginning, LoopLog, RunSummary, Schedule, Surroundings
from agent.control.memory import Memory
from agent.cycles import WINDOW, Bus, Cycles
from agent.loop import Agent, Outcome, blind, explained, initial_memory, step
from agent.modes import TABLE, Event, Mode, next_mode
from agent.monitors.watch import Watch
from agent.safety import Flag
from agent.session import SessionLoop
from agent.session_modes import next_in_session
from agent.sight import KEEPS, Sight
from agent.standing import afresh, wait_here
from agent.telemetry.row.fill import AgentRow
from agent.telling import Telling
from agent.ticks import Ticks
from agent.transition import entered
from drivers.interface import Clock, Driver, DriverError, JointState, Vector

TROUBLE = Flag.NOT_FINITE | Flag.SINGULAR | Flag.OFF_TRACK | Flag.UNEXPECTED  # for which an arm holds
_TROUBLE = int(TROUBLE)  # asking a flag for another one takes 0.5 µs
_COMMANDING = frozenset(mode for mode, entry in TABLE.items() if entry.commands)


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
        watch: Watch | None = None,
        beginning: Beginning | None = None,
        session: SessionLoop | None = None,
    ) -> None:
        """beginning: None for a loop that is the arm's first; session: of one that begins at its rest, as its agent."""
        self._session = session
        self._agent = agent
        self._driver = driver
        self._clock = clock
        self._schedule = schedule
        self._row = row
        self._sink = sink
        self._around = around
        self._telling = Telling(around, in_session=session is not None)
        self._watch = watch
        self._memory: Memory = initial_memory(agent)
        self._outcome: Outcome | None = None  # of the last tick with a fresh state
        self._mode = Mode.OFF
        self._reason, self._untaken = "", ""  # of a hold or a fault; of a torque that the bus did not take
        self._rows, self._late_cycles, self._stale_cycles = 0, 0, 0
        self._marks = Flag.NONE  # of the next row
        begin_ns = clock.now_ns()
        self._ticks = Ticks(schedule, begin_ns)
        self._cycles = Cycles(schedule.patience, schedule.period_ns, begin_ns)
        self._sight = Sight(driver, self._cycles, self._resumed, around.busy, lockstep=schedule.lockstep)
        self._utc_offset_ns = clock.utc_offset_ns
        self._tracking_since_ns: int | None = None
        self._tracked_s = 0.0
        if beginning is not None:
            self._mode, self._memory, self._ticks.zero_ns = beginning.mode, beginning.memory, beginning.zero_ns
            self._rows, self._reason, self._marks = beginning.rows, beginning.reason, beginning.marks

    @property
    def memory(self) -> Memory:
        """What the next tick begins with."""
        return self._memory

    def run(self, happened: Event = Event.ENABLED) -> RunSummary:
        """Run until the last tick, a release or a fault; leaves the torque as it is.

        happened: what brought the arm here, which says in what mode it begins.
        """
        self._mode = self._next(happened)
        if self._schedule.lockstep and not self._schedule.ready_ns:
            self._mode = next_mode(self._mode, Event.STARTED)
            self._around.mode_changed(self._mode)
        while self._mode in _COMMANDING and not self._ticks.over():
            deadline_ns = self._ticks.deadline_ns
            self._clock.sleep_until(deadline_ns)
            self._cycle(deadline_ns)
        return RunSummary(
            ticks=self._rows, late_cycles=self._late_cycles, stale_cycles=self._stale_cycles,
            mode=self._mode, reason=self._reason or self._untaken, tracked_s=self._tracked_s, lost=self._sight.lost,
        )  # fmt: skip

    def _cycle(self, deadline_ns: int) -> None:
        schedule, period_ns, cycles = self._schedule, self._schedule.period_ns, self._cycles
        late_ns = 0
        if schedule.lockstep:
            self._sink.wait_for_space()
        else:
            late_ns = self._clock.now_ns() - deadline_ns
            gap_s = cycles.gap_s(deadline_ns + late_ns)
            if gap_s:
                self._pass_gap(gap_s)
        begin_ns = self._around.wall_ns()
        happened = self._around.operator()
        bus = Bus.READ if schedule.lockstep else self._sight.plan(deadline_ns, self._mode)
        state = None
        if bus is Bus.READ:
            state, trouble = self._sight.read(self._mode)
            if trouble:
                happened |= trouble
                self._learn(trouble, seen=state is not None)
        if state is not None:
            cycles.fresh(deadline_ns)
            if self._outcome is None:
                cycles.first(self._clock.now_ns())
            found = self._act(state, late_ns, begin_ns)
        else:
            found = self._go_blind(deadline_ns, bus, late_ns, begin_ns)
        happened = happened | found if found else happened  # combining takes 1 µs, and mostly there is nothing
        self._around.heartbeat()
        if schedule.hold_at_end and self._mode is Mode.TRACK and self._ticks.past_end(deadline_ns + period_ns):
            happened |= Event.STOP
        if self._mode is Mode.READY and self._started(deadline_ns):
            happened |= Event.STARTED
        self._late_cycles += (late := late_ns > period_ns)
        self._ticks.deadline_ns += period_ns
        if not schedule.lockstep:
            happened |= self._skip(deadline_ns, good=state is not None and not late)
        if self._session is not None:
            happened = self._judged(self._session, happened, cycles.without_state(deadline_ns))
        if happened:
            self._change_mode(happened, state)

    def _learn(self, trouble: Event, *, seen: bool) -> None:
        """A servo says what is wrong; an arm that stands because of it already tells the cause."""
        before, self._reason = self._reason, self._sight.why(self._reason)
        if self._reason != before and self._mode in KEEPS and Event.SERVO_LOST not in trouble:
            self._telling.stands(self._mode, self._reason, seen=seen)

    def _judged(self, session: SessionLoop, happened: Event, without_state: int) -> Event:
        """What counts of what happened, with what the arm found out by itself; a refused word is told."""
        seen = without_state <= self._schedule.patience.hold
        judged = session.judge(self._mode, happened, self._memory, seen=seen)
        said, session.reason = session.reason, ""
        if said and judged & ~happened & (Event.TROUBLE | Event.STOP):
            self._reason = said
        elif said:
            self._telling.refused(said)
        return judged

    def _next(self, happened: Event) -> Mode:
        if self._session is not None:
            return next_in_session(self._mode, happened)
        return (next_mode if self._agent.floating is None else floats.following)(self._mode, happened)

    def _skip(self, deadline_ns: int, *, good: bool) -> Event:
        """Leave out the cycles that this one took the time of; trouble once too few are good."""
        skipped = max(0, (self._clock.now_ns() - deadline_ns) // self._schedule.period_ns)
        self._ticks.deadline_ns += skipped * self._schedule.period_ns
        share = self._cycles.end(skipped, good=good)
        if share is None:
            return Event.NONE
        self._reason = self._reason or f"{share:.0%} of the last {WINDOW} cycles brought a state in time"
        return Event.TROUBLE

    def _pass_gap(self, gap_s: float) -> None:
        """Time was lost before this cycle: hold before any torque goes out, at the pose that this cycle finds."""
        before = self._mode
        self._sight.unseen = f"no cycle for {gap_s:.3f} s"  # the cause, where the arm is found lost after it
        self._reason = self._reason or self._sight.unseen
        self._change_mode(Event.TROUBLE, None)
        if self._mode is not before:
            self._begin_afresh(Flag.GAP)

    def _resumed(self) -> None:
        self._begin_afresh(Flag.RESUMED)
        self._reason = self._telling.resumed(self._mode, self._reason)

    def _begin_afresh(self, mark: Flag) -> None:
        self._marks |= mark
        self._memory = afresh(self._memory, mark)

    def _act(self, state: JointState, late_ns: int, begin_ns: int) -> Event:
        """One step on a fresh state: torque out, row in the log."""
        row, wall_ns, mode = self._row, self._around.wall_ns, self._mode
        if mode is not Mode.TRACK and self._memory.hold is None:
            self._memory = wait_here(self._agent, state.q, self._memory, mode)
        after_read_ns = wall_ns()
        t = (state.stamp_ns - self._ticks.zero_ns) * 1e-9
        outcome = step(self._agent, state, t, mode, self._memory)
        after_step_ns = wall_ns()
        tau_sent = self._send(outcome.tau)
        after_write_ns = wall_ns()
        utc_ns = self._utc_offset_ns + state.stamp_ns
        if self._marks:
            outcome, self._marks = outcome._replace(flags=outcome.flags | self._marks), Flag.NONE
        row.fill(self._rows, t, utc_ns, mode, state, self._memory, outcome, tau_sent)
        row.fill_timing(
            late_ns * 1e-9, (after_read_ns - begin_ns) * 1e-9, (after_step_ns - after_read_ns) * 1e-9,
            (after_write_ns - after_step_ns) * 1e-9, self._driver.counters,
        )  # fmt: skip
        self._sink.commit()
        self._memory, self._outcome = outcome.memory, outcome
        self._rows += 1
        if mode is Mode.TRACK:
            if self._tracking_since_ns is None:
                self._tracking_since_ns = after_read_ns  # in lockstep the first read waits for the other arms
            self._tracked_s = (after_write_ns - self._tracking_since_ns) * 1e-9
        found = "" if self._watch is None else self._watch.after(state, outcome, mode, self._driver.health)
        if int(outcome.flags) & _TROUBLE:
            found = self._reason or f"{outcome.flags.name} {explained(self._agent, outcome)}".rstrip()
        if not found:
            return Event.NONE
        self._reason = self._reason or self._ticks.told(t) + found
        return Event.TROUBLE

    def _send(self, tau: Vector) -> Vector:
        """Write torques; NaN where the bus did not take them, which the next read tells more about."""
        try:
            return self._driver.write(tau)
        except DriverError as error:
            if self._schedule.lockstep:
                raise
            self._untaken = str(error)
            return np.full_like(tau, np.nan)

    def _go_blind(self, deadline_ns: int, bus: Bus, late_ns: int, begin_ns: int) -> Event:
        """A cycle without a state: the last torque, then the weight's, then none; and a row that says so."""
        patience, lost, wall_ns = self._schedule.patience, self._cycles.without_state(deadline_ns), self._around.wall_ns
        read_s = (wall_ns() - begin_ns) * 1e-9 if bus is Bus.READ else np.nan  # until it failed
        memory, nothing = self._memory, np.full(self._agent.model.n, np.nan)
        outcome = Outcome(nothing, nothing, None, memory.tau, Flag.STALE, memory)
        if lost > patience.repeat and not self._schedule.lockstep:
            outcome = blind(self._agent, self._mode, memory)
        tau_sent, write_s = nothing, np.nan
        self._stale_cycles += 1
        if bus is Bus.READ and not self._schedule.lockstep:
            before_ns = wall_ns()
            tau_sent = self._send(outcome.tau)
            write_s = (wall_ns() - before_ns) * 1e-9
        if self._marks:
            outcome, self._marks = outcome._replace(flags=outcome.flags | self._marks), Flag.NONE
        t, utc_ns = (deadline_ns - self._ticks.zero_ns) * 1e-9, self._utc_offset_ns + deadline_ns
        state = JointState(deadline_ns, nothing, nothing, nothing)
        self._row.fill(self._rows, t, utc_ns, self._mode, state, memory, outcome, tau_sent)
        self._row.fill_timing(late_ns * 1e-9, read_s, np.nan, write_s, self._driver.counters)
        self._sink.commit()
        self._rows += 1
        self._memory = outcome.memory
        if bus is Bus.GIVE_UP:
            return Event.SERVO_LOST
        if lost <= patience.hold:
            return Event.NONE
        self._reason = self._reason or self._sight.blamed()
        return Event.TROUBLE

    def _started(self, deadline_ns: int) -> bool:
        """Whether the next tick belongs to the trajectory; takes over the common start once it is known (READY)."""
        session, ticks = self._session, self._ticks
        if session is not None and not session.taken_up(self._mode, self._memory):
            return False
        zero_ns = self._around.start_ns()
        if zero_ns is None:
            ticks.take_back(deadline_ns)
        elif zero_ns != ticks.zero_ns and (session is None or session.counts(zero_ns, deadline_ns)):
            ticks.start(zero_ns)
        return ticks.starts_next()

    def _change_mode(self, happened: Event, state: JointState | None) -> None:
        before = self._mode
        mode = self._next(happened)
        if Event.SERVO_LOST in happened:
            self._reason = self._sight.unseen or self._reason
        elif Event.TROUBLE in happened:
            self._reason = self._reason or self._around.of_host()
        if mode is before:
            if mode is Mode.REST and Event.TROUBLE in happened:
                self._telling.at_rest(self._reason)
            return
        if self._session is not None:
            self._session.entered(mode)
            if mode is Mode.READY:  # what was started before is over
                self._session.await_start(self._around.start_ns())
                self._ticks.await_start(self._clock.now_ns())
        self._memory = entered(self._agent, mode, self._memory, self._outcome if state is not None else None)
        self._mode = mode
        self._around.mode_changed(mode)
        if self._session is not None and mode not in KEEPS and mode in _COMMANDING:
            self._reason = self._untaken = ""  # of a hold that is over
        if mode in KEEPS and Event.TROUBLE in happened:
            self._telling.stands(mode, self._reason, seen=state is not None)
