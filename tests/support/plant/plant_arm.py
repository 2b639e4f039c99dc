"""The real loop of one arm on the real plant in one process: driver and clock are the plant itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from agent.around import RunSummary, Schedule, Surroundings
from agent.config.cell import Cell
from agent.loop import Agent
from agent.modes import Event, Mode
from agent.process.build import build_agent
from agent.process.simulated import plant_spec
from agent.runner import Runner
from agent.telemetry.row.fill import AgentRow
from agent.telemetry.row.sample import AGENT_STATE
from agent.verify.check import start_configurations
from drivers.interface import ArmInfo, BusCounters, Clock, Driver, JointState, ServoHealth, Vector
from sim_backend.physics.actuator import TorqueCommand
from sim_backend.physics.delay import DelayLine, stretches
from sim_backend.physics.plant import Plant


class PlantClock:
    """Time passes by integrating the plant."""

    utc_offset_ns = 0

    def __init__(self, cell: Cell, plant: Plant) -> None:
        spec = plant.spec.arms[0].actuator
        self.period_ns = cell.period_ns
        self.plant = plant
        self.tick = 0
        substeps = cell.file.simulation.substeps_per_cycle
        self.line = DelayLine(spec.delay_s, plant.spec.substep_s, substeps, spec.joint_count)
        self._stretches = stretches([self.line], substeps)

    def now_ns(self) -> int:
        return self.tick * self.period_ns

    def sleep_until(self, deadline_ns: int) -> None:
        while self.now_ns() < deadline_ns:
            for begin, count in self._stretches:
                self.plant.advance(self.line.acting(self.tick, begin).copy(), count)
            self.tick += 1


class PlantArm:
    """The one arm of the plant as a driver."""

    def __init__(self, clock: PlantClock) -> None:
        self.counters = BusCounters()
        self._clock = clock
        self._command = TorqueCommand.of(clock.plant.spec.arms[0].actuator)

    def connect(self) -> ArmInfo:
        raise NotImplementedError

    def enable(self) -> None: ...

    def read(self) -> JointState:
        return JointState(self._clock.now_ns(), *self._clock.plant.reported())

    def write(self, tau_Nm: Vector) -> Vector:
        sent = self._command(tau_Nm)
        self._clock.line.push(self._clock.tick, sent)
        return sent

    def health(self) -> ServoHealth:
        raise NotImplementedError

    def disable(self) -> None: ...

    def close(self) -> None: ...


@dataclass
class RowLog:
    """Rows as they were committed."""

    message: Any = field(default_factory=lambda: np.zeros((), AGENT_STATE.dtype))
    rows: list[Any] = field(default_factory=list)

    def commit(self) -> None:
        self.rows.append(self.message.copy())

    def wait_for_space(self) -> None: ...


@dataclass(frozen=True)
class ArmRun:
    """What a run of one arm left."""

    agent: Agent
    summary: RunSummary
    rows: Any  # of AGENT_STATE.dtype
    modes: list[Mode]

    @property
    def held(self) -> Any:
        """Rows since the hold began."""
        return self.rows[self.rows["mode"] == Mode.HOLD]


def run_one(cell: Cell, duration_s: float, operator: Callable[[], Event] = lambda: Event.NONE) -> ArmRun:
    """The loop of the cell's one arm for duration_s, in lockstep with the plant; nothing is checked before."""
    arm = cell.arms[0]
    plant = Plant(plant_spec(cell, start_configurations(cell, [cell.model(arm)])))
    clock = PlantClock(cell, plant)
    return run_loop(cell, 0, PlantArm(clock), clock, duration_s, operator)


def run_loop(
    cell: Cell,
    arm: int,
    driver: Driver,
    clock: Clock,
    duration_s: float,
    operator: Callable[[], Event] = lambda: Event.NONE,
) -> ArmRun:
    """The loop of one arm of the cell on a driver."""
    agent, log, modes = build_agent(cell, cell.arms[arm]), RowLog(), []
    schedule = Schedule(cell.period_ns, round(duration_s * cell.file.rate_hz), True, False)
    around = Surroundings(
        wall_ns=lambda: 0,
        operator=operator,
        start_ns=lambda: None,
        heartbeat=lambda: None,
        mode_changed=modes.append,
    )
    row = AgentRow(log.message, agent.model.n, cell.config_id)
    summary = Runner(agent, driver, clock, schedule, row, log, around).run()
    return ArmRun(agent, summary, np.array(log.rows, AGENT_STATE.dtype), modes)
