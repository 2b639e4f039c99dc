"""The loop of an arm that a hand guides, from FLOAT or from where another process left it, until its torque goes off.

A stop brakes the arm and lets it stand for STAND_S; then it sinks slowly until it lies.  Each step is told before it
comes.  An arm that moves while others float holds the start pose first, follows the motion from the common start on,
and ends like them: at a stop, and where the motion ends.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from agent.around import Beginning, RunSummary, Surroundings
from agent.config import floating, session
from agent.config.cell import Arm, Cell
from agent.config.schema.floating import Floating
from agent.config.servo_map import arm_map, fingers_of
from agent.grip import GripResult, Watch
from agent.guard.guarded import Guarded
from agent.host.notify import Notifier
from agent.loop import Agent, initial_memory
from agent.modes import Event, Mode
from agent.monitors.bounds import Bounds
from agent.monitors.watch import Watch as Monitors
from agent.process.build import build_agent
from agent.process.schedule import schedule_of
from agent.process.tellers import Heart, ServoTeller, Teller
from agent.runner import Runner
from agent.telemetry.ring.texts import TextWriter
from agent.telemetry.ring.writer import RingWriter
from agent.telemetry.row.event import Level
from agent.telemetry.row.fill import AgentRow
from agent.ticks import NOT_YET_NS
from agent.verify.check import examine
from drivers.dynamixel.arm_map import ArmMap
from drivers.dynamixel.driver import DynamixelDriver
from drivers.interface import Clock, ConnectError, Gripper, Refusal, Vector

STAND_S = 3.0  # between the stop and the way down: time to put a hand under the arm
LIES_RAD_PER_S = 0.05  # of every joint,
LIES_S = 0.5  # for so long: it goes down no farther
SINK_MAX_S = 30.0
ENDLESS = 1 << 40  # ticks
STANDS = f"stands; put a hand under it: in {STAND_S:g} s it sinks slowly, then its torque goes off"
SINKS = "sinks slowly; its torque goes off once it lies"


class FloatError(ConnectError):
    """An arm that cannot float as it is."""


@dataclass(frozen=True)
class Floats:
    """One arm of a cell that floats, or moves while others do."""

    cell: Cell
    arm: Arm
    spec: Floating
    bounds: Bounds  # found once, before any torque: that takes longer than the servos' watchdogs may wait for it

    @classmethod
    def of(cls, cell: Cell, arm: str) -> Floats:
        """Raises ConfigError for an arm that is not there, FloatError for one that takes no part."""
        found = cell.arm(arm)
        spec = floating.spec_of(cell, found)
        if spec is None:
            raise FloatError(
                f"arm {arm}", found="no floating.arms that names it", expected="one", remedy=f"`coop float --arm {arm}`"
            )
        return cls(cell, found, spec, floating.bounds(cell, found, spec))

    @property
    def moves(self) -> bool:
        """Whether it follows the cell's motion while others float."""
        return self.spec.moves(self.arm.name)

    def servos(self, port: str) -> ArmMap:
        """Its servos, wherever it stands: only joints that are held must be where the cell has them.

        An arm that moves begins where the motion does.  Raises ConfigError where the cell may not run.
        """
        if self.moves:
            report = examine(self.cell)
            report.require()
            return arm_map(self.cell, self.arm, port, report.q_start[self.cell.arms.index(self.arm)])
        servos = arm_map(self.cell, self.arm, port, np.array(self.arm.entry.q_near_rad))
        free = set(self.arm.entry.controlled)
        joints = tuple(replace(j, start_rad=None) if j.name in free else j for j in servos.joints)
        return replace(servos, joints=joints)


class Ending:
    """What happens to a floating arm and when: stop, stand, sink, off."""

    def __init__(
        self, stop: Callable[[], bool], tell: Teller, now_ns: Callable[[], int], sink_s: float, period_s: float
    ) -> None:
        """sink_s: time of cycles with a state, each period_s long, in which the weight is let go."""
        self._stop = stop
        self._now_ns = now_ns
        self._sink_s, self._period_s = sink_s, period_s
        self._tell = tell
        self._mode = Mode.FLOAT
        self.asked = False  # to stop, by whoever is not the arm itself
        self._since_ns = now_ns()  # in this mode
        self._seen_s = self._slow_s = 0.0  # in cycles with a state: in this mode, and since a joint moved last

    def mode(self, mode: Mode) -> None:
        """The arm's mode has changed."""
        self._mode = mode
        self._since_ns, self._seen_s, self._slow_s = self._now_ns(), 0.0, 0.0
        said = {Mode.STAND: STANDS, Mode.SINK: SINKS}.get(mode)
        if said is not None:
            self._tell.event(Level.WARN, said)

    def warn(self, text: str) -> None:
        """A monitor has something to say of an arm that stands; one that sinks goes to its end stops."""
        if self._mode is not Mode.SINK:
            self._tell.warn(text)

    def events(self, fastest_rad_per_s: float) -> Event:
        """Of one cycle, before it; the fastest joint: of the last one, NaN where nobody saw it."""
        seconds = (self._now_ns() - self._since_ns) * 1e-9
        seen = not math.isnan(fastest_rad_per_s)  # of an arm that nobody sees nobody knows whether it sinks
        if seen:
            self._seen_s += self._period_s
            self._slow_s = self._slow_s + self._period_s if fastest_rad_per_s <= LIES_RAD_PER_S else 0.0
        if self._mode is Mode.STAND:
            return Event.RELEASED if seen and seconds >= STAND_S else Event.NONE
        if self._mode is not Mode.SINK:
            self.asked = self.asked or self._stop()
            return Event.STOP if self.asked else Event.NONE
        lies = self._slow_s >= LIES_S and self._seen_s >= self._sink_s
        return Event.ARRIVED if lies or seconds >= SINK_MAX_S else Event.NONE


class Told(Protocol):
    """What an arm that moves is told: `agent.process.float_words.Words` is one."""

    def start_ns(self) -> int | None:
        """The common start on its clock, once it has been given."""
        ...

    def entered(self, mode: Mode) -> None:
        """Its mode has changed."""
        ...


class FloatLoop:
    """The loop of one floating arm; its driver is connected when it is made, and enabled when it runs."""

    def __init__(
        self,
        floats: Floats,
        driver: DynamixelDriver,
        clock: Clock,
        ring: RingWriter,
        stop: Callable[[], bool],
        tell: Teller,
        texts: TextWriter,
        notifier: Notifier,
        *,
        shared: bool,
        agent: Agent | None = None,
        told: Told | None = None,
        guard: Guarded | None = None,
    ) -> None:
        """shared: as of `schedule_of`; agent: of this arm, where it is built already; told: of one that moves.

        guard: who watches this loop's rows.
        """
        cell, arm = floats.cell, floats.arm
        self._tell, self._ring, self._driver, self._clock = tell, ring, driver, clock
        self._agent = agent or build_agent(cell, arm)
        assert self._agent.floating is not None, "Floats.of has seen to it"
        self._ending = Ending(stop, tell, clock.now_ns, self._agent.floating.sink_s, cell.period_ns * 1e-9)
        self._row = AgentRow(ring.row, arm.n, cell.config_id)
        self._begins = Event.ENABLED if floats.moves else Event.FLOATED
        schedule = schedule_of(cell, hold=True, shared=shared)
        self.schedule = schedule if floats.moves else replace(schedule, ticks=ENDLESS)
        self._told, self._guard = told, guard
        self.stopped_by = ""  # why it stopped by itself, of an arm that nobody had asked to
        self._monitors = Monitors(floats.bounds, self._ending.warn)
        self._heart = Heart(notifier, cell.file.rate_hz)
        self._servos = ServoTeller(driver, texts, clock.utc_offset_ns, cell.file.rate_hz)
        self._grasp = Grasp.of(floats, driver, tell) if floats.spec.holding else None
        self._around = Surroundings(
            time.perf_counter_ns,
            self._events,
            told.start_ns if told else lambda: None,
            self._beat,
            self._mode_changed,
            self._trouble,
            busy=self._busy,
        )

    def run(self, stands: Beginning | None = None) -> RunSummary:
        """Until the arm lies, or is lost.  An error of the loop itself lets the arm stand and sink all the same.

        stands: of an arm that another process let float, which is gone.
        """
        cpu_s = time.process_time()
        if stands is not None:
            self._mode_changed(stands.mode)
        if self._grasp is not None:  # also where servos had stopped meanwhile, and the gripper with them
            self._grasp.close()
        begins = stands or Beginning(Mode.OFF, initial_memory(self._agent), self._zero_ns(), rows=0, reason="")
        runner = self._runner(begins)
        try:
            summary = runner.run(self._begins if stands is None else Event.NONE)
        except Refusal:
            raise
        except Exception as error:
            self._tell.event(Level.ERROR, f"the loop failed: {type(error).__name__}: {error}")
            self._mode_changed(Mode.STAND)
            memory = runner.memory._replace(hold=None, q_hold=None, primed=False, age=0.0)
            again = Beginning(Mode.STAND, memory, begins.zero_ns, self._ring.written, "the loop failed")
            summary = self._runner(again).run(Event.NONE)
            self._tell.end(summary, time.process_time() - cpu_s)
            raise
        self._tell.end(summary, time.process_time() - cpu_s)
        return summary

    def _zero_ns(self) -> int:
        """Of the time in the rows: when it begins to float, or a motion that has not been started."""
        return self._clock.now_ns() + (NOT_YET_NS if self._begins is Event.ENABLED else 0)

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

    def _busy(self) -> None:
        self._heart.busy()
        if self._guard is not None:
            self._guard.busy()

    def _trouble(self, reason: str) -> None:
        self._tell.trouble(reason)
        if not self._ending.asked:
            self.stopped_by = reason

    def _mode_changed(self, mode: Mode) -> None:
        self._heart.mode(mode)
        self._ending.mode(mode)
        if self._told is not None:
            self._told.entered(mode)


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
        if verdict is not GripResult.MOVING:
            self._done = True
            level = Level.INFO if verdict is GripResult.HOLDS else Level.WARN
            self._tell.event(level, f"gripper {verdict.value}, {state.width_m * 1e3:.1f} mm", width_m=state.width_m)
