"""A cell from rest to rest: real drivers, control loops and sessions on emulated servos, in virtual time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import pinocchio as pin

from agent.around import RunSummary, Schedule, Surroundings
from agent.config import monitors
from agent.config.cell import Arm, Cell
from agent.config.servo_map import arm_map
from agent.config.session import rest_joints
from agent.faults.virtual import Line, SharedClock
from agent.modes import Event, Mode
from agent.monitors.watch import Watch
from agent.process.build import build_agent
from agent.process.schedule import schedule_of
from agent.process.session import session_loop
from agent.process.whole import WHERE_IT_SHOULD, whole_cell
from agent.runner import Runner
from agent.telemetry.row.fill import AgentRow
from drivers.dynamixel.driver import DynamixelDriver
from sim_backend.wire.faults import Fault
from sim_backend.wire.injector import Injector
from sim_backend.wire.plant_world import emulate_whole
from sim_backend.wire.timing import BusTiming
from tests.support.servos.coupled_rig import ArmRun
from tests.support.servos.dxl_rig import VirtualPort
from tests.support.starts import start_joints

START_AFTER_NS = 200_000_000
AGAIN_NS = 50_000_000  # a word that was refused is said again after it
# what a person says to all arms once all of them are in a mode
WORDS = {
    Mode.REST: Event.APPROACH,
    Mode.APPROACH: Event.GRASP,
    Mode.HOLD: Event.LOWER,
    Mode.LOWER: Event.RELEASED,
    Mode.RELEASE: Event.PARK,
}


def session_schedule(cell: Cell, *, real: bool = False) -> Schedule:
    """As an agent has it that is held on to at its end; real: with the patience of real arms."""
    return schedule_of(cell, hold=True, shared=not real)


@dataclass
class SessionRun(ArmRun):
    """What the session of one arm left."""

    modes: list[tuple[float, Mode]] = field(default_factory=list)  # s of the shared clock
    told: list[str] = field(default_factory=list)
    agent: Any = None


class WholeRun:
    """All arms of a cell, and a person who says the next word when all arms are ready for it.

    says: the word for a mode, in the place of WORDS; at_tick: called with the rig once a cycle; limit_s: when the arms
    are taken away, wherever they are.
    """

    def __init__(
        self,
        cell: Cell,
        *,
        object_off: pin.SE3 = WHERE_IT_SHOULD,
        says: Mapping[Mode, Event] = WORDS,
        faults: Sequence[Fault] = (),
        at_tick: Callable[[WholeRun], None] | None = None,
        limit_s: float = 90.0,
    ) -> None:
        q_grasp = start_joints(cell)
        spec, whole, wired = whole_cell(cell, q_grasp, object_off)
        self.cell = cell
        self.emulated, self.world = emulate_whole(spec, whole, wired, timing=BusTiming())
        self.place: tuple[float, float] | None = None  # set-down error once all arms are back
        self._injectors = [Injector(arm, None, seed=1) for arm in self.emulated.arms]
        self.clock = SharedClock(self.emulated, self._injectors)
        for injector in self._injectors:
            injector.add([f for f in faults if f.arm == injector.arm.name], self.clock.now_ns())
        self._says, self._at_tick, self._limit_ns = says, at_tick, round(1e9 * limit_s)
        self.mode = {arm.name: Mode.OFF for arm in cell.arms}
        self._said_ns: dict[str, int] = {}
        self._zero_ns: int | None = None
        self.arms = {arm.name: SessionRun() for arm in cell.arms}
        self.clock.live([partial(self._run, arm, i) for i, arm in enumerate(cell.arms)])

    def _run(self, arm: Arm, index: int) -> None:
        run = self.arms[arm.name]
        run.summary = self._loop(run, arm, index)

    def _loop(self, run: SessionRun, arm: Arm, index: int) -> RunSummary:
        line = Line(self.emulated, index, self._injectors[index], self.clock)
        servos = arm_map(self.cell, arm, "virtual", rest_joints(arm))
        port = VirtualPort(line, arm.baud)
        driver = DynamixelDriver(servos, self.clock, on_event=run.events.append, scan_s=0.02, port=port)
        driver.connect()
        driver.enable()
        run.agent = agent = build_agent(self.cell, arm)
        name = arm.name

        def changed(mode: Mode) -> None:
            self.mode[name] = mode
            run.modes.append((self.clock._ns * 1e-9, mode))

        changed(Mode.REST)
        around = Surroundings(
            wall_ns=self.clock.now_ns,
            operator=lambda: self._word(name),
            start_ns=lambda: self._zero_ns,
            heartbeat=lambda: None,
            mode_changed=changed,
            trouble=run.told.append,
            refused=run.told.append,
        )
        row = AgentRow(run.log.message, arm.n, self.cell.config_id)
        schedule = session_schedule(self.cell)
        session = session_loop(self.cell, arm, agent, driver)
        watch = Watch(monitors.bounds(self.cell, arm), run.told.append)
        loop = Runner(agent, driver, self.clock, schedule, row, run.log, around, watch, session=session)
        summary = loop.run(Event.ENABLED)
        driver.disable()
        return summary

    def _word(self, arm: str) -> Event:
        """What is said to this arm in this cycle."""
        now_ns = self.clock._ns
        if self._at_tick is not None:
            self._at_tick(self)
        modes = set(self.mode.values())
        if now_ns > self._limit_ns:
            return Event.SERVO_LOST
        if len(modes) > 1:
            if arm in self._said_ns and now_ns - self._said_ns[arm] < AGAIN_NS:
                return Event.NONE
            behind = min(self.mode, key=lambda name: len(self.arms[name].modes))
            if arm != behind or self.mode[arm] not in self._says:
                return Event.NONE
        mode = self.mode[arm]
        if mode is Mode.READY:
            if self._zero_ns is None and len(modes) == 1 and self._taken_up(now_ns):
                self._zero_ns = now_ns + START_AFTER_NS
            return Event.NONE
        if mode is Mode.REST and Mode.PARK in {m for _, m in self.arms[arm].modes}:
            if self.place is None and len(modes) == 1:
                self.place = self.world.set_down_error()
            return Event.RELEASED if len(modes) == 1 or self.place is not None else Event.NONE
        word = self._says.get(mode)
        if word is None:
            return Event.NONE
        if now_ns - self._said_ns.get(arm, 0) < AGAIN_NS:
            return Event.NONE
        self._said_ns[arm] = now_ns
        return word

    def _taken_up(self, now_ns: int) -> bool:
        last = max(run.modes[-1][0] for run in self.arms.values())
        session = self.cell.file.session
        assert session is not None
        return now_ns * 1e-9 - last > session.take_up_s + 0.1
