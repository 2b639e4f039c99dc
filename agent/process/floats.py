"""The process of one arm that a hand guides, or that moves while others float, until it is told to stop.

A stop (SIGTERM, SIGINT, a monitor, lost states, an error of its own, a guard that is gone or hangs) brakes the arm and
lets it stand; then it sinks slowly, and its torque goes off once it lies.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack, closing

from agent.around import RunSummary
from agent.config import floating
from agent.config.cell import Cell
from agent.config.schema.driver import DriverKind
from agent.guard.guarded import UNGUARDED, Guarded
from agent.host.notify import Notifier
from agent.host.ready_line import pairs
from agent.host.realtime import become_realtime, quiet_memory
from agent.host.signals import StopFlag
from agent.modes import TABLE, Mode
from agent.process.agent import ArmLost
from agent.process.build import passed_on, port_of, servo_driver
from agent.process.commands import AgentOptions
from agent.process.float_loop import FloatError, FloatLoop, Floats
from agent.process.float_words import Words
from agent.process.let_go import let_go
from agent.process.schedule import guard_vigil
from agent.process.tellers import Teller, opened
from agent.process.unbegun import Unbegun
from agent.telemetry.row.event import Level
from drivers.clock import MonotonicClock
from drivers.interface import Clock, Driver, DriverError, Refusal, StaleStateError

STALE_MAX = 3


class FloatStopped(DriverError):
    """An arm that nobody had asked to has stopped floating, or moving with those that do."""

    exit_code = 5


def run_float(cell: Cell, options: AgentOptions, stop: StopFlag, ready: Callable[[str], None]) -> RunSummary:
    """Let one arm float, or move with those that do, until a stop; its torque is off when this returns or raises.

    ready is called once the ring exists, and once more when the arm has torque.  Raises Refusal.
    """
    floats = _floats(cell, options)
    arm = floats.arm
    with ExitStack() as stack:
        texts, ring = opened(stack, options.ring, arm)
        notifier = stack.enter_context(closing(Notifier()))
        ready(pairs(ring=options.ring))
        tell = Teller(arm.name, texts)
        guard = Guarded(options.guard, cell.fingerprint) if options.guard else None
        if guard is None:
            tell.event(Level.WARN, UNGUARDED)
        clock = MonotonicClock(options.utc_offset_ns)
        servos = floats.servos(port_of(arm, options))
        words = _words(floats, options, stop, clock, tell, stack)
        driver = servo_driver(servos, options, clock, tell.warn, guard)
        try:
            info = driver.connect()
            tell.clock = clock
            require_within(floats, driver)
            # before the torque: from then on the servos' watchdogs run
            stops = Stops(stop if words is None else words.stops, guard)
            loop = FloatLoop(
                floats, driver, clock, ring, stops, tell, texts, notifier,
                shared=options.shared, told=words, guard=guard,
            )  # fmt: skip
            quiet_memory()
            if options.priority is not None:
                become_realtime(options.priority)
            Unbegun.check(arm.name, stop, None if words is None else words.control)
            driver.enable()
            notifier.ready(TABLE[Mode.FLOAT if words is None else Mode.READY].says)
            if words is None:
                tell.event(Level.INFO, f"torque on, floating: {info.description}", priority=options.priority or 0)
            else:
                tell.event(Level.INFO, f"torque on: {info.description}", priority=options.priority or 0)
                words.ready()
            if guard is not None:
                fds, told = passed_on(driver)
                watched, vigil = (ring.fileno(), texts.fileno(), *fds), guard_vigil(cell, shared=options.shared)
                guard.watch(watched, tell.event, vigil, ring=str(options.ring), driver=told)
            ready(pairs(torque="on"))
            summary = loop.run()
        except Refusal as error:
            tell.event(Level.ERROR, str(error))
            raise
        finally:
            let_go(driver, guard, notifier)
    ArmLost.check(arm.name, summary)
    if stopped_by := loop.stopped_by or stops.unasked:
        raise FloatStopped(
            f"arm {arm.name}", found=stopped_by, expected="a stop by whoever guides it",
            remedy="it has sunk, and its torque is off; its log says what went before",
        )  # fmt: skip
    return summary


def _floats(cell: Cell, options: AgentOptions) -> Floats:
    """The arm, if it can float as it is asked to.  Raises Refusal."""
    floats = Floats.of(cell, options.arm)
    if options.driver is not DriverKind.DYNAMIXEL:
        raise FloatError(
            f"arm {options.arm}", found=f"driver {options.driver.value}", expected="servos, real or emulated",
            remedy="`coop float`; without arms, `coop float --emulate`",
        )  # fmt: skip
    if options.whole:
        raise FloatError(
            f"arm {options.arm}, which floats", found="--whole", expected="no session, of which it knows nothing",
            remedy="leave it out",
        )  # fmt: skip
    return floats


def _words(
    floats: Floats, options: AgentOptions, stop: StopFlag, clock: Clock, tell: Teller, stack: ExitStack
) -> Words | None:
    """What an arm that moves is told, until the stack ends; None of one that floats.

    Raises FloatError, ControlError.
    """
    if not floats.moves:
        return None
    if options.control is None:
        raise FloatError(
            f"arm {options.arm}, which moves", found="no control socket", expected="one, for its start",
            remedy="give --control",
        )  # fmt: skip
    return stack.enter_context(closing(Words(options.control, floats.cell, options, stop, clock, tell)))


class Stops:
    """Whether the arm is to stop; it does so, too, once nobody would go on for this process."""

    def __init__(self, asked: Callable[[], bool], guard: Guarded | None) -> None:
        self._asked = asked
        self._guard = guard
        self.unasked = ""  # why it does where nobody had asked it to

    def __call__(self) -> bool:
        """Look, once a cycle."""
        asked, missing = self._asked(), "" if self._guard is None else self._guard.poll()
        if missing and not asked:
            self.unasked = self.unasked or missing
        return asked or bool(missing)


def require_within(floats: Floats, driver: Driver) -> None:
    """Refuse an arm whose joints are beyond their limits, before it has torque.  Raises FloatError, DriverError."""
    for attempt in range(STALE_MAX + 1):
        try:
            q = driver.read().q
            break
        except StaleStateError:
            if attempt == STALE_MAX:
                raise
    for name, angle, low, high in floating.outside(floats.cell, floats.arm, q):
        raise FloatError(
            f"arm {floats.arm.name}: joint {name}", found=f"{angle:.2f} rad", expected=f"{low:.2f} to {high:.2f} rad",
            remedy="bring it back by hand (servos of `coop emulate`: start that anew); if it is there already, correct "
            "zero_tick of that joint in the arm file",
        )  # fmt: skip
