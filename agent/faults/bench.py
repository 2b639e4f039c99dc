"""A cell of real drivers and control loops on emulated servos and one plant, in virtual time, with faults in it.

The schedule is that of real arms.  Nothing watches over an agent here: one that is gone leaves its servos to their
watchdog.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

import numpy as np

from agent.around import LoopLog, RunSummary, Surroundings
from agent.config import monitors
from agent.config.cell import Arm, Cell
from agent.config.reality import reality_of
from agent.config.schema.driver import DriverKind
from agent.config.schema.reality import ArmReality, Reality
from agent.config.servo_map import arm_map
from agent.faults.plan import FaultPlanError, Injection, Kind, Target, on_the_wire
from agent.faults.tampered import AgentClock, AgentGone, TamperedDriver, Tampering, with_gains
from agent.faults.virtual import Advancing, Line, Plug, SharedClock, VirtualPort
from agent.loop import Agent
from agent.modes import Event, Mode
from agent.monitors.watch import Watch
from agent.process.build import build_agent
from agent.process.emulate import wiring
from agent.process.schedule import schedule_of
from agent.process.simulated import plant_spec
from agent.runner import Runner
from agent.telemetry.row.fill import AgentRow
from agent.telemetry.row.sample import AGENT_STATE
from agent.verify.path import start_configurations
from drivers.dynamixel.events import DriverEvent
from drivers.interface import Driver, Refusal, Vector
from sim_backend.physics.build import AnyPlant
from sim_backend.physics.calendar import SEIZED_Nms_RAD
from sim_backend.physics.snapshot import Observation
from sim_backend.wire.cell import EmulatedCell
from sim_backend.wire.injector import Injector
from sim_backend.wire.plant_world import emulate
from sim_backend.wire.timing import BusTiming

START_AFTER_NS: Final = 200_000_000  # from the moment at which the last arm is ready
OBSERVE_NS: Final = 5_000_000
NS: Final = 1e-9


class Rows:
    """Rows as they were committed."""

    def __init__(self) -> None:
        self.message: Any = np.zeros((), AGENT_STATE.dtype)
        self._rows: list[Any] = []

    def commit(self) -> None:
        """Keep a copy of the row."""
        self._rows.append(self.message.copy())

    def wait_for_space(self) -> None:
        """There is always space."""

    def array(self) -> Any:
        """All rows."""
        return np.array(self._rows, AGENT_STATE.dtype)


@dataclass
class ArmRun:
    """What the run of one arm left; times on the trajectory's clock, s."""

    log: Rows = field(default_factory=Rows)
    events: list[tuple[float, DriverEvent]] = field(default_factory=list)
    modes: list[tuple[float, Mode]] = field(default_factory=list)  # entered
    troubles: list[tuple[float, str]] = field(default_factory=list)  # why it held
    warnings: list[tuple[float, str]] = field(default_factory=list)  # of its monitors, while it held already
    summary: RunSummary | None = None
    gone_s: float | None = None  # when its process was gone
    error: Refusal | None = None  # that ended it

    @property
    def rows(self) -> Any:
        """Its rows, as telemetry would find them."""
        return self.log.array()


@dataclass(frozen=True)
class Rehearsal:
    """A run with faults: what each arm left, and what was true."""

    cell: Cell
    faults: tuple[Injection, ...]
    arms: dict[str, ArmRun]
    zero_ns: int  # of the trajectory
    truth: tuple[tuple[float, Observation], ...]  # times on the trajectory's clock
    plant: AnyPlant  # as the run left it


class Bench:
    """The cell, its arms, and what befalls them when."""

    start_after_ns = START_AFTER_NS

    def __init__(self, cell: Cell, faults: tuple[Injection, ...], seed: int) -> None:
        self.cell, self.faults = cell, faults
        self._q_start = start_configurations(cell, [cell.model(arm) for arm in cell.arms])
        self._emulated = self._build(_reality(cell, faults))
        self._plugs = [Plug() for _ in self._emulated.arms]
        self._injectors = [
            Injector(arm, plug, seed=seed + i)
            for i, (arm, plug) in enumerate(zip(self._emulated.arms, self._plugs, strict=True))
        ]
        self._place = {arm.name: i for i, arm in enumerate(self._emulated.arms)}  # among those that are emulated
        for fault in faults:
            _require_servo(fault, self._injectors, self._place)
        self._clock = SharedClock(self._time, self._injectors, self._passed)
        self._ready: set[str] = set()
        self._zero_ns: int | None = None
        self._agenda: list[tuple[int, Callable[[], None]]] = []
        self._truth: list[tuple[float, Observation]] = []
        self._observed_ns = 0
        self.arms = {arm.name: ArmRun() for arm in cell.arms}

    def run(self) -> Rehearsal:
        """All arms to their end."""
        self._clock.live([partial(self._live, arm) for arm in self.cell.arms])
        return Rehearsal(self.cell, self.faults, self.arms, self._zero_ns or 0, tuple(self._truth), self._plant)

    def _build(self, reality: Reality | None) -> EmulatedCell:
        """The servos, and what they move."""
        wired = [wiring(arm, i, arm.baud) for i, arm in enumerate(self.cell.arms)]
        spec = plant_spec(self.cell, self._q_start, reality)
        emulated, world = emulate(spec, wired, timing=BusTiming())
        self._time: Advancing = emulated
        self._plant, self._observe = world.plant, world.observe
        return emulated

    # --- what happens to the plant ---------------------------------------------------------------------------------

    def _passed(self, now_ns: int) -> None:
        while self._agenda and self._agenda[0][0] <= now_ns:
            self._agenda.pop(0)[1]()
        if self._zero_ns is not None and now_ns - self._observed_ns >= OBSERVE_NS:
            self._observed_ns = now_ns
            self._truth.append(((now_ns - self._zero_ns) * NS, self._observe()))

    def _plan(self, zero_ns: int) -> None:
        """The common start is known: so is when everything happens."""
        plant = self._plant
        for fault in self.faults:
            arm, begin = str(fault.arm), zero_ns + round(fault.at_s * 1e9)
            end = None if fault.for_s == np.inf else begin + round(fault.for_s * 1e9)
            own = self._own_plan(fault)
            if own is not None:
                self._agenda.append((begin, own[0]))
                if end is not None:
                    self._agenda.append((end, own[1]))
            elif fault.target is Target.GRASP and fault.kind is Kind.OFF:
                self._agenda.append((begin, lambda arm=arm: plant.release(arm)))  # type: ignore[misc]
            elif fault.target is Target.ARM and fault.kind is Kind.STUCK:
                self._agenda.append((begin, lambda arm=arm: plant.brake(arm, SEIZED_Nms_RAD)))  # type: ignore[misc]
            elif fault.target is Target.OBJECT and fault.kind is Kind.STUCK:
                wrench = self._against(fault)
                self._agenda.append((begin, lambda wrench=wrench: plant.push(wrench)))  # type: ignore[misc]
                if end is not None:
                    self._agenda.append((end, lambda: plant.push(np.zeros(6))))
        self._agenda.sort(key=lambda entry: entry[0])
        now_ns = self._clock.now_ns()
        lead_s = (zero_ns - now_ns) * NS
        for injector in self._injectors:
            wired = [w for f in self.faults if f.arm == injector.arm.name and (w := on_the_wire(f)) is not None]
            injector.add([w.model_copy(update={"start_s": w.start_s + lead_s}) for w in wired], now_ns)

    def _own_plan(self, fault: Injection) -> tuple[Callable[[], None], Callable[[], None]] | None:
        """How such a fault begins and ends here, where that is not as on the one plant of emulated arms."""
        del fault
        return None

    def _against(self, fault: Injection) -> Vector:
        v = np.array(self.cell.trajectory().at(fault.at_s).v[:3])
        speed = float(np.linalg.norm(v))
        direction = v / speed if speed > 0.0 else np.array([1.0, 0.0, 0.0])
        return np.array([*(-fault.amount * direction), 0.0, 0.0, 0.0])

    # --- one arm ---------------------------------------------------------------------------------------------------

    def _live(self, arm: Arm) -> None:
        run = self.arms[arm.name]
        try:
            run.summary = self._loop(run, arm)
        except AgentGone:
            run.gone_s = self._t()
            self._lost(arm.name)
        except Refusal as error:
            run.error = error

    def _lost(self, arm: str) -> None:
        """The process of this arm's agent is gone."""

    def _driver(self, run: ArmRun, arm: Arm, clock: AgentClock, mine: Sequence[Injection]) -> Driver:
        i, q_start = self._place[arm.name], self._q_start[self.cell.index(arm.name)]
        line = Line(self._time, i, self._injectors[i], self._clock, self._plugs[i])
        driver = TamperedDriver(
            arm_map(self.cell, arm, "virtual", q_start),
            clock,
            on_event=lambda event: run.events.append((self._t(), event)),
            scan_s=0.05,
            port=VirtualPort(line, arm.baud),
        )
        driver.tampering = Tampering(mine, self._t)
        return driver

    def _loop(self, run: ArmRun, arm: Arm) -> RunSummary:
        mine = [fault for fault in self.faults if fault.arm == arm.name]
        clock = AgentClock(self._clock, mine, self.cell.period_ns, lambda: self._zero_ns)
        driver = self._driver(run, arm, clock, mine)
        driver.connect()
        driver.enable()
        try:
            summary = self._runner(run, arm, driver, clock, mine).run()
        except Refusal:
            driver.disable()
            raise
        if summary.mode in (Mode.FAULT, Mode.OFF):
            driver.disable()  # as the agent's process does when its loop has ended
        return summary

    def _runner(self, run: ArmRun, arm: Arm, driver: Driver, clock: AgentClock, mine: Sequence[Injection]) -> Runner:
        stops = [f.at_s for f in mine if (f.target, f.kind) == (Target.OPERATOR, Kind.OFF)]
        around = Surroundings(
            wall_ns=self._clock.now_ns,
            operator=lambda: Event.STOP if any(self._t() >= at_s for at_s in stops) else Event.NONE,
            start_ns=lambda: self._start(arm.name, mine),
            heartbeat=lambda: None,
            mode_changed=lambda mode: run.modes.append((self._t(), mode)),
            trouble=lambda text: run.troubles.append((self._t(), text)),
        )
        kind = DriverKind.DYNAMIXEL if arm.name in self._place else DriverKind.SIM
        schedule = schedule_of(self.cell, hold=False, shared=kind is DriverKind.SIM)
        row = AgentRow(run.log.message, arm.n, self.cell.config_id)
        watch = Watch(monitors.bounds(self.cell, arm), lambda text: run.warnings.append((self._t(), text)))
        sink = self._sink(run.log, row, driver)
        return Runner(self._agent(arm, mine), driver, clock, schedule, row, sink, around, watch)

    def _sink(self, rows: Rows, row: AgentRow, driver: Driver) -> LoopLog:
        """Where the loop's rows go."""
        del row, driver
        return rows

    def _agent(self, arm: Arm, mine: Sequence[Injection]) -> Agent:
        agent = build_agent(self.cell, arm)
        for fault in mine:
            if (fault.target, fault.kind) == (Target.AGENT, Kind.WRONG):
                agent = with_gains(agent, fault.amount)
        return agent

    def _start(self, arm: str, mine: Sequence[Injection]) -> int | None:
        """The common start, once every arm has asked for it, as this arm's clock has it."""
        self._ready.add(arm)
        if self._zero_ns is None and len(self._ready) == len(self.arms):
            self._zero_ns = self._clock.now_ns() + self.start_after_ns
            self._plan(self._zero_ns)
        if self._zero_ns is None:
            return None
        ahead_ms = sum(f.amount for f in mine if f.target is Target.CLOCK)
        return self._zero_ns - round(ahead_ms * 1e6)

    def _t(self) -> float:
        """Now on the trajectory's clock; −∞ before anybody knows its zero."""
        return -np.inf if self._zero_ns is None else (self._clock.now_ns() - self._zero_ns) * NS


def _require_servo(fault: Injection, injectors: Sequence[Injector], place: Mapping[str, int]) -> None:
    """Refuse a servo that the arm does not have.  Raises FaultPlanError."""
    i = place.get(str(fault.arm))
    known = [servo.id for servo in injectors[i].arm.bus.servos] if i is not None else []
    if fault.servo is not None and fault.servo not in known:
        raise FaultPlanError(
            f"fault {fault.fault}: servo of arm {fault.arm}", found=fault.servo, expected=f"one of {known}",
            remedy="name an ID of this arm",
        )  # fmt: skip


def _reality(cell: Cell, faults: Sequence[Injection]) -> Reality | None:
    """What is true beside the cell file: its own, and what the faults make of it."""
    real = reality_of(cell)
    for fault in faults:
        if (fault.target, fault.kind) == (Target.OBJECT, Kind.WRONG):
            real = (real or Reality()).model_copy(update={"object": fault.amount})
        if (fault.target, fault.kind) == (Target.GRASP, Kind.WRONG):
            real = real or Reality()
            own = real.arms.get(str(fault.arm), ArmReality())
            own = own.model_copy(update={"grasp_m": (fault.amount * 1e-3, 0.0, 0.0)})
            real = real.model_copy(update={"arms": {**real.arms, str(fault.arm): own}})
    return real
