"""The agent process of one arm: driver, clock, law, ring.  Opens no network socket and imports nothing that could."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from agent.config.cell import Arm, Cell
from agent.config.check import examine
from agent.config.schema import DriverKind
from agent.loop import RunSummary, Schedule, run
from agent.modes import Event, Mode
from agent.process.build import build_agent
from agent.process.notify import Notifier
from agent.process.signals import StopFlag
from agent.telemetry.event import Event as TextEvent
from agent.telemetry.event import Level, TextWriter
from agent.telemetry.ring import RingWriter
from agent.telemetry.row import AgentRow
from agent.telemetry.sample import AGENT_STATE
from drivers.interface import Clock, Driver, DriverError, Refusal
from sim_backend.driver import SimDriver

HEARTBEAT_S = 0.02


@dataclass(frozen=True)
class AgentOptions:
    """How one agent is started."""

    arm: str
    driver: DriverKind
    ring: Path
    plant_socket: Path | None  # simulated driver only
    lockstep: bool
    realtime_priority: int = 0  # 0: leave the scheduler alone


class ArmLost(DriverError):
    """The run ended because the arm could not be commanded any more."""

    exit_code = 5


def run_agent(cell: Cell, options: AgentOptions, stop: StopFlag, ready: Callable[[str], None]) -> RunSummary:
    """Run one arm from start to stop; the torque is off when this returns or raises.

    ready is called once the ring exists and before the arm is connected.  Raises Refusal.
    """
    arm = cell.arm(options.arm)
    examine(cell).require()
    agent = build_agent(cell, arm)
    ticks = round(cell.file.duration_s * cell.file.rate_hz)
    simulated = options.driver is DriverKind.SIM
    notifier = Notifier()
    with (
        RingWriter(options.ring, AGENT_STATE, arm.name, tuple(arm.entry.controlled)) as ring,
        closing(TextWriter(options.ring, arm.name)) as texts,
    ):
        ready(f"ring={options.ring}")
        row = AgentRow(ring.row, arm.n, cell.config_id)
        driver, clock = _driver(cell, arm, options)
        tell = _Teller(arm.name, texts)
        try:
            info = driver.connect()
            driver.enable()
            notifier.ready(f"arm {arm.name}: torque on")
            tell.event(Level.INFO, f"torque on: {info.description}")
            schedule = Schedule(
                clock.now_ns(), time.time_ns(), cell.period_ns, ticks, options.lockstep, hold_at_end=not simulated
            )
            heart = _Heart(notifier, max(1, round(HEARTBEAT_S * cell.file.rate_hz)))
            _quiet_memory()
            began = time.monotonic()
            summary = run(
                agent, driver, clock, schedule, row, ring, time.perf_counter_ns, _events(stop, simulated), heart.beat
            )
            tell.end(summary, time.monotonic() - began)
        except Refusal as error:
            tell.event(Level.ERROR, str(error))
            raise
        finally:
            driver.disable()
            driver.close()
            notifier.stopping("torque off")
            notifier.close()
            texts.finish()
            ring.finish()
    if summary.mode is Mode.FAULT:
        raise ArmLost(
            f"arm {arm.name}", found=summary.reason, expected="a fresh state every cycle", remedy="see the log"
        )
    return summary


class _Teller:
    """Writes the agent's own events; mode changes and flags are told from the rows by telemetry."""

    def __init__(self, arm: str, texts: TextWriter) -> None:
        self._arm = arm
        self._texts = texts

    def event(self, level: Level, text: str, **data: float | str) -> None:
        """Something happened now."""
        self._texts.event(TextEvent(time.time_ns(), self._arm, level, text, data))

    def end(self, summary: RunSummary, wall_s: float) -> None:
        """The run is over; wall_s is what the report's real-time factor is made of."""
        level = Level.ERROR if summary.mode is Mode.FAULT else Level.INFO
        text = f"run ended in {summary.mode.name} {summary.reason}".strip()
        self.event(level, text, ticks=summary.ticks, late_cycles=summary.late_cycles, wall_s=round(wall_s, 3))


class _Heart:
    """Strokes the service manager's watchdog from the loop, once in a number of cycles."""

    def __init__(self, notifier: Notifier, cycles: int) -> None:
        self._notifier = notifier
        self._cycles = cycles
        self._count = 0

    def beat(self) -> None:
        """One cycle with a fresh state has passed."""
        self._count += 1
        if self._count % self._cycles == 0:
            self._notifier.alive()


def _quiet_memory() -> None:
    """No garbage collection from here on: a pause of the collector is a late torque."""
    gc.collect()
    gc.freeze()
    gc.disable()


def _events(stop: StopFlag, simulated: bool) -> Callable[[], Event]:
    """Operator requests as events; in simulation nothing can fall, so a stop also releases the object."""

    def events() -> Event:
        happened = Event.NONE
        if stop.stopped:
            happened |= Event.STOP
        if stop.released or (simulated and stop.stopped):
            happened |= Event.RELEASED
        return happened

    return events


def _driver(cell: Cell, arm: Arm, options: AgentOptions) -> tuple[Driver, Clock]:
    if options.driver is DriverKind.SIM and options.plant_socket is not None:
        sim = SimDriver(options.plant_socket, arm.name, tuple(arm.entry.controlled), cell.config_id)
        return sim, sim.clock
    raise DriverError(
        f"driver of arm {arm.name}",
        found=options.driver.value,
        expected="a driver with its settings",
        remedy="simulated arms need --plant-socket",
    )
