"""Real drivers and control loops on emulated servos that carry one object, in virtual time: every run the same.

Each arm has a thread, as it has a process in a run; one of them goes at a time, the one that is due first.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from agent.config.cell import Arm, Cell
from agent.config.schema.cell import DriverKind
from agent.config.servo_map import arm_map
from agent.modes import Event
from agent.process.agent import AgentOptions, _schedule
from agent.process.build import Connection, build_agent
from agent.process.emulate import wiring
from agent.process.simulated import plant_spec
from agent.runner import Runner, RunSummary, Surroundings
from agent.telemetry.row.fill import AgentRow
from agent.verify.check import examine
from drivers.dynamixel.driver import DynamixelDriver
from drivers.dynamixel.events import DriverEvent
from drivers.interface import Vector
from sim_backend.wire.cell import EmulatedCell
from sim_backend.wire.faults import Fault
from sim_backend.wire.injector import Injector
from sim_backend.wire.plant_world import emulate
from sim_backend.wire.timing import BusTiming
from tests.support.runner_rig import Log
from tests.support.servos.dxl_rig import VirtualPort

START_AFTER_NS = 200_000_000  # from the moment at which the last arm is ready
NOBODY = 0


class SharedClock:
    """One `Clock` for all arms; time passes while all of them wait, and stops for the one that is due."""

    utc_offset_ns = 0

    def __init__(self, cell: EmulatedCell, injectors: Sequence[Injector], members: int) -> None:
        self._ns = cell.time_ns
        self._cell = cell
        self._injectors = injectors
        self._missing = members
        self._turn = threading.Condition()
        self._due: dict[int, int] = {}  # by thread
        self._goes = NOBODY

    def now_ns(self) -> int:
        """Virtual now; asking takes a little time, as everything does."""
        self._ns += 200
        return self._ns

    def sleep_until(self, deadline_ns: int) -> None:
        """Let the others go on until it is time."""
        me = threading.get_ident()
        with self._turn:
            self._due[me] = deadline_ns
            if self._goes == me:
                self._next()
            self._turn.wait_for(lambda: self._goes == me)

    def join(self) -> None:
        """Called by each thread before it does anything; returns when all have, one after the other."""
        me = threading.get_ident()
        with self._turn:
            self._due[me] = self._ns + self._missing  # they begin in the order in which they came
            self._missing -= 1
            if not self._missing:
                self._next()
            self._turn.wait_for(lambda: self._goes == me)

    def leave(self) -> None:
        """The calling thread waits for nothing any more."""
        with self._turn:
            self._due.pop(threading.get_ident(), None)
            self._next()

    def _next(self) -> None:
        self._goes = min(self._due, key=self._due.__getitem__, default=NOBODY)
        if self._goes != NOBODY:
            self._pass_until(self._due[self._goes])
        self._turn.notify_all()

    def _pass_until(self, deadline_ns: int) -> None:
        """In steps that watchdogs and faults can follow."""
        while self._ns < deadline_ns:
            self._ns = min(deadline_ns, self._ns + 1_000_000)
            for injector in self._injectors:
                injector.tick(self._ns)
            self._cell.advance_to(self._ns)
            for arm in self._cell.arms:
                arm.bus.tick(self._ns)


@dataclass
class Line:
    """What a `VirtualPort` needs of a rig."""

    cell: EmulatedCell
    index: int
    injector: Injector
    clock: SharedClock
    user: VirtualPort | None = None

    @property
    def bus(self) -> Any:
        """The emulated line of this arm."""
        return self.cell.arms[self.index].bus


@dataclass
class ArmRun:
    """What the run of one arm left."""

    log: Log = field(default_factory=Log)
    events: list[DriverEvent] = field(default_factory=list)
    summary: RunSummary | None = None
    error: BaseException | None = None

    @property
    def rows(self) -> Any:
        """Its rows, as telemetry would find them."""
        return np.array(self.log.rows)


class CoupledRun:
    """A run of all arms of a cell; faults count from the common start."""

    def __init__(self, cell: Cell, faults: Sequence[Fault] = (), real: Cell | None = None) -> None:
        """real: the cell as it is, where that is not what the arms believe."""
        q_start = examine(cell).q_start
        q_real = q_start if real is None else examine(real).q_start
        wired = [wiring(arm, i, arm.baud) for i, arm in enumerate(cell.arms)]
        self._emulated, _ = emulate(plant_spec(real or cell, q_real), wired, timing=BusTiming())
        self._injectors = [Injector(arm, None, seed=1) for arm in self._emulated.arms]
        self._clock = SharedClock(self._emulated, self._injectors, len(cell.arms))
        self._cell, self._faults = cell, faults
        self._ready: set[str] = set()
        self._zero_ns: int | None = None
        self.arms = {arm.name: ArmRun() for arm in cell.arms}
        threads = [
            threading.Thread(target=self._run, args=(arm, i, q), daemon=True)
            for i, (arm, q) in enumerate(zip(cell.arms, q_start, strict=True))
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        for run in self.arms.values():
            if run.error is not None:
                raise run.error

    def _run(self, arm: Arm, index: int, q_start: Vector) -> None:
        run = self.arms[arm.name]
        self._clock.join()
        try:
            run.summary = self._loop(run, arm, index, q_start)
        except BaseException as error:  # noqa: BLE001 - raised again where the run was asked for
            run.error = error
        finally:
            self._clock.leave()

    def _loop(self, run: ArmRun, arm: Arm, index: int, q_start: Vector) -> RunSummary:
        line: Any = Line(self._emulated, index, self._injectors[index], self._clock)
        servos = arm_map(self._cell, arm, "virtual", q_start)
        port = VirtualPort(line, arm.baud)
        driver = DynamixelDriver(servos, self._clock, on_event=run.events.append, scan_s=0.05, port=port)
        driver.connect()
        driver.enable()
        around = Surroundings(
            wall_ns=self._clock.now_ns,
            operator=lambda: Event.NONE,
            start_ns=lambda: self._start(arm.name),
            heartbeat=lambda: None,
            mode_changed=lambda _: None,
        )
        options: Any = AgentOptions(
            arm.name, DriverKind.DYNAMIXEL, Connection(emulated=True), None, None, lockstep=False, hold=False
        )  # type: ignore[arg-type]
        row = AgentRow(run.log.message, arm.n, self._cell.config_id)
        schedule = _schedule(self._cell, options)
        return Runner(build_agent(self._cell, arm), driver, self._clock, schedule, row, run.log, around).run()

    def _start(self, arm: str) -> int | None:
        """The common start, once every arm has asked for it."""
        self._ready.add(arm)
        if self._zero_ns is None and len(self._ready) == len(self.arms):
            now_ns = self._clock.now_ns()
            self._zero_ns = now_ns + START_AFTER_NS
            for injector in self._injectors:
                mine = [f for f in self._faults if f.arm == injector.arm.name]
                injector.add(
                    [f.model_copy(update={"start_s": f.start_s + START_AFTER_NS * 1e-9}) for f in mine], now_ns
                )
        return self._zero_ns
