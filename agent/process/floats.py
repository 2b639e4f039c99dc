"""The process of one arm that a hand guides: the loop of an agent, in FLOAT until it is told to stop.

A stop (SIGTERM, SIGINT, a monitor, lost states, an error of its own) brakes the arm and lets it stand for STAND_S; then
it sinks slowly, and its torque goes off once it lies.  Each step is told before it comes.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace

import numpy as np

from agent.around import Beginning, RunSummary, Surroundings
from agent.config import floating, session
from agent.config.cell import Arm, Cell
from agent.config.schema.cell import DriverKind
from agent.config.schema.floating import Floating
from agent.config.servo_map import arm_map, fingers_of
from agent.grip import Verdict, Watch
from agent.host.notify import Notifier
from agent.host.realtime import become_realtime, quiet_memory
from agent.loop import initial_memory
from agent.modes import TABLE, Event, Mode
from agent.monitors.watch import Watch as Monitors
from agent.process.agent import ArmLost
from agent.process.build import EMULATED_READ_SHARE, build_agent, in_words, port_of
from agent.process.schedule import AgentOptions, schedule_of
from agent.process.tellers import Heart, ServoTeller, Teller, opened
from agent.runner import Runner
from agent.telemetry.ring.texts import TextWriter
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.event import Level
from agent.telemetry.row.fill import AgentRow
from drivers.clock import MonotonicClock
from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.driver import DynamixelDriver
from drivers.dynamixel.pace import SHARE
from drivers.interface import Clock, ConnectError, Driver, Gripper, Refusal, StaleStateError, Vector

STAND_S = 3.0  # between the stop and the way down: time to put a hand under the arm
LIES_RAD_PER_S = 0.05  # of every joint,
LIES_S = 0.5  # for so long: it goes down no farther
SINK_MAX_S = 30.0
ENDLESS = 1 << 40  # ticks
STALE_MAX = 3
STANDS = f"stands; put a hand under it: in {STAND_S:g} s it sinks slowly, then its torque goes off"
SINKS = "sinks slowly; its torque goes off once it lies"


class FloatError(ConnectError):
    """An arm that cannot float as it is."""


@dataclass(frozen=True)
class Floats:
    """One arm of a cell that floats."""

    cell: Cell
    arm: Arm
    spec: Floating

    @classmethod
    def of(cls, cell: Cell, arm: str) -> Floats:
        """Raises ConfigError for an arm that is not there, FloatError for one that works."""
        found = cell.arm(arm)
        spec = floating.spec_of(cell, found)
        if spec is None:
            raise FloatError(
                f"arm {arm}", found="no floating.arms that names it", expected="one", remedy=f"`coop float --arm {arm}`"
            )
        return cls(cell, found, spec)

    def servos(self, port: str) -> ArmMap:
        """Its servos, wherever it stands: only joints that are held must be where the cell has them."""
        servos = arm_map(self.cell, self.arm, port, np.array(self.arm.entry.q_near_rad))
        free = set(self.arm.entry.controlled)
        joints = tuple(replace(j, start_rad=None) if j.name in free else j for j in servos.joints)
        return replace(servos, joints=joints)


def run_float(cell: Cell, options: AgentOptions, stop: Callable[[], bool], ready: Callable[[str], None]) -> RunSummary:
    """Let one arm float until a stop; its torque is off when this returns or raises.

    ready is called once the ring exists, and once more when the arm floats.  Raises Refusal.
    """
    floats = Floats.of(cell, options.arm)
    arm = floats.arm
    if options.driver is not DriverKind.DYNAMIXEL:
        raise FloatError(
            f"arm {arm.name}", found=f"driver {options.driver.value}", expected="servos, real or emulated",
            remedy="`coop float`; without arms, `coop float --emulate`",
        )  # fmt: skip
    if options.guard is not None or options.whole:
        raise FloatError(
            f"arm {arm.name}, which floats", found="--guard" if options.guard else "--whole", expected="neither",
            remedy="nothing takes a floating arm over, and it knows no session: leave it out",
        )  # fmt: skip
    with ExitStack() as stack:
        texts, ring = opened(stack, options.ring, arm)
        notifier = stack.enter_context(closing(Notifier()))
        ready(f"ring={options.ring}")
        tell = Teller(arm.name, texts)
        clock, emulated = MonotonicClock(), options.connection.emulated
        servos = floats.servos(port_of(arm, options.connection))
        share = EMULATED_READ_SHARE if emulated else SHARE
        driver = DynamixelDriver(servos, clock, on_event=in_words(tell.warn), read_share=share)
        try:
            info = driver.connect()
            tell.clock = clock
            require_within(floats, driver)
            quiet_memory()
            if options.priority is not None:
                become_realtime(options.priority)
            # before the torque: from then on the servos' watchdogs run
            loop = FloatLoop(floats, options, driver, clock, ring, stop, tell, texts, notifier)
            driver.enable()
            notifier.ready(TABLE[Mode.FLOAT].says)
            tell.event(Level.INFO, f"torque on, floating: {info.description}", priority=options.priority or 0)
            ready("torque=on")
            summary = loop.run()
        except Refusal as error:
            tell.event(Level.ERROR, str(error))
            raise
        finally:
            driver.disable()
            driver.close()
            notifier.stopping("torque off")
    if summary.mode is Mode.FAULT:
        raise ArmLost(
            f"arm {arm.name}", found=summary.reason, expected="a fresh state every cycle", remedy="see the log"
        )
    return summary


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
            remedy="bring it back by hand; if it is there already, correct zero_tick of that joint in the arm file",
        )  # fmt: skip


class Ending:
    """What happens to a floating arm and when: stop, stand, sink, off."""

    def __init__(self, stop: Callable[[], bool], tell: Teller, now_ns: Callable[[], int], sink_s: float) -> None:
        """sink_s: time in which the weight is let go."""
        self._stop = stop
        self._now_ns = now_ns
        self._sink_s = sink_s
        self._tell = tell
        self._mode = Mode.FLOAT
        self._since_ns = self._fast_ns = now_ns()  # in this mode; since a joint moved last

    def mode(self, mode: Mode) -> None:
        """The arm's mode has changed."""
        self._mode = mode
        self._since_ns = self._fast_ns = self._now_ns()
        said = {Mode.STAND: STANDS, Mode.SINK: SINKS}.get(mode)
        if said is not None:
            self._tell.event(Level.WARN, said)

    def warn(self, text: str) -> None:
        """A monitor has something to say of an arm that stands; one that sinks goes to its end stops."""
        if self._mode is not Mode.SINK:
            self._tell.warn(text)

    def events(self, fastest_rad_per_s: float) -> Event:
        """Of one cycle, before it; the fastest joint: of the last one, NaN where nobody saw it."""
        now_ns = self._now_ns()
        if fastest_rad_per_s > LIES_RAD_PER_S:
            self._fast_ns = now_ns
        seconds, slow_s = (now_ns - self._since_ns) * 1e-9, (now_ns - self._fast_ns) * 1e-9
        if self._mode is Mode.FLOAT:
            return Event.STOP if self._stop() else Event.NONE
        seen = not math.isnan(fastest_rad_per_s)  # of an arm that nobody sees nobody knows whether it sinks
        if self._mode is Mode.STAND:
            return Event.RELEASED if seen and seconds >= STAND_S else Event.NONE
        lies = seen and slow_s >= LIES_S and seconds >= self._sink_s
        return Event.ARRIVED if lies or seconds >= SINK_MAX_S else Event.NONE


class FloatLoop:
    """The loop of one floating arm; its driver is connected when it is made, and enabled when it runs."""

    def __init__(
        self,
        floats: Floats,
        options: AgentOptions,
        driver: DynamixelDriver,
        clock: Clock,
        ring: RingWriter,
        stop: Callable[[], bool],
        tell: Teller,
        texts: TextWriter,
        notifier: Notifier,
    ) -> None:
        cell, arm = floats.cell, floats.arm
        self._tell, self._ring, self._driver, self._clock = tell, ring, driver, clock
        self._agent = build_agent(cell, arm)
        assert self._agent.floating is not None, "Floats.of has seen to it"
        self._ending = Ending(stop, tell, clock.now_ns, self._agent.floating.sink_s)
        self._row = AgentRow(ring.row, arm.n, cell.config_id)
        self.schedule = replace(schedule_of(cell, options), hold_at_end=True, ticks=ENDLESS)
        self._monitors = Monitors(floating.bounds(cell, arm, floats.spec), self._ending.warn)
        self._heart = Heart(notifier, cell.file.rate_hz)
        self._servos = ServoTeller(driver, texts, clock.utc_offset_ns, cell.file.rate_hz)
        self._grasp = Grasp.of(floats, driver, tell) if floats.spec.holding else None
        self._around = Surroundings(
            time.perf_counter_ns, self._events, lambda: None, self._beat, self._mode_changed, tell.trouble
        )

    def run(self) -> RunSummary:
        """Until the arm lies, or is lost.  An error of the loop itself lets the arm stand and sink all the same."""
        cpu_s = time.process_time()
        if self._grasp is not None:
            self._grasp.close()
        begins = Beginning(Mode.OFF, initial_memory(self._agent), self._clock.now_ns(), rows=0, reason="")
        runner = self._runner(begins)
        try:
            summary = runner.run(Event.FLOATED)
        except Refusal:
            raise
        except Exception as error:
            self._tell.event(Level.ERROR, f"the loop failed: {type(error).__name__}: {error}")
            self._mode_changed(Mode.STAND)
            memory = runner.memory._replace(hold=None, q_hold=None, primed=False, age=0.0)
            stands = Beginning(Mode.STAND, memory, begins.zero_ns, self._ring.written, "the loop failed")
            summary = self._runner(stands).run(Event.NONE)
            self._tell.end(summary, time.process_time() - cpu_s)
            raise
        self._tell.end(summary, time.process_time() - cpu_s)
        return summary

    def _runner(self, beginning: Beginning) -> Runner:
        return Runner(
            self._agent, self._driver, self._clock, self.schedule, self._row, self._ring, self._around,
            self._monitors, beginning,
        )  # fmt: skip

    def _events(self) -> Event:
        if self._grasp is not None:
            self._grasp.look()
        dq: Vector = self._ring.row["dq"]
        return self._ending.events(float(np.abs(dq).max()))

    def _beat(self) -> None:
        self._heart.beat()
        self._servos.beat()

    def _mode_changed(self, mode: Mode) -> None:
        self._heart.mode(mode)
        self._ending.mode(mode)


class Grasp:
    """The gripper of an arm that floats with the object: closes on it, and tells what came of that."""

    def __init__(self, floats: Floats, gripper: Gripper, tell: Teller) -> None:
        """The gripper is one that can be closed.  Raises ConfigError where the object does not fit between it."""
        self._plan = session.grip_plan(floats.cell, floats.arm)
        self._gripper, self._tell = gripper, tell
        self._watch: Watch | None = None
        self._done = False

    @classmethod
    def of(cls, floats: Floats, gripper: Gripper, tell: Teller) -> Grasp | None:
        """None for an arm whose gripper keeps its place and nothing more."""
        return None if fingers_of(floats.arm.file) is None else cls(floats, gripper, tell)

    def close(self) -> None:
        """Close it on the object, with the first torque that is sent."""
        self._gripper.grip(self._plan.closed_m)

    def look(self) -> None:
        """In every cycle."""
        state = None if self._done else self._gripper.grip_state()
        if state is None:
            return
        self._watch = self._plan.begin(state) if self._watch is None else self._plan.watch(self._watch, state)
        verdict = self._plan.closing(self._watch, state)
        if verdict is not Verdict.MOVING:
            self._done = True
            level = Level.INFO if verdict is Verdict.HOLDS else Level.WARN
            self._tell.event(level, f"gripper {verdict.value}, {state.width_m * 1e3:.1f} mm", width_m=state.width_m)
