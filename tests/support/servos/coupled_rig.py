"""Real drivers and control loops on emulated servos that carry one object, in virtual time: every run the same.

Each arm is a greenlet, as it is a process in a run; one of them goes at a time, the one that is due first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from agent.around import RunSummary, Surroundings
from agent.config.cell import Arm, Cell
from agent.config.monitors import bounds
from agent.config.servo_map import arm_map
from agent.faults.virtual import Line, SharedClock
from agent.modes import Event
from agent.monitors.watch import Watch
from agent.process.build import build_agent
from agent.process.emulate import wiring
from agent.process.schedule import schedule_of
from agent.process.simulated import plant_spec
from agent.runner import Runner
from agent.telemetry.row.fill import AgentRow
from agent.telemetry.row.sample import AGENT_STATE
from drivers.dynamixel.driver import DynamixelDriver
from drivers.dynamixel.events import DriverEvent
from drivers.interface import JointState, StaleStateError, Vector
from sim_backend.wire.faults import Fault
from sim_backend.wire.injector import Injector
from sim_backend.wire.plant_world import emulate
from sim_backend.wire.timing import BusTiming
from tests.support.runner_rig import Log
from tests.support.servos.dxl_rig import VirtualPort
from tests.support.starts import start_joints

READY_S = 0.2  # from the moment at which the last arm is ready to the common start


@dataclass
class ArmRun:
    """What the run of one arm left."""

    log: Log = field(default_factory=Log)
    events: list[DriverEvent] = field(default_factory=list)
    told: list[str] = field(default_factory=list)  # by monitors, in a hold
    summary: RunSummary | None = None
    port: VirtualPort | None = None
    runner: Runner | None = None
    driver: Blinking | None = None
    tripped_ns: int | None = None  # when a servo's watchdog fired first
    busy_s: list[float] = field(default_factory=list)  # when the loop said that it brings the arm back

    @property
    def rows(self) -> Any:
        """Its rows, as telemetry would find them."""
        return np.array(self.log.rows, AGENT_STATE.dtype)


@dataclass(frozen=True)
class Truth:
    """What the plant did in a millisecond."""

    ns: int
    q: Vector  # of all arms
    dq: Vector
    tau: Vector  # of the servos
    p_object: Vector


class Blinking(DynamixelDriver):
    """The driver, but that of `every` states it brings one."""

    every = 1
    _reads = 0

    def read(self) -> JointState:
        state = super().read()
        self._reads += 1
        if self._reads % self.every:
            raise StaleStateError("state", found="none", expected="one", remedy="let the test end")
        return state


class CoupledRun:
    """A run of all arms of a cell; faults and actions count from the common start, or from where it would be.

    real: with the patience of real arms; starts: False for arms that are never given the start; operator: words to an
    arm by its name and the seconds since the start; actions: what the test does at an instant; believed: what the
    agents have for a cell, when it is not that of the servos; ready_s: before the start.
    """

    def __init__(
        self,
        cell: Cell,
        faults: Sequence[Fault] = (),
        *,
        real: bool = False,
        starts: bool = True,
        operator: Callable[[str, float], Event] = lambda *_: Event.NONE,
        actions: Sequence[tuple[float, Callable[[CoupledRun], None]]] = (),
        believed: Cell | None = None,
        ready_s: float = READY_S,
    ) -> None:
        q_start = start_joints(cell)
        wired = [wiring(arm, i, arm.baud) for i, arm in enumerate(cell.arms)]
        self._emulated, self.world = emulate(plant_spec(cell, q_start), wired, timing=BusTiming())
        self._injectors = [Injector(arm, None, seed=1) for arm in self._emulated.arms]
        self._clock = SharedClock(self._emulated, self._injectors, self._pass)
        self._cell, self._faults = believed or cell, faults
        self._real, self._starts, self._operator, self._actions = real, starts, operator, list(actions)
        self._start_after_ns = round(ready_s * 1e9)
        self._ready: set[str] = set()
        self._zero_ns: int | None = None
        self._stalls: dict[str, float] = {}
        self.truth: list[Truth] = []
        self.arms = {arm.name: ArmRun() for arm in cell.arms}
        each = enumerate(zip(cell.arms, q_start, strict=True))
        self._clock.live([partial(self._run, arm, i, q) for i, (arm, q) in each])

    def since_s(self, ns: int | None = None) -> float:
        """Seconds since the common start, or until it."""
        now_ns = self._clock._ns if ns is None else ns
        return -1e3 if self._zero_ns is None else (now_ns - self._zero_ns) * 1e-9

    def between(self, begin_s: float, end_s: float) -> list[Truth]:
        """What the plant did in that time."""
        return [one for one in self.truth if begin_s <= self.since_s(one.ns) < end_s]

    def emulated(self, arm: str) -> Any:
        """The emulated arm."""
        return next(one for one in self._emulated.arms if one.name == arm)

    def stall(self, arm: str, seconds: float) -> None:
        """The arm's process does nothing for a while, from the end of its cycle on."""
        self._stalls[arm] = seconds

    def _heartbeat(self, arm: str) -> None:
        seconds = self._stalls.pop(arm, 0.0)
        if seconds:
            self._clock.sleep_until(self._clock.now_ns() + round(1e9 * seconds))

    def _pass(self, ns: int) -> None:
        plant = self.world.plant
        p_object = plant.T_world_object.translation
        self.truth.append(Truth(ns, plant.q, plant.dq, self.world.tau_Nm.copy(), np.array(p_object)))
        for arm in self._emulated.arms:
            run = self.arms[arm.name]
            if run.tripped_ns is None and arm.bus.counters.watchdog_trips:
                run.tripped_ns = ns
        while self._actions and self.since_s(ns) >= self._actions[0][0]:
            self._actions.pop(0)[1](self)

    def _run(self, arm: Arm, index: int, q_start: Vector) -> None:
        run = self.arms[arm.name]
        run.summary = self._loop(run, arm, index, q_start)

    def _loop(self, run: ArmRun, arm: Arm, index: int, q_start: Vector) -> RunSummary:
        line = Line(self._emulated, index, self._injectors[index], self._clock)
        servos = arm_map(self._cell, arm, "virtual", q_start)
        port = run.port = VirtualPort(line, arm.baud)
        driver = run.driver = Blinking(servos, self._clock, on_event=run.events.append, scan_s=0.02, port=port)
        driver.connect()
        driver.enable()
        around = Surroundings(
            wall_ns=self._clock.now_ns,
            operator=lambda: self._operator(arm.name, self.since_s()),
            start_ns=lambda: self._start(arm.name),
            heartbeat=lambda: self._heartbeat(arm.name),
            mode_changed=lambda _: None,
            busy=lambda: run.busy_s.append(self.since_s()),
        )
        row = AgentRow(run.log.message, arm.n, self._cell.config_id)
        schedule = schedule_of(self._cell, hold=False, shared=not self._real)
        agent = build_agent(self._cell, arm)
        watch = Watch(bounds(self._cell, arm), run.told.append)
        run.runner = Runner(agent, driver, self._clock, schedule, row, run.log, around, watch)
        return run.runner.run(Event.ENABLED)

    def _start(self, arm: str) -> int | None:
        """The common start, once every arm has asked for it."""
        self._ready.add(arm)
        if self._zero_ns is None and len(self._ready) == len(self.arms):
            now_ns = self._clock.now_ns()
            self._zero_ns = now_ns + self._start_after_ns
            for injector in self._injectors:
                mine = [f for f in self._faults if f.arm == injector.arm.name]
                injector.add(
                    [f.model_copy(update={"start_s": f.start_s + self._start_after_ns * 1e-9}) for f in mine], now_ns
                )
        return self._zero_ns if self._starts else None
