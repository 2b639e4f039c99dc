"""The control loop of one arm.  `step` is pure; `run` reads, steps, limits, writes, logs and sleeps.

Nothing here opens anything, knows the wall clock, or learns anything from another agent.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from agent.control import adaptive, known
from agent.control.adaptation import Estimate
from agent.control.estimator import Observer
from agent.control.inverse import SingularJacobian
from agent.control.law import Offline, Terms
from agent.control.memory import Memory, initial
from agent.control.models import ArmModel
from agent.control.trajectory import Desired, Trajectory
from agent.modes import Event, Mode, next_mode
from agent.safety import Flag, Limits, limit
from agent.telemetry.row import AgentRow
from drivers.interface import Clock, Driver, JointState, StaleStateError, Vector


@dataclass(frozen=True, slots=True)
class Agent:
    """Everything that determines one arm's torque, apart from its own state, the time and its memory."""

    name: str
    model: ArmModel
    offline: Offline
    trajectory: Trajectory
    limits: Limits
    observer: Observer | None  # None: the servos' own values are used as they are
    sigma_min: float  # stop below this smallest singular value
    period_s: float


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of one tick."""

    q: Vector  # what the law used
    dq: Vector
    terms: Terms | None  # None when the law gave nothing
    tau: Vector  # after the limits
    flags: Flag
    memory: Memory


def step(agent: Agent, state: JointState, t: float, mode: Mode, memory: Memory) -> Outcome:
    """Torque of one tick: a function of the arm's own state, the time, offline data and memory, bit for bit.

    state: measured joints; t: time since the trajectory's zero, s; memory: as the last tick left it.
    """
    if agent.observer is None:
        q, dq = state.q, state.dq
    else:
        q, dq = agent.observer.correct(memory, state.q, state.dq)
    if not math.isfinite(sum(q.tolist()) + sum(dq.tolist())):
        return Outcome(q, dq, None, memory.tau, Flag.NOT_FINITE, replace(memory, primed=False))
    try:
        terms, estimate, held = _law(agent, t, mode, memory, q, dq)
    except SingularJacobian:
        return Outcome(q, dq, None, memory.tau, Flag.SINGULAR, replace(memory, primed=False))
    wanted = terms.tau_cmd.tolist()
    tau, flags = limit(wanted, memory.tau.tolist(), agent.limits)
    if terms.sigma_min < agent.sigma_min:
        flags |= Flag.SINGULAR
    if held:
        flags |= Flag.ADAPTATION_SATURATED
    limited = np.array(tau)
    if Flag.NOT_FINITE in flags:  # nothing that is no number may live on in the memory
        return Outcome(q, dq, terms, limited, flags, replace(memory, tau=limited, primed=False))
    carried = Memory(q, dq, terms.ddq_ref, memory.ddq, limited, True, memory.hold, t, estimate)
    return Outcome(q, dq, terms, limited, flags, carried)


def _law(
    agent: Agent, t: float, mode: Mode, memory: Memory, q: Vector, dq: Vector
) -> tuple[Terms, Estimate | None, bool]:
    """Terms of this tick's law, the estimate it leaves, and whether a bound held the estimate back."""
    desired, adaptation, estimate = _desired(agent, t, mode, memory), agent.offline.adaptation, memory.estimate
    if adaptation is None:
        return known.torque(agent.model, agent.offline, q, dq, desired), None, False
    if estimate is None:
        raise TypeError("the adaptive law needs the estimate that its memory began with (initial_memory)")
    terms, gradient = adaptive.torque(agent.model, agent.offline, adaptation, estimate, q, dq, desired)
    if not memory.primed or mode not in _COMMANDING:
        return terms, estimate, False
    advanced, held = adaptation.advance(estimate, gradient, t - memory.t)
    return terms, advanced, held


def initial_memory(agent: Agent) -> Memory:
    """Memory before the agent's first tick."""
    adaptation = agent.offline.adaptation
    return initial(agent.model.n, None if adaptation is None else adaptation.start)


def _desired(agent: Agent, t: float, mode: Mode, memory: Memory) -> Desired:
    if mode is Mode.TRACK or memory.hold is None:
        return agent.trajectory.at(t)
    still = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    p, quat = memory.hold[:3], memory.hold[3:]
    return Desired(p, quat, still, still)  # type: ignore[arg-type]


def hold_here(agent: Agent, q: Vector, memory: Memory) -> Memory:
    """Memory with the object's present pose (by this arm at q) as the one to hold; no pose while q is no number."""
    if not np.isfinite(q).all():
        return replace(memory, hold=None)
    k = agent.model.evaluate(q, np.zeros_like(q))
    return replace(memory, hold=(*k.p_object, *k.quat_object))


class RowSink(Protocol):
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

    zero_ns: int  # driver clock at the trajectory's zero
    zero_utc_ns: int
    period_ns: int
    ticks: int
    lockstep: bool
    hold_at_end: bool  # after the last tick hold the object until an operator releases it (real arms)


@dataclass
class RunSummary:
    """What `run` did."""

    ticks: int = 0
    late_cycles: int = 0
    stale_cycles: int = 0
    mode: Mode = Mode.READY
    reason: str = ""


MAX_STALE_IN_A_ROW = 3
_COMMANDING = frozenset({Mode.TRACK, Mode.HOLD, Mode.LOWER})


def run(
    agent: Agent,
    driver: Driver,
    clock: Clock,
    schedule: Schedule,
    row: AgentRow,
    sink: RowSink,
    wall_ns: Callable[[], int],
    events: Callable[[], Event],
    heartbeat: Callable[[], None],
) -> RunSummary:
    """Run the loop on an enabled driver until the last tick or a stop; leaves the torque as it is.

    wall_ns measures durations for the log and nothing else.  events() tells of operator requests.  heartbeat
    is called after every cycle with a fresh state.
    """
    memory = initial_memory(agent)
    summary = RunSummary(mode=Mode.TRACK)
    stale_in_a_row = 0
    tick = 0
    while summary.mode in _COMMANDING and (tick < schedule.ticks or schedule.hold_at_end):
        deadline_ns = schedule.zero_ns + tick * schedule.period_ns
        clock.sleep_until(deadline_ns)
        if schedule.lockstep:
            sink.wait_for_space()
        begin = wall_ns()
        late_ns = 0 if schedule.lockstep else clock.now_ns() - deadline_ns
        try:
            state = driver.read()
        except StaleStateError as error:
            summary.stale_cycles += 1
            stale_in_a_row += 1
            if stale_in_a_row > MAX_STALE_IN_A_ROW:
                summary.mode, summary.reason = Mode.FAULT, str(error)
                break
            driver.write(memory.tau)
            tick += 1
            continue
        stale_in_a_row = 0
        after_read = wall_ns()
        t = (state.stamp_ns - schedule.zero_ns) * 1e-9
        outcome = step(agent, state, t, summary.mode, memory)
        after_step = wall_ns()
        tau_sent = driver.write(outcome.tau)
        after_write = wall_ns()

        row.fill_state(summary.ticks, t, schedule.zero_utc_ns + state.stamp_ns - schedule.zero_ns, summary.mode, state)
        row.fill_law(outcome.q, outcome.dq, outcome.terms, memory)
        row.fill_output(outcome.flags, outcome.tau, tau_sent)
        row.fill_timing(
            late_ns * 1e-9,
            (after_read - begin) * 1e-9,
            (after_step - after_read) * 1e-9,
            (after_write - after_step) * 1e-9,
            driver.counters,
        )
        sink.commit()
        heartbeat()

        memory = outcome.memory
        happened = events() | (Event.STOP if tick + 1 >= schedule.ticks and schedule.hold_at_end else Event.NONE)
        if outcome.flags & (Flag.NOT_FINITE | Flag.SINGULAR):
            happened |= Event.TROUBLE
            summary.reason = summary.reason or f"tick {tick}: {outcome.flags!r}"
        mode = next_mode(summary.mode, happened)
        if mode is Mode.HOLD and (summary.mode is not Mode.HOLD or memory.hold is None):
            memory = hold_here(agent, outcome.q, memory)
        summary.mode = mode
        summary.ticks += 1
        summary.late_cycles += late_ns > schedule.period_ns
        tick += 1 if schedule.lockstep else 1 + max(0, (clock.now_ns() - deadline_ns) // schedule.period_ns)
    return summary
