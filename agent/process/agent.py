"""The agent process of one arm: driver, clock, law, ring; it opens no network socket and loads nothing that could."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from agent.config import monitors
from agent.config.cell import Cell
from agent.config.schema.cell import DriverKind
from agent.config.session import rest_joints
from agent.cycles import Patience
from agent.guard.guarded import UNGUARDED, Guarded
from agent.host.latency import files, newest
from agent.host.notify import Notifier
from agent.host.realtime import become_realtime, granted, quiet_memory
from agent.host.signals import StopFlag
from agent.modes import TABLE, Event, Mode
from agent.monitors.watch import Watch
from agent.operator.socket import ControlSocket, Standing
from agent.process.build import Connection, build_agent, build_driver, passed_on
from agent.process.clocked import ClockWatch, shares_time
from agent.process.operated import Operator, no_real_time, tick_of
from agent.process.rehearse import BridgedRows
from agent.process.session import session_loop
from agent.runner import Runner, RunSummary, Schedule, Surroundings
from agent.telemetry.ring.ring import RingWriter
from agent.telemetry.ring.texts import TextWriter
from agent.telemetry.row.event import Event as TextEvent
from agent.telemetry.row.event import Level
from agent.telemetry.row.fill import AgentRow
from agent.telemetry.row.health import health_values
from agent.telemetry.row.sample import AGENT_STATE
from agent.verify.check import examine
from drivers.dynamixel.arm_map import WATCHDOG_S
from drivers.interface import Clock, Driver, DriverError, Refusal
from sim_backend.hil.driver import BridgeDriver

HEARTBEAT_S = 0.02
HEALTH_S = 1.0
CLOCK_S = 1.0
EMULATED_PATIENCE_S = 0.5
QUIET_MARGIN_S = 0.05  # on the servos' watchdogs, which count in steps of 20 ms
RETRY_S = 0.1


@dataclass(frozen=True)
class AgentOptions:
    """How one agent is started."""

    arm: str
    driver: DriverKind
    connection: Connection
    ring: Path
    control: Path | None  # socket for start, stop and release; None: lockstep simulation, which starts by itself
    lockstep: bool
    hold: bool  # at a stop and at the end hold the object until it is released
    priority: int | None = None  # SCHED_FIFO; None: leave the scheduler alone
    guard: Path | None = None  # socket of the arm's guard; None: nobody goes on when this process cannot
    no_realtime: bool = False  # a real arm may be started without real time
    whole: bool = False  # it begins at its rest, and is told word by word


class ArmLost(DriverError):
    """The run ended because the arm could not be commanded any more."""

    exit_code = 5


def run_agent(cell: Cell, options: AgentOptions, stop: StopFlag, ready: Callable[[str], None]) -> RunSummary:
    """Run one arm from start to stop; the torque is off when this returns or raises.

    ready is called once the ring exists and before the arm is connected, and once more when the arm holds its
    start pose.  Raises Refusal.
    """
    arm = cell.arm(options.arm)
    report = examine(cell)
    report.require()
    with ExitStack() as stack:
        texts = stack.enter_context(closing(TextWriter(options.ring, arm.name)))
        ring = stack.enter_context(RingWriter(options.ring, AGENT_STATE, arm.name, tuple(arm.entry.controlled)))
        stack.callback(ring.finish)
        stack.callback(texts.finish)
        notifier = stack.enter_context(closing(Notifier()))
        standing = Standing(arm.name)
        control = ControlSocket(options.control, cell.fingerprint, standing) if options.control else None
        if control is not None:  # behind the ring, whose lock refuses a second agent first
            stack.callback(control.close)
        ready(f"ring={options.ring}")
        tell = _Teller(arm.name, texts)
        guard = Guarded(options.guard, cell.fingerprint) if options.guard else None
        if guard is None and not options.lockstep:
            tell.event(Level.WARN, UNGUARDED)
        q_start = rest_joints(arm) if options.whole else report.q_start[cell.arms.index(arm)]
        driver, clock = build_driver(cell, arm, options.driver, options.connection, q_start, tell.warn, guard)
        try:
            info = driver.connect()
            tell.clock = clock  # from here on it has the run's time
            quiet_memory()
            if options.priority is not None:
                become_realtime(options.priority)
            driver.enable()
            begins = Mode.REST if options.whole else Mode.READY
            notifier.ready(TABLE[begins].says)
            tell.event(Level.INFO, f"torque on: {info.description}", priority=options.priority or 0)
            operator = Operator(
                stop, control, clock, tell.event, drops_on_stop=not options.hold, session=options.whole,
                watch=_watching(guard, stop, options),
            )  # fmt: skip
            if shares_time(cell, arm):
                operator.clock = ClockWatch(clock.now_ns, operator.hold, max(1, round(CLOCK_S * cell.file.rate_hz)))
            if control is not None:
                _stand(standing, options, operator, ring, tell, cell.file.rate_hz, guard)
                standing.mode = begins
            ready("torque=on")
            if guard is not None:
                fds, told = passed_on(driver)
                guard.watch((ring.fileno(), texts.fileno(), *fds), tell.event, ring=str(options.ring), driver=told)
            servos = _Servos(driver, texts, clock.utc_offset_ns, max(1, round(HEALTH_S * cell.file.rate_hz)))
            runner = _runner(cell, options, driver, clock, ring, operator, notifier, servos, tell, standing)
            cpu_s = time.process_time()
            try:
                summary = runner.run(Event.ENABLED)
            except BaseException as error:
                if guard is not None:
                    guard.give_up(error)
                raise
            tell.end(summary, time.process_time() - cpu_s)
        except Refusal as error:
            tell.event(Level.ERROR, str(error))
            raise
        finally:
            driver.disable()
            if guard is not None:
                guard.leave()
            driver.close()
            notifier.stopping("torque off")
    if summary.mode is Mode.FAULT:
        raise ArmLost(
            f"arm {arm.name}", found=summary.reason, expected="a fresh state every cycle", remedy="see the log"
        )
    return summary


def _runner(
    cell: Cell,
    options: AgentOptions,
    driver: Driver,
    clock: Clock,
    ring: RingWriter,
    operator: Operator,
    notifier: Notifier,
    servos: _Servos,
    tell: _Teller,
    standing: Standing,
) -> Runner:
    """The loop of the arm on its enabled driver."""
    arm = cell.arm(options.arm)
    heart = _Heart(notifier, max(1, round(HEARTBEAT_S * cell.file.rate_hz)))

    def beat() -> None:
        heart.beat()
        servos.beat()
        if operator.clock is not None:
            operator.clock.beat()

    def mode_changed(mode: Mode) -> None:
        heart.mode(mode)
        operator.mode(mode)

    def trouble(reason: str) -> None:
        tell.trouble(reason)
        operator.trouble(reason)

    around = Surroundings(time.perf_counter_ns, operator.events, operator.start_ns, beat, mode_changed, trouble)
    row = AgentRow(ring.row, arm.n, cell.config_id)
    agent, session = build_agent(cell, arm), None
    if options.whole:
        session = session_loop(cell, arm, agent, driver)
        standing.session = session.not_yet
    watch = Watch(monitors.bounds(cell, arm), tell.warn)
    sink = BridgedRows(ring, row, driver) if isinstance(driver, BridgeDriver) else ring
    return Runner(agent, driver, clock, _schedule(cell, options), row, sink, around, watch, session=session)


def _watching(guard: Guarded | None, stop: StopFlag, options: AgentOptions) -> Callable[[], bool]:
    """Whether the guard is gone, in every cycle; does not return once it has the hold of an agent told to end."""
    return lambda: guard is not None and guard.poll(ending=stop.stopped and options.hold)


def _stand(
    standing: Standing, options: AgentOptions, operator: Operator, ring: RingWriter, tell: _Teller, rate_hz: float,
    guard: Guarded | None,
) -> None:  # fmt: skip
    """What the agent answers from here on: it is READY, with what the host has given it."""
    real = granted()
    tested = newest(files(os.environ))
    fitness = f"{tested.fitness(rate_hz)}, {tested.text}" if tested else "not tested"
    tell.event(
        Level.INFO, f"real time: {real.text}; latency: {fitness}", policy=real.policy, priority=real.priority,
        locked_bytes=real.locked_bytes, **({"latency_max_s": tested.histogram.max_s} if tested else {}),
    )  # fmt: skip
    if options.driver is DriverKind.DYNAMIXEL and not (options.connection.emulated or real.real or options.no_realtime):
        standing.no_start = no_real_time(real.text)
    of_host = {"pid": os.getpid(), "real_time": asdict(real)}
    fixed = {**of_host, "driver": options.driver.value, "session": options.whole}

    def details() -> dict[str, Any]:
        start, bound_s = operator.start, operator.clock.bound_s if operator.clock else math.inf
        return {
            **fixed,
            "start_utc_ns": start.start_utc_ns if start else None,
            "clock_bound_s": bound_s if math.isfinite(bound_s) else None,
            "guard": None if guard is None else guard.state,
            "tick": tick_of(ring),
        }

    standing.details = details
    standing.mode = Mode.READY


def _schedule(cell: Cell, options: AgentOptions) -> Schedule:
    rate_hz = cell.file.rate_hz
    return Schedule(
        cell.period_ns,
        round(cell.file.duration_s * rate_hz),
        options.lockstep,
        hold_at_end=options.hold,
        ready_ns=round(cell.file.simulation.ready_s * rate_hz) * cell.period_ns,
        patience=patience_of(cell, emulated=options.driver is DriverKind.SIM or options.connection.emulated),
    )


def patience_of(cell: Cell, *, emulated: bool) -> Patience:
    """How long the loop bears lost states and lost time.

    What is emulated shares the processor with everything else, and stops with it for some ten milliseconds: it is
    held, silent and late after half a second only, at any share of good cycles.
    """
    safety, rate_hz = cell.file.safety, cell.file.rate_hz
    patient = round(EMULATED_PATIENCE_S * rate_hz)
    usual = Patience(
        blind=max(1, round(safety.blind_s * rate_hz)),
        quiet=round((WATCHDOG_S + QUIET_MARGIN_S) * rate_hz),
        recover=round(safety.recover_s * rate_hz),
        retry=max(1, round(RETRY_S * rate_hz)),
    )
    if not emulated:
        return usual
    return replace(
        usual, hold=patient, blind=max(patient, usual.blind), gap=max(patient, usual.gap), success_min=0.0
    )  # fmt: skip


class _Teller:
    """Writes the agent's own events; mode changes and flags are told from the rows by telemetry.

    With the clock of the rows an event has their time: the same UTC for the same instant, and `stamp_ns` as they do.
    """

    def __init__(self, arm: str, texts: TextWriter) -> None:
        self.clock: Clock | None = None  # none before the arm is connected: the wall's time, then
        self._arm = arm
        self._texts = texts

    def event(self, level: Level, text: str, **data: float | str) -> None:
        """Something happened now."""
        utc_ns = time.time_ns()
        if self.clock is not None:
            stamp_ns = self.clock.now_ns()
            utc_ns, data = self.clock.utc_offset_ns + stamp_ns, {"stamp_ns": stamp_ns, **data}
        self._texts.event(TextEvent(utc_ns, self._arm, level, text, data))

    def warn(self, text: str) -> None:
        """The driver has something to say."""
        self.event(Level.WARN, text)

    def trouble(self, reason: str) -> None:
        """The arm holds by itself."""
        self.event(Level.WARN, f"holds: {reason}")

    def end(self, summary: RunSummary, cpu_s: float) -> None:
        """The run is over; wall_s is what the report's real-time factor is made of."""
        level = Level.ERROR if summary.mode is Mode.FAULT else Level.INFO
        text = f"run ended in {summary.mode.name} {summary.reason}".strip()
        self.event(
            level,
            text,
            ticks=summary.ticks,
            late_cycles=summary.late_cycles,
            wall_s=round(summary.tracked_s, 4),
            cpu_s=round(cpu_s, 4),
        )


class _Servos:
    """Tells the servos' slow quantities once in a number of cycles, after the cycle's torque has gone out.

    The driver has read them in its gaps, and the ring waits for nobody; a driver without servos tells nothing.
    """

    def __init__(self, driver: Driver, texts: TextWriter, utc_offset_ns: int, cycles: int) -> None:
        self._driver = driver
        self._texts = texts
        self._utc_offset_ns = utc_offset_ns
        self._cycles = cycles
        self._count = 0

    def beat(self) -> None:
        """One cycle with a fresh state has passed."""
        self._count += 1
        if self._count % self._cycles:
            return
        health = self._driver.health()
        if health.servo_ids:
            self._texts.health(self._utc_offset_ns + health.stamp_ns, health_values(health))


class _Heart:
    """Strokes the service manager's watchdog from the loop, once in a number of cycles."""

    def __init__(self, notifier: Notifier, cycles: int) -> None:
        self._notifier = notifier
        self._cycles = cycles
        self._count = 0

    def mode(self, mode: Mode) -> None:
        """Tell what the arm is doing."""
        self._notifier.send(f"STATUS={TABLE[mode].says}")

    def beat(self) -> None:
        """One cycle with a fresh state has passed."""
        self._count += 1
        if self._count % self._cycles == 0:
            self._notifier.alive()
