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
from agent.modes import FLOATING, TABLE, Event, Mode, next_mode
from agent.monitors.watch import Watch
from agent.safety import Flag
from agent.session import WAY_BACK, SessionLoop, entered, way_back
from agent.session_modes import next_in_session
from agent.standing import afresh, hold_after, wait_here
from agent.telemetry.row.fill import AgentRow
from drivers.interface import (
    Clock,
    Driver,
    DriverError,
    JointState,
    Recovering,
    ServoFault,
    StaleStateError,
    Vector,
)

__all__ = ["Beginning", "LoopLog", "RunSummary", "Runner", "Schedule", "Surroundings"]

NOT_YET_NS = 86_400_000_000_000  # the trajectory's zero while nobody has set it: a day ahead
_TROUBLE = int(Flag.NOT_FINITE | Flag.SINGULAR | Flag.OFF_TRACK | Flag.UNEXPECTED)  # joining flags takes 1 µs
_KEEPS = frozenset({Mode.HOLD, Mode.HALT, Mode.STAND})  # in which an arm stays until somebody says a word
_COMMANDING = frozenset(mode for mode, entry in TABLE.items() if entry.commands)


class Runner:
    """The loop of one arm on an enabled driver.

    beginning: None for a loop that is the arm's first.
    """

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
        """session: of an arm that begins at its rest, and whose agent has one too."""
        self._session = session
        self._agent = agent
        self._driver = driver
        self._clock = clock
        self._schedule = schedule
        self._row = row
        self._sink = sink
        self._around = around
        self._watch = watch
        self._memory: Memory = initial_memory(agent)
        self._outcome: Outcome | None = None  # of the last tick with a fresh state
        self._mode = Mode.OFF
        self._reason = ""
        self._rows = 0
        self._late_cycles = 0
        self._stale_cycles = 0
        self._unseen = ""  # why the last read brought no state
        self._fault = ""  # of the servos, as last read
        self._marks = Flag.NONE  # of the next row
        self._tick = 0  # of the period since the phase
        self._phase_ns = clock.now_ns()  # instant of tick 0
        self._cycles = Cycles(schedule.patience, schedule.period_ns, self._phase_ns)
        self._recovering = driver if isinstance(driver, Recovering) else None
        self._utc_offset_ns = clock.utc_offset_ns
        self._zero_ns = self._phase_ns + (schedule.ready_ns if schedule.lockstep else NOT_YET_NS)
        self._told_at_rest = ""
        self._tracking_since_ns: int | None = None
        self._tracked_s = 0.0
        if beginning is not None:
            self._mode, self._memory, self._zero_ns = beginning.mode, beginning.memory, beginning.zero_ns
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
        while self._mode in _COMMANDING and not self._over():
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
        bus = Bus.READ if schedule.lockstep else self._bus(deadline_ns)
        state = None
        if bus is Bus.READ:
            state, trouble = self._read()
            happened |= trouble
        if state is not None:
            cycles.fresh(deadline_ns)
            if self._outcome is None:
                cycles.first(self._clock.now_ns())
            happened |= self._act(state, late_ns, begin_ns)
        else:
            happened |= self._go_blind(deadline_ns, bus)
        self._around.heartbeat()
        if schedule.hold_at_end and self._tracks_to_end() and self._past_end(deadline_ns + period_ns):
            happened |= Event.STOP
        if self._mode is Mode.READY and self._may_start() and self._started(deadline_ns):
            happened |= Event.STARTED
        late = late_ns > period_ns
        self._late_cycles += late
        self._tick += 1
        if not schedule.lockstep:
            happened |= self._skip(deadline_ns, good=state is not None and not late)
        if self._session is not None:
            seen = cycles.without_state(deadline_ns) <= schedule.patience.hold
            happened = self._judged(self._session, happened, seen=seen)
        if happened:
            self._change_mode(happened, state)

    def _tracks_to_end(self) -> bool:
        return self._session is None or self._mode is Mode.TRACK

    def _may_start(self) -> bool:
        return self._session is None or self._session.taken_up(self._mode, self._memory)

    def _judged(self, session: SessionLoop, happened: Event, *, seen: bool) -> Event:
        """What counts of what happened, with what the arm found out by itself; a refused word is told."""
        happened = session.judge(self._mode, happened, self._memory, seen=seen)
        said, session.reason = session.reason, ""
        if said and happened & (Event.TROUBLE | Event.STOP):
            self._reason = said
        elif said and self._around.refused is not None:
            self._around.refused(said)
        return happened

    def _next(self, happened: Event) -> Mode:
        if self._session is None:
            return next_mode(self._mode, happened)
        return next_in_session(self._mode, happened)

    def _skip(self, deadline_ns: int, *, good: bool) -> Event:
        """Leave out the cycles that this one took the time of; trouble once too few are good."""
        skipped = max(0, (self._clock.now_ns() - deadline_ns) // self._schedule.period_ns)
        self._tick += skipped
        share = self._cycles.end(skipped, good=good)
        if share is None:
            return Event.NONE
        self._reason = self._reason or f"{share:.0%} of the last {WINDOW} cycles brought a state in time"
        return Event.TROUBLE

    def _pass_gap(self, gap_s: float) -> None:
        """Time was lost before this cycle: hold before any torque goes out, at the pose that this cycle finds."""
        before = self._mode
        self._reason = self._reason or f"no cycle for {gap_s:.3f} s"
        self._change_mode(Event.TROUBLE, None)
        if self._mode is not before:
            self._begin_afresh(Flag.GAP)

    def _begin_afresh(self, mark: Flag) -> None:
        self._marks |= mark
        self._memory = afresh(self._memory, mark)

    def _bus(self, deadline_ns: int) -> Bus:
        """What this cycle does on the bus; an arm that lapsed is brought back in HOLD, and by its driver."""
        arm = self._recovering
        lapsed = arm is not None and self._mode in _KEEPS and arm.lapsed
        bus = self._cycles.plan(deadline_ns, lapsed=lapsed, recovers=arm is not None)
        if bus is not Bus.RECOVER or arm is None:
            return bus
        try:
            resumed, back = arm.recover(), True
        except DriverError as error:
            self._unseen, resumed, back = str(error), False, False
        self._cycles.tried(deadline_ns, back=back)
        if resumed:
            self._begin_afresh(Flag.RESUMED)
        return Bus.READ if back else Bus.QUIET

    def _read(self) -> tuple[JointState | None, Event]:
        """Fresh state or None, and whether anything is wrong with the arm."""
        try:
            return self._driver.read(), Event.NONE
        except StaleStateError as error:
            self._unseen = str(error)
            return None, Event.SERVO_LOST if self._schedule.lockstep else Event.NONE
        except ServoFault as error:
            self._unseen = str(error)
            state = error.state
            if state is None:
                return None, Event.SERVO_LOST
            self._reason = self._reason or self._unseen
            seen = bool(np.isfinite(state.q).all() and np.isfinite(state.dq).all())
            return state if seen else None, self._trouble_of(self._unseen)

    def _trouble_of(self, fault: str) -> Event:
        """What a servo's fault, which lasts, asks for: on the way back of a session the one of before asks no more."""
        borne = self._session is not None and self._mode in WAY_BACK and fault == self._fault
        self._fault = fault
        return Event.NONE if borne else Event.TROUBLE

    def _act(self, state: JointState, late_ns: int, begin_ns: int) -> Event:
        """One step on a fresh state: torque out, row in the log."""
        row, wall_ns, mode = self._row, self._around.wall_ns, self._mode
        if mode is not Mode.TRACK and self._memory.hold is None:
            self._memory = wait_here(self._agent, state.q, self._memory, mode)
        after_read_ns = wall_ns()
        t = (state.stamp_ns - self._zero_ns) * 1e-9
        outcome = step(self._agent, state, t, mode, self._memory)
        after_step_ns = wall_ns()
        tau_sent = self._send(outcome.tau)
        after_write_ns = wall_ns()
        utc_ns = self._utc_offset_ns + state.stamp_ns
        if self._marks:
            outcome, self._marks = outcome._replace(flags=outcome.flags | self._marks), Flag.NONE
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
        found = ""
        if self._watch is not None:
            found = self._watch.after(state, outcome, mode, self._driver.health)
        if int(outcome.flags) & _TROUBLE:
            self._reason = (
                self._reason or f"t = {t:.3f} s: {outcome.flags!r} {explained(self._agent, outcome)}".rstrip()
            )
            return Event.TROUBLE
        if found:
            self._reason = self._reason or f"t = {t:.3f} s: {found}"
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

    def _go_blind(self, deadline_ns: int, bus: Bus) -> Event:
        """A cycle without a state: the last torque, then the weight's, then none; and a row that says so."""
        patience, lost = self._schedule.patience, self._cycles.without_state(deadline_ns)
        memory, n = self._memory, self._agent.model.n
        nothing = np.full(n, np.nan)
        outcome = Outcome(nothing, nothing, None, memory.tau, Flag.STALE, memory)
        if lost > patience.repeat and not self._schedule.lockstep:
            outcome = blind(self._agent, memory)
        tau_sent = nothing
        self._stale_cycles += 1
        if bus is Bus.READ and not self._schedule.lockstep:
            tau_sent = self._send(outcome.tau)
        if self._marks:
            outcome, self._marks = outcome._replace(flags=outcome.flags | self._marks), Flag.NONE
        t = (deadline_ns - self._zero_ns) * 1e-9
        state = JointState(deadline_ns, nothing, nothing, nothing)
        utc_ns = self._utc_offset_ns + deadline_ns
        self._row.fill(self._rows, t, utc_ns, self._mode, state, memory, outcome, tau_sent)
        self._sink.commit()
        self._rows += 1
        self._memory = outcome.memory
        if bus is Bus.GIVE_UP:
            return Event.SERVO_LOST
        if lost <= patience.hold:
            return Event.NONE
        self._reason = self._reason or self._unseen
        return Event.TROUBLE

    def _started(self, deadline_ns: int) -> bool:
        """Whether the next tick belongs to the trajectory; takes over the common start once it is known (READY)."""
        zero_ns = self._around.start_ns()
        session = self._session
        counts = zero_ns != self._zero_ns and (session is None or session.counts(zero_ns, deadline_ns))
        if zero_ns is not None and counts:
            self._zero_ns = zero_ns
            self._phase_ns = zero_ns - (zero_ns - deadline_ns) // self._schedule.period_ns * self._schedule.period_ns
            self._tick = 0
        return self._phase_ns + (self._tick + 1) * self._schedule.period_ns >= self._zero_ns

    def _tell_at_rest(self, happened: Event) -> None:
        """What is wrong with an arm that rests, once: nothing else comes of it."""
        if self._mode is Mode.REST and Event.TROUBLE in happened and self._reason != self._told_at_rest:
            self._told_at_rest = self._reason
            if self._around.trouble is not None:
                self._around.trouble(way_back(Mode.REST, self._reason))

    def _change_mode(self, happened: Event, state: JointState | None) -> None:
        before = self._mode
        mode = self._next(happened)
        if Event.SERVO_LOST in happened:
            self._reason = self._unseen or self._reason
        if mode is before:
            self._tell_at_rest(happened)
            return
        if self._session is not None:
            self._session.entered(mode)
            if mode is Mode.READY:  # what was started before is over
                self._session.await_start(self._around.start_ns())
                self._zero_ns = self._clock.now_ns() + NOT_YET_NS
        if self._agent.floating is not None and mode in FLOATING:
            last = self._outcome if state is not None else None
            seen = None if last is None else (last.q, last.dq)
            self._memory = floats.entered(self._agent.floating, mode, self._memory, seen)
        elif self._agent.session is not None:
            self._memory = entered(self._agent, mode, self._memory, self._outcome if state is not None else None)
        elif mode is Mode.HOLD and state is not None and self._outcome is not None:
            self._memory = hold_after(self._agent, self._outcome)
        elif mode is Mode.TRACK:
            self._memory = self._memory._replace(hold=None, q_hold=None)
        self._mode = mode
        self._around.mode_changed(mode)
        if self._session is not None and mode not in _KEEPS and mode in _COMMANDING:
            self._reason = ""  # of a hold that is over
        if mode in _KEEPS and Event.TROUBLE in happened and self._around.trouble is not None:
            back = self._session is not None
            said = way_back(mode, self._reason, seen=state is not None) if back else self._reason
            self._around.trouble(said)
