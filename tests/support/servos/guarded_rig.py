"""Two guarded arms that carry one object, in virtual time: agents that die or hang anywhere in a cycle.

Real drivers, loops and guards' own steps; what a process costs its host (waking, killing, computing) is a time that
passes, HOST_NS, since virtual time does not count instructions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from agent.around import RunSummary, Schedule, Surroundings
from agent.config.cell import Arm, Cell
from agent.config.servo_map import arm_map
from agent.faults.virtual import Line, SharedClock
from agent.guard.takeover import WATCH_NS, go_on, stale_ns
from agent.guard.vigil import Vigil
from agent.modes import Event, Mode
from agent.process.build import build_agent
from agent.process.schedule import schedule_of
from agent.runner import Runner
from agent.telemetry.row.fill import AgentRow
from agent.telemetry.row.sample import AGENT_STATE
from drivers.dynamixel.driver import DynamixelDriver
from drivers.dynamixel.servo.codes import Instruction
from drivers.dynamixel.servo.table import GOAL_CURRENT, GOAL_PWM
from drivers.dynamixel.standby import Handover, StandbyDriver
from drivers.interface import JointState, Vector
from sim_backend.wire.faults import Fault
from tests.support.servos.coupled_rig import ArmRun, CoupledRun
from tests.support.servos.dxl_rig import VirtualPort

HOST_NS = 4_000_000  # to wake, to see a process end, to compute the hold: three times what a small computer needs
GOALS = tuple(register.address.to_bytes(2, "little") for register in (GOAL_CURRENT, GOAL_PWM))


class Died(BaseException):
    """The agent's process is no more."""


@dataclass(frozen=True)
class End:
    """What becomes of an agent, at an instant of the trajectory's time: anywhere in a cycle."""

    at_s: float
    hangs: bool = False


class MortalClock:
    """The shared clock for one agent, which does not return from it once its time has come."""

    utc_offset_ns = 0

    def __init__(self, clock: SharedClock) -> None:
        self._clock = clock
        self.end_ns: int | None = None

    def now_ns(self) -> int:
        return self._alive(self._clock.now_ns())

    def sleep_until(self, deadline_ns: int) -> None:
        self._clock.sleep_until(deadline_ns)
        self._alive(deadline_ns)

    def _alive(self, now_ns: int) -> int:
        if self.end_ns is not None and now_ns >= self.end_ns:
            raise Died
        return now_ns


class TimedPort(VirtualPort):
    """A port that knows when torques went out."""

    torques_ns: list[int]

    def write(self, data: bytes, deadline_ns: int) -> None:
        super().write(data, deadline_ns)
        if data[7] == Instruction.SYNC_WRITE and data[8:10] in GOALS:
            self.torques_ns.append(self._line.clock.now_ns())


@dataclass
class Guarded(ArmRun):
    """What the run of one guarded arm left."""

    died_ns: int = 0
    row_ns: int = 0  # when the agent's last row was committed: its last heartbeat
    rows_of_agent: int = 0
    torques_ns: list[int] = field(default_factory=list)
    held: Vector | None = None  # the torque its servos held when the guard came
    modes: list[Mode] = field(default_factory=list)


class GuardedRun(CoupledRun):
    """A run of a cell whose agents end as told; their guards hold until until_s of the trajectory's time."""

    def __init__(self, cell: Cell, ends: Mapping[str, End], until_s: float, faults: Sequence[Fault] = ()) -> None:
        self._ends, self._until_ns = ends, round(until_s * 1e9)
        super().__init__(cell, faults)

    def _run(self, arm: Arm, index: int, q_start: Vector) -> None:
        self.arms[arm.name] = Guarded()
        super()._run(arm, index, q_start)

    def _loop(self, run: ArmRun, arm: Arm, index: int, q_start: Vector) -> RunSummary:
        assert isinstance(run, Guarded)
        clock = MortalClock(self._clock)
        line = Line(self._emulated, index, self._injectors[index], clock)
        servos = arm_map(self._cell, arm, "virtual", q_start)
        port = TimedPort(line, arm.baud)
        port.torques_ns = run.torques_ns
        driver = DynamixelDriver(servos, clock, on_event=run.events.append, scan_s=0.02, port=port)
        driver.connect()
        driver.enable()
        handover = Handover.of(driver)
        row = AgentRow(run.log.message, arm.n, self._cell.config_id)

        def start_ns() -> int | None:
            zero_ns = self._start(arm.name)
            if zero_ns is not None and arm.name in self._ends:
                clock.end_ns = zero_ns + round(self._ends[arm.name].at_s * 1e9)
            return zero_ns

        schedule = self._schedule()
        runner = Runner(
            build_agent(self._cell, arm),
            driver,
            clock,
            schedule,
            row,
            run.log,
            self._around(run, start_ns, lambda: False),
        )
        try:
            return runner.run()
        except Died:
            line.clock = self._clock
            return self._guarded(run, arm, StandbyDriver(servos, self._clock, port=port), handover, row)

    def _guarded(self, run: Guarded, arm: Arm, driver: StandbyDriver, handover: Handover, row: AgentRow) -> RunSummary:
        """What a guard does, from the instant at which its agent has done nothing more."""
        clock, end, period_ns = self._clock, self._ends[arm.name], self._cell.period_ns
        driver.prepare(handover)
        run.died_ns, run.rows_of_agent = clock.now_ns(), len(run.log.rows)
        if end.hangs:
            vigil = Vigil(stale_ns(period_ns, emulated=False, simulated=False), WATCH_NS)
            while not vigil.is_stale(clock.now_ns(), run.rows_of_agent):
                clock.sleep_until(clock.now_ns() + WATCH_NS)
        clock.sleep_until(clock.now_ns() + HOST_NS)
        agent = build_agent(self._cell, arm)
        rows = np.array(run.log.rows[-64:], AGENT_STATE.dtype)

        class Asked:
            resumed = limp = False

            def adopt(self, last: JointState | None, *, brings_back: bool) -> Vector:
                run.held = driver.adopt(last, brings_back=brings_back)
                self.resumed, self.limp = driver.resumed, driver.limp
                return run.held

        begun = go_on(agent, Asked(), clock, rows, self._schedule(), "the agent has died")
        until_ns = (self._zero_ns or 0) + self._until_ns
        around = self._around(run, lambda: None, lambda: clock.now_ns() > until_ns)
        schedule = replace(self._schedule(), hold_at_end=True)
        return Runner(agent, driver, clock, schedule, row, run.log, around, beginning=begun).run()

    def _schedule(self) -> Schedule:
        return schedule_of(self._cell, hold=False, shared=False)

    def _around(self, run: Guarded, start_ns: Any, over: Any) -> Surroundings:
        def beat() -> None:
            if not run.died_ns:
                run.row_ns = self._clock.now_ns()

        return Surroundings(
            wall_ns=self._clock.now_ns,
            operator=lambda: Event.RELEASED if over() else Event.NONE,
            start_ns=start_ns,
            heartbeat=beat,
            mode_changed=run.modes.append,
        )
