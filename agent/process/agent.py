"""The agent process of one arm: driver, clock, law, ring; it opens no network socket and loads no network library.

Its own sockets, of operator, guard and plant, have names on this host alone.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from agent.around import RunSummary, Surroundings
from agent.config import monitors
from agent.config.cell import Cell
from agent.config.schema.driver import DriverKind
from agent.config.session import rest_joints
from agent.guard.guarded import UNGUARDED, Guarded
from agent.guard.line import GuardError
from agent.host.latency import files, newest
from agent.host.notify import Notifier
from agent.host.ready_line import pairs
from agent.host.realtime import become_realtime, granted, quiet_memory
from agent.host.signals import StopFlag
from agent.loop import Agent
from agent.modes import TABLE, Event, Mode
from agent.monitors.bounds import Name
from agent.monitors.gravity import REST_S
from agent.monitors.watch import Watch
from agent.operator.socket import ControlSocket, Standing
from agent.process.arranged import arranged
from agent.process.build import build_agent, build_driver, passed_on, wait_no_longer
from agent.process.clocked import ClockWatch, shares_time
from agent.process.commands import AgentOptions
from agent.process.let_go import let_go
from agent.process.operated import IN_LOCKSTEP, Operator, no_real_time, tick_of
from agent.process.rehearse import BridgedRows, in_the_loop
from agent.process.schedule import guard_vigil, schedule_of
from agent.process.session import session_loop
from agent.process.tellers import Heart, ServoTeller, SetClock, Teller, opened
from agent.process.unbegun import Unbegun
from agent.runner import Runner
from agent.session import SessionLoop
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.event import Level
from agent.telemetry.row.fill import AgentRow
from agent.verify.check import examine
from drivers.clock import utc_offset_ns
from drivers.dynamixel.errors import PortError, PortLostError
from drivers.interface import Clock, Driver, DriverError, Refusal
from sim_backend.hil.driver import BridgeDriver

CLOCK_S = 1.0
LOOK_S = 0.02  # from one look for a guard or plant that starts beside this process to the next
SUPPORT = "support it, and the object if it holds it, lead the others back"
AGAIN = "fold it into its rest by hand and start its agent again"
LOST_REMEDY = f"{SUPPORT}; once it has its supply again, {AGAIN}"


class ArmLost(DriverError):
    """The run ended because the arm could not be commanded any more."""

    exit_code = 5

    @classmethod
    def check(cls, arm: str, summary: RunSummary, *, session: bool = False) -> RunSummary:
        """The summary of a run that ended otherwise.  Raises ArmLost."""
        if summary.mode is Mode.FAULT:
            found, expected, remedy = summary.reason, "a fresh state every cycle", "see the log"
            leads_back = LOST_REMEDY
            if (lost := summary.lost) is not None and str(lost) == found:  # it says more than its words
                found, expected, remedy = f"{lost.what}: {lost.found}", str(lost.expected), lost.remedy
                if isinstance(lost, PortError | PortLostError):  # its servos have their supply
                    leads_back = f"{SUPPORT}; {remedy}; then {AGAIN}"
            raise cls(f"arm {arm}", found=found, expected=expected, remedy=leads_back if session else remedy)
        return summary


def run_agent(cell: Cell, options: AgentOptions, stop: StopFlag, ready: Callable[[str], None]) -> RunSummary:
    """Run one arm from start to stop; the torque is off when this returns or raises.

    ready is called once the ring exists and before the arm is connected, and once more when the arm holds its
    start pose.  Raises Refusal.
    """
    arm = cell.arm(options.arm)
    report = examine(cell)
    report.require()
    with ExitStack() as stack:
        texts, ring = opened(stack, options.ring, arm)
        notifier = stack.enter_context(closing(Notifier()))
        standing = Standing(arm.name)
        control = ControlSocket(options.control, cell.fingerprint, standing) if options.control else None
        if control is not None:  # behind the ring, whose lock refuses a second agent first
            stack.callback(control.close)
        ready(pairs(ring=options.ring))
        tell = Teller(arm.name, texts)
        with tell.refusals():
            guard = _reached(cell, options, stop, control)
            if guard is None and not options.lockstep:
                tell.event(Level.WARN, UNGUARDED)
            q_start = rest_joints(arm) if options.whole else report.q_start[cell.arms.index(arm)]
            driver, clock = build_driver(cell, arm, options.driver, options, q_start, tell.warn, guard)
        try:
            info = driver.connect()
            tell.clock = clock  # from here on it has the run's time
            # takes longer than the servos' watchdog waits on a busy host, and than a real-time thread may go on
            law = _law(cell, options, driver, tell)
            quiet_memory()
            if options.priority is not None:
                become_realtime(options.priority)
            if options.driver is not DriverKind.SIM:  # for a simulated arm, which cannot fall, the others would wait
                Unbegun.check(arm.name, stop, control)
            driver.enable()
            begins = Mode.REST if options.whole else Mode.READY
            # the first state of a simulated arm needs all the others
            (notifier.loading if options.driver is DriverKind.SIM else notifier.ready)(TABLE[begins].says)
            tell.event(Level.INFO, f"torque on: {info.description}", priority=options.priority or 0)
            operator = Operator(
                stop, control, clock, tell.event, drops_on_stop=not options.hold, session=options.whole,
                watch=partial(_watching, guard, stop, options),
            )  # fmt: skip
            wait_no_longer(driver, ring, operator.is_pressed)
            if shares_time(cell, arm):
                operator.clock = ClockWatch(clock.now_ns, operator.hold, max(1, round(CLOCK_S * cell.file.rate_hz)))
            if control is not None:
                _stand(standing, options, operator, ring, tell, cell, guard)
                standing.enter(begins)
            ready(pairs(torque="on"))
            if guard is not None:
                fds, told = passed_on(driver)
                guard.watch(
                    (ring.fileno(), texts.fileno(), *fds), tell.event, guard_vigil(cell, shared=options.shared),
                    ring=str(options.ring.absolute()), driver=told, session=options.whole,
                )  # fmt: skip
            servos = ServoTeller(driver, texts, clock.utc_offset_ns, cell.file.rate_hz)
            runner = _runner(cell, options, law, driver, clock, ring, operator, notifier, guard, servos, tell, standing)
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
            let_go(driver, guard, notifier)
    return ArmLost.check(arm.name, summary, session=options.whole)


def _reached(cell: Cell, options: AgentOptions, stop: StopFlag, control: ControlSocket | None) -> Guarded | None:
    """The guard, with a plant that has its socket behind it.

    Raises GuardError where nobody listens in time, Unbegun where the agent was to end meanwhile.
    """
    deadline_s = time.monotonic() + options.wait

    def waits() -> bool:
        Unbegun.check(options.arm, stop, control)
        if time.monotonic() >= deadline_s:
            return False
        time.sleep(LOOK_S)
        return True

    guard = _guard(options.guard, cell.fingerprint, waits) if options.guard is not None else None
    plant = options.plant_socket
    if plant is not None and (options.driver is DriverKind.SIM or in_the_loop(cell, options.arm)):
        while not plant.is_socket() and waits():
            pass  # who connects is told why it cannot
    return guard


def _guard(socket: Path, fingerprint: str, waits: Callable[[], bool]) -> Guarded:
    while True:
        try:
            return Guarded(socket, fingerprint)
        except GuardError:
            if not waits():
                raise


class _Law(NamedTuple):
    """What computes and judges the arm's torque."""

    agent: Agent
    session: SessionLoop | None
    watch: Watch


def _law(cell: Cell, options: AgentOptions, driver: Driver, tell: Teller) -> _Law:
    """Of the arm on its connected driver."""
    arm = cell.arm(options.arm)
    agent = build_agent(cell, arm)
    session = session_loop(cell, arm, agent, driver) if options.whole else None
    bounds = monitors.bounds(cell, arm)
    if session is not None:  # which refuses the word, and leads back
        bounds = replace(bounds, watched=bounds.watched - {Name.START})
    return _Law(agent, session, Watch(bounds, tell.warn))


def _runner(
    cell: Cell, options: AgentOptions, law: _Law, driver: Driver, clock: Clock, ring: RingWriter, operator: Operator,
    notifier: Notifier, guard: Guarded | None, servos: ServoTeller, tell: Teller, standing: Standing,
) -> Runner:  # fmt: skip
    """The loop of the arm on its enabled driver."""
    arm, heart = cell.arm(options.arm), Heart(notifier, cell.file.rate_hz)
    wall = None  # a simulated clock is its own
    if options.driver is DriverKind.DYNAMIXEL:
        wall = SetClock(tell, clock, cell.file.rate_hz, utc_offset_ns)

    def beat() -> None:
        heart.beat()
        servos.beat()
        if wall is not None:
            wall.beat()
        if operator.clock is not None:
            operator.clock.beat()

    def mode_changed(mode: Mode) -> None:
        heart.mode(mode)
        operator.mode(mode)

    def trouble(reason: str) -> None:
        tell.trouble(reason)
        operator.trouble(reason)

    def refused(reason: str) -> None:
        tell.event(Level.WARN, reason)
        operator.trouble(reason)

    def busy() -> None:
        heart.busy()
        if guard is not None:
            guard.busy()

    schedule = schedule_of(cell, hold=options.hold, shared=options.shared, lockstep=options.lockstep)
    asked = arranged(operator, options.stop_in, schedule)
    around = Surroundings(
        time.perf_counter_ns, asked.events, asked.start_ns, beat, mode_changed, trouble, refused,
        lambda: operator.watched, busy,
    )  # fmt: skip
    row = AgentRow(ring.row, arm.n, cell.config_id)
    if law.session is not None:
        standing.session = law.session.not_yet
    sink = BridgedRows(ring, row, driver, tell.warn) if isinstance(driver, BridgeDriver) else ring
    return Runner(law.agent, driver, clock, schedule, row, sink, around, law.watch, session=law.session)


def _watching(guard: Guarded | None, stop: StopFlag, options: AgentOptions) -> str:
    """What is wrong with the guard, in every cycle; does not return once it has the hold of an agent told to end."""
    return "" if guard is None else guard.poll(ending=stop.stopped and options.hold, why=stop.why)


def _stand(
    standing: Standing, options: AgentOptions, operator: Operator, ring: RingWriter, tell: Teller, cell: Cell,
    guard: Guarded | None,
) -> None:  # fmt: skip
    """What the agent answers from here on: it is READY, with what the host has given it."""
    real, tested = granted(), newest(files(os.environ))
    fitness = f"{tested.fitness(cell.file.rate_hz)}, {tested.text}" if tested else "not tested"
    if not options.lockstep:
        tell.event(
            Level.INFO, f"real time: {real.text}; latency: {fitness}", policy=real.policy, priority=real.priority,
            locked_bytes=real.locked_bytes, **({"latency_max_s": tested.histogram.max_s} if tested else {}),
        )  # fmt: skip
    punctual = real.real or options.emulated or options.allow_no_realtime
    if options.lockstep:
        standing.no_start = IN_LOCKSTEP
    elif options.driver is DriverKind.DYNAMIXEL and not punctual:
        standing.no_start = no_real_time(real.text)
    of_host = {
        "pid": os.getpid(), "real_time": asdict(real), "driver": options.driver.value, "session": options.whole,
        "drops_on_stop": operator.drops_on_stop, "ring": str(options.ring.absolute()),
    }  # fmt: skip

    def details() -> dict[str, Any]:
        start, bound_s = operator.start, operator.clock.bound_s if operator.clock else math.inf
        return {
            **of_host,
            "start_utc_ns": start.start_utc_ns if start else None,
            "clock_bound_s": bound_s if math.isfinite(bound_s) else None,
            "guard": None if guard is None else guard.state,
            "no_start": None if options.lockstep else standing.no_start,
            "tick": tick_of(ring),
        }

    standing.details = details
    if guard is not None:
        standing.alone = lambda: guard.missing
    if options.driver is DriverKind.DYNAMIXEL and not options.emulated:
        standing.rest_s = REST_S + (cell.file.session.take_up_s if cell.file.session else 0.0)
    standing.enter(Mode.READY)
