"""Sessions that begin in the middle: arms at their rest, at their grasps, or with the object in their grippers.

Real drivers, loops, sessions and operators on emulated servos in virtual time; a person goes through steps, each a mode
that all arms have been in for a while, a word or deed, and the modes that follow.  Agents can be killed: their guards'
own steps go on, as in `guarded_rig`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin

from agent.around import Beginning, RunSummary, Surroundings
from agent.config import monitors
from agent.config.cell import Arm, Cell
from agent.config.servo_map import arm_map
from agent.config.session import rest_joints
from agent.faults.virtual import Plug, SharedClock
from agent.guard.takeover import go_on
from agent.loop import initial_memory
from agent.modes import Event, Mode
from agent.monitors.watch import Watch
from agent.operator.socket import Requests, Standing
from agent.operator.table import Verb
from agent.process.build import build_agent
from agent.process.operated import Operator
from agent.process.session import led_back, session_loop
from agent.process.whole import WHERE_IT_SHOULD, whole_cell
from agent.runner import Runner
from agent.telemetry.row.fill import AgentRow
from agent.telemetry.row.sample import AGENT_STATE
from agent.ticks import NOT_YET_NS
from drivers.dynamixel.driver import DynamixelDriver
from drivers.dynamixel.standby import Handover, StandbyDriver
from sim_backend.wire.faults import Fault, FaultKind
from sim_backend.wire.injector import Injector
from sim_backend.wire.plant_world import emulate_whole
from sim_backend.wire.timing import BusTiming
from tests.support.servos.coupled_rig import Line
from tests.support.servos.dxl_rig import VirtualPort
from tests.support.servos.guarded_rig import HOST_NS, Died, MortalClock
from tests.support.servos.whole_rig import AGAIN_NS, SessionRun, session_schedule
from tests.support.starts import start_joints

START_AFTER_NS = 20_000_000
DIP_S = 0.02
BOOT_NS = 400_000_000  # from power on to a servo that answers, at the most
LOOK_NS = 350_000_000  # that a person looks before he says what leads back
_HOMEWARD = {
    Mode.APPROACH: Verb.STOP, Mode.GRASP: Verb.STOP, Mode.READY: Verb.STOP, Mode.TRACK: Verb.STOP,
    Mode.HOLD: Verb.LOWER, Mode.LOWER: Verb.RELEASE, Mode.RELEASE: Verb.PARK, Mode.HALT: Verb.PARK,
}  # fmt: skip
_ORDER = (Verb.STOP, Verb.LOWER, Verb.RELEASE, Verb.PARK)


class At(Enum):
    """Where a session begins."""

    REST = Mode.REST
    GRASP = Mode.APPROACH  # it has arrived, gripper open
    GRIPPED = Mode.READY


Deed = Callable[["PhaseRun"], None]


@dataclass(frozen=True)
class Step:
    """Once all arms (or those named) are in `mode` for `after_s`: a word or a deed; then they are in `becomes`."""

    mode: Mode
    say: Verb | Deed
    becomes: Mode | None = None  # None: nothing is waited for
    after_s: float = 0.05
    arms: tuple[str, ...] = ()  # of whom the step speaks; none: all


@dataclass
class PhaseArm(SessionRun):
    """What one arm left, and how it answers."""

    standing: Standing = field(default_factory=lambda: Standing(""))
    requests: Requests = field(default_factory=Requests)
    signals: Any = field(default_factory=lambda: SimpleNamespace(stopped=False, stops=0, released=False, why=""))
    clock: MortalClock | None = None
    guarded: bool = False
    reasons: list[str] = field(default_factory=list)  # of every hold and halt
    said: list[str] = field(default_factory=list)  # by the operator
    refused: list[str] = field(default_factory=list)  # why words were


class PhaseRun:
    """All arms of a cell from `at` on, until the steps are done and `linger_s` has passed."""

    def __init__(
        self,
        cell: Cell,
        at: At,
        steps: Sequence[Step],
        *,
        object_off: pin.SE3 = WHERE_IT_SHOULD,
        back: bool = False,
        real: bool = False,
        linger_s: float = 0.05,
        limit_s: float = 20.0,
    ) -> None:
        """back: behind the steps all arms that obey are led back to their rest, word by word.

        real: the loops have the patience of real arms; a guard comes a few cycles late.
        """
        self.cell, self.at = cell, at
        q_grasp = start_joints(cell)
        spec, whole, wired = whole_cell(cell, q_grasp, object_off)
        self.lives = {arm.name: build_agent(cell, arm).session for arm in cell.arms}
        self._begins = [self._joints(arm) for arm in cell.arms]
        begun = replace(whole, q_rest=tuple(self._begins))
        self.emulated, self.world = emulate_whole(spec, begun, wired, timing=BusTiming())
        self.world.whole = whole
        if at is At.GRIPPED:
            for hand, finger in zip(whole.hands, self.world.fingers, strict=True):
                finger.q_rad = hand.fingers.angle(hand.width_m + 2e-4)
        elif at is At.GRASP:
            for hand, finger in zip(whole.hands, self.world.fingers, strict=True):
                finger.q_rad = hand.fingers.open_rad
        self._plugs = {arm.name: Plug() for arm in self.emulated.arms}
        self.injectors = {arm.name: Injector(arm, self._plugs[arm.name], seed=1) for arm in self.emulated.arms}
        self.heights: list[tuple[int, float]] = []  # ns, m of the object
        self._back, self._real, self._boot_ns = back, real, 0
        self._begin(steps)
        self._linger_ns, self._limit_ns = round(1e9 * linger_s), round(1e9 * limit_s)
        self.clock.live([partial(self._run, arm, i) for i, arm in enumerate(self.cell.arms)])

    def _begin(self, steps: Sequence[Step]) -> None:
        """A new clock on the servos as they are, and new agents."""
        self.clock = SharedClock(self.emulated, list(self.injectors.values()), self._passed)
        self.arms = {arm.name: PhaseArm() for arm in self.cell.arms}
        self.mode = dict.fromkeys(self.arms, Mode.OFF)
        self._steps, self._place = list(steps), 0
        self._since_ns, self._said_ns = 0, -AGAIN_NS
        self.done_ns: int | None = None
        self._zero_ns: int | None = None  # the common start
        self.step_ns: list[int] = []  # when each was said

    # --- for tests ------------------------------------------------------------------------------------------------

    @property
    def now_ns(self) -> int:
        """On the shared clock."""
        return self.clock._ns

    @property
    def finished(self) -> bool:
        """Whether every step has been taken."""
        return self._place >= len(self._steps)

    def way(self, arm: str) -> list[Mode]:
        """The modes of an arm, in their order."""
        return [mode for _, mode in self.arms[arm].modes]

    def height(self, ns: int) -> float:
        """Of the object then, m."""
        return next(z for at, z in self.heights if at >= ns)

    def power(self, *arms: str, on: bool) -> None:
        """Cut the supply of these arms' servos, or give it back."""
        for name in arms:
            if on:
                self.injectors[name].clear(self.now_ns)
            else:
                self.injectors[name].add([Fault(kind=FaultKind.POWER_LOSS, arm=name)], self.now_ns)

    def dip(self, *arms: str) -> None:
        """The supply of these arms' servos is away for a moment."""
        for name in arms:
            gone = Fault(kind=FaultKind.POWER_LOSS, arm=name, duration_s=DIP_S)
            self.injectors[name].add([gone], self.now_ns)

    def unplug(self, arm: str, seconds: float = math.inf) -> None:
        """The adapter of this arm is away for so long."""
        self.injectors[arm].add([Fault(kind=FaultKind.PORT_LOSS, arm=arm, duration_s=seconds)], self.now_ns)

    def again(self, steps: Sequence[Step]) -> None:
        """With power: a person folds the limp arms into their rest, puts the object back and starts the agents."""
        self.power(*self.arms, on=True)
        self.at, whole = At.REST, self.world.whole
        self._begins = list(whole.q_rest)
        self.world.plant.let_go(np.concatenate(self._begins), self.world.T_world_place)
        self._begin(steps)
        self._limit_ns, self._boot_ns = self._limit_ns + self.now_ns, BOOT_NS
        self.clock.live([partial(self._run, arm, i) for i, arm in enumerate(self.cell.arms)])

    def interrupt(self, *arms: str) -> None:
        """SIGINT to these agents; none named: to all."""
        for name in arms or tuple(self.arms):
            signals = self.arms[name].signals
            signals.stopped, signals.stops = True, signals.stops + 1

    def kill(self, *arms: str) -> None:
        """SIGKILL to these agents; none named: to all."""
        for name in arms or tuple(self.arms):
            clock = self.arms[name].clock
            assert clock is not None
            clock.end_ns = self.now_ns + 1

    def start_in(self, seconds: float) -> None:
        """Give all arms a start."""
        self._zero_ns = self.now_ns + round(1e9 * seconds)

    def _start(self) -> None:
        if self._zero_ns is None or self._zero_ns < self.now_ns:
            self._zero_ns = self.now_ns + START_AFTER_NS

    # --- the arms -------------------------------------------------------------------------------------------------

    def _joints(self, arm: Arm) -> Any:
        session = self.lives[arm.name]
        assert session is not None
        return rest_joints(arm) if self.at is At.REST else session.life.path.at(session.life.path.seconds).q

    def _run(self, arm: Arm, index: int) -> None:
        run = self.arms[arm.name]
        try:
            run.summary = self._loop(run, arm, index)
        finally:
            self.mode[arm.name] = Mode.OFF if run.summary is None else run.summary.mode

    def _loop(self, run: PhaseArm, arm: Arm, index: int) -> RunSummary:
        clock = run.clock = MortalClock(self.clock)
        clock.sleep_until(clock.now_ns() + self._boot_ns)
        line: Any = Line(self.emulated, index, self.injectors[arm.name], clock, self._plugs[arm.name])  # type: ignore[arg-type]
        servos = arm_map(self.cell, arm, "virtual", self._begins[index])
        port = VirtualPort(line, arm.baud)
        driver = DynamixelDriver(servos, clock, on_event=run.events.append, scan_s=0.02, port=port)
        driver.connect()
        driver.enable()
        handover = Handover.of(driver)
        run.agent = agent = build_agent(self.cell, arm)
        row = AgentRow(run.log.message, arm.n, self.cell.config_id)
        session = session_loop(self.cell, arm, agent, driver)
        run.standing = Standing(arm.name, session=session.not_yet)
        around = self._around(run, arm.name, clock)
        begins = self.at.value
        around.mode_changed(begins)
        begun = None
        if self.at is not At.REST:
            session.entered(begins)
            session.resume(begins)
            memory = initial_memory(agent)._replace(age=1e3 if self.at is At.GRASP else 0.0)
            begun = Beginning(begins, memory, clock.now_ns() + NOT_YET_NS, 0, "")
        watch = Watch(monitors.bounds(self.cell, arm), run.told.append)
        schedule = session_schedule(self.cell, real=self._real)
        runner = Runner(agent, driver, clock, schedule, row, run.log, around, watch, begun, session)
        try:
            summary = runner.run(Event.ENABLED)
        except Died:
            line.clock = self.clock
            standby = StandbyDriver(servos, self.clock, on_event=run.events.append, port=port)
            return self._guarded(run, arm, standby, handover, row)
        driver.disable()
        return summary

    def _guarded(self, run: PhaseArm, arm: Arm, driver: StandbyDriver, handover: Handover, row: AgentRow) -> RunSummary:
        """What a guard does once its agent is dead."""
        driver.prepare(handover)
        self.clock.sleep_until(self.clock.now_ns() + HOST_NS)
        agent = build_agent(self.cell, arm)
        rows = np.array(run.log.rows[-64:], dtype=AGENT_STATE.dtype)
        run.signals = SimpleNamespace(stopped=False, stops=0, released=False, why="")
        run.standing = Standing(arm.name)
        schedule = session_schedule(self.cell, real=self._real)
        begun = go_on(agent, driver, self.clock, rows, schedule, "the agent has died", session=True)
        session = led_back(self.cell, arm, agent, driver, begun, run.standing)
        run.reasons.append(run.standing.reason)
        run.guarded = True
        around = self._around(run, arm.name, self.clock)
        self.mode[arm.name] = begun.mode
        run.modes.append((self.now_ns * 1e-9, begun.mode))
        watch = Watch(monitors.bounds(self.cell, arm), run.told.append)
        summary = Runner(agent, driver, self.clock, schedule, row, run.log, around, watch, begun, session).run()
        driver.disable()
        return summary

    def _around(self, run: PhaseArm, name: str, clock: Any) -> Surroundings:
        run.requests = Requests()
        control: Any = SimpleNamespace(poll=lambda: None, requests=run.requests, standing=run.standing)
        operator = Operator(
            run.signals, control, clock, lambda _, text, **__: run.said.append(text), drops_on_stop=False, session=True
        )

        def changed(mode: Mode) -> None:
            self.mode[name] = mode
            run.modes.append((self.now_ns * 1e-9, mode))
            operator.mode(mode)

        def trouble(reason: str) -> None:
            run.told.append(reason)
            operator.trouble(reason)
            run.reasons.append(reason)

        def heard() -> Event:
            self._person()
            if self._over():
                return Event.SERVO_LOST
            return operator.events()

        return Surroundings(
            clock.now_ns, heard, lambda: self._zero_ns, lambda: None, changed, trouble, run.refused.append
        )

    # --- the person -----------------------------------------------------------------------------------------------

    def _passed(self, ns: int) -> None:
        self.heights.append((ns, float(self.world.plant.T_world_object.translation[2])))

    def _over(self) -> bool:
        if self.finished and self._back:
            modes = {mode for mode in self.mode.values() if mode not in (Mode.FAULT, Mode.OFF)}
            if modes <= {Mode.REST}:
                self._back = False
                self.done_ns = self.now_ns
        over = self.finished and not self._back and self.now_ns > (self.done_ns or 0) + self._linger_ns
        return over or self.now_ns > self._limit_ns

    def _person(self) -> None:
        """Look at the arms, and take the next step once they are ready for it."""
        now_ns = self.now_ns
        self._since_ns = self._since_ns or now_ns
        if self.finished:
            self._lead_back()
            return
        step = self._steps[self._place]
        arms = step.arms or tuple(self.arms)
        modes = {self.mode[name] for name in arms}
        said = len(self.step_ns) > self._place
        if said and (step.becomes is None or modes == {step.becomes}):
            self._place += 1
            self._since_ns, self._said_ns = now_ns, -AGAIN_NS
            if self.finished:
                self.done_ns = now_ns
            return
        if not said and modes != {step.mode}:
            self._since_ns = now_ns
            return
        if now_ns - self._since_ns < step.after_s * 1e9 or now_ns - self._said_ns < AGAIN_NS:
            return
        self._said_ns = now_ns
        if not said:
            self.step_ns.append(now_ns)
        elif not isinstance(step.say, Verb):
            return
        self._take(step, arms, again=said)

    def _lead_back(self) -> None:
        """Behind the steps: the word that leads back from where all arms are, to those that are least far."""
        ways = {name: _HOMEWARD.get(mode) for name, mode in self.mode.items()}
        left = {word for word in ways.values() if word is not None}
        if not self._back or not left or self.now_ns < max(self._said_ns + AGAIN_NS, (self.done_ns or 0) + LOOK_NS):
            return
        self._said_ns, word = self.now_ns, min(left, key=_ORDER.index)
        for name in (name for name, mine in ways.items() if mine is word):
            self.arms[name].requests.words.append(word)

    def _take(self, step: Step, arms: Sequence[str], *, again: bool) -> None:
        if not isinstance(step.say, Verb):
            step.say(self)
            return
        for name in arms:
            run = self.arms[name]
            if again and self.mode[name] is not step.mode:
                continue
            if step.say is Verb.START:
                self._start()
            else:
                run.requests.words.append(step.say)
