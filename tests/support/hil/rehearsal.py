"""A rehearsal in virtual time: real drivers on emulated servos of lone arms, the bridge, and a plant with the rest.

The same loops and agents as in processes; the plant is called as its server calls it, without sockets.  With no arm in
the loop it is the fully simulated cell, which a rehearsal is measured by.
"""

from __future__ import annotations

import contextlib
import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from agent.around import Surroundings
from agent.config.cell import Arm, Cell
from agent.config.schema.driver import DriverKind
from agent.config.servo_map import arm_map
from agent.faults.looped import GIVE_UP_NS, PHASE_NS, Physics, VirtualPlant, VirtualSim, VirtualTwin
from agent.faults.virtual import Line, SharedClock
from agent.modes import Event
from agent.process.build import build_agent
from agent.process.emulate import wiring
from agent.process.rehearse import BridgedRows, bridge
from agent.process.schedule import schedule_of
from agent.process.simulated import lone_spec
from agent.report.series import internal_wrenches
from agent.runner import Runner
from agent.telemetry.row.fill import AgentRow
from drivers.dynamixel.arm_map import WATCHDOG_S
from drivers.dynamixel.driver import DynamixelDriver
from drivers.interface import (
    Vector,
)
from sim_backend.hil.driver import BridgeDriver
from sim_backend.wire.cell import EmulatedCell
from sim_backend.wire.faults import Fault
from sim_backend.wire.injector import Injector
from sim_backend.wire.lone_world import LoneWorld, emulate_alone
from sim_backend.wire.timing import BusTiming
from tests.support.servos.coupled_rig import ArmRun
from tests.support.servos.dxl_rig import VirtualPort
from tests.support.starts import start_joints

READY_S = 1.5  # from the last arm's first cycle to the common start


class LossyDriver(DynamixelDriver):
    """The real driver on a line that loses a share of the commands."""

    lost = 0.0
    _chance = random.Random(2)

    def write(self, tau_Nm: Vector) -> Vector:
        return tau_Nm if self._chance.random() < self.lost else super().write(tau_Nm)


@dataclass
class Hil(ArmRun):
    """What the run of one arm left, and its bridge."""

    bridge: BridgeDriver | None = None


class Killed(Exception):
    """The process of an agent is gone."""


Happening = Callable[["Rehearsal"], None]


class Rehearsal:
    """A run of a cell whose [hil] names the arms in the loop; without the table all are simulated.

    faults and happenings count from the common start, which is ready_s behind the last arm's first cycle; give_up_s:
    when somebody ends a run that has not started by then.
    """

    def __init__(
        self,
        cell: Cell,
        *,
        faults: Sequence[Fault] = (),
        happenings: Mapping[float, Happening] | None = None,
        phase_ns: int = PHASE_NS,
        older_cycles: int = 0,
        lost: float = 0.0,
        begin: Happening | None = None,
        ready_s: float = READY_S,
        give_up_s: float = GIVE_UP_NS * 1e-9,
    ) -> None:
        q_start = start_joints(cell)
        hil = cell.file.hil
        self.real = tuple(hil.arms) if hil is not None else ()
        self.plant = VirtualPlant(cell, q_start, phase_ns)
        self._emulated, self.world = self._lone(cell, q_start)
        self._injectors = [Injector(arm, None, seed=1) for arm in self._emulated.arms] if self._emulated else []
        self._physics = Physics(self._emulated, self.plant)
        self.clock = SharedClock(self._physics, self._injectors)
        self.cell, self._faults, self._late = cell, faults, (older_cycles, lost)
        self._happenings = happenings or {}
        self._ready_ns, self._give_up_ns = round(ready_s * 1e9), round(give_up_s * 1e9)
        self._ready: set[str] = set()
        self._killed: set[str] = set()
        self.zero_ns: int | None = None
        self.ports: dict[str, VirtualPort] = {}
        self.sims: dict[str, VirtualSim] = {}
        self.arms = {arm.name: Hil() for arm in cell.arms}
        if begin is not None:
            begin(self)
        self.clock.live([partial(self._run, arm, q) for arm, q in zip(cell.arms, q_start, strict=True)])

    def _lone(self, cell: Cell, q_start: Sequence[Vector]) -> tuple[EmulatedCell | None, LoneWorld | None]:
        if not self.real:
            return None, None
        chosen = [(i, arm) for i, arm in enumerate(cell.arms) if arm.name in self.real]
        wired = [(i, wiring(arm, place, arm.baud)) for place, (i, arm) in enumerate(chosen)]
        return emulate_alone(lone_spec(cell, q_start), wired, timing=BusTiming())

    def lone(self, name: str) -> Any:
        """The physics of a real arm."""
        assert self.world is not None
        return next(arm for arm in self.world.arms if arm.name == name)

    def _run(self, arm: Arm, q_start: Vector) -> None:
        with contextlib.suppress(Killed):
            self._loop(self.arms[arm.name], arm, q_start)

    def _driver(self, run: Hil, arm: Arm, q_start: Vector) -> Any:
        seat = self.plant.seats[arm.name]
        if arm.name not in self.real:
            self.sims[arm.name] = VirtualSim(seat, arm, self.clock)
            return self.sims[arm.name]
        index = next(i for i, a in enumerate(self._emulated.arms) if a.name == arm.name)  # type: ignore[union-attr]
        line = Line(self._physics, index, self._injectors[index], self.clock)
        port = self.ports[arm.name] = VirtualPort(line, arm.baud)
        real = LossyDriver(
            arm_map(self.cell, arm, "virtual", q_start), self.clock, on_event=run.events.append, scan_s=0.02, port=port
        )
        real.lost = self._late[1]
        twin = VirtualTwin(seat, *self._late)
        run.bridge = bridge(self.cell, arm, real, twin, self.clock, emulated=False)
        return run.bridge

    def _loop(self, run: Hil, arm: Arm, q_start: Vector) -> None:
        driver = self._driver(run, arm, q_start)
        driver.connect()
        driver.enable()
        around = Surroundings(
            wall_ns=self.clock.now_ns,
            operator=self._operator,
            start_ns=lambda: self._start(arm.name),
            heartbeat=lambda: self._beat(arm.name),
            mode_changed=lambda _: None,
        )
        kind = DriverKind.DYNAMIXEL if arm.name in self.real else DriverKind.SIM
        row = AgentRow(run.log.message, arm.n, self.cell.config_id)
        schedule = schedule_of(self.cell, hold=False, shared=kind is DriverKind.SIM)
        sink: Any = BridgedRows(run.log, row, driver) if run.bridge is not None else run.log
        run.summary = Runner(build_agent(self.cell, arm), driver, self.clock, schedule, row, sink, around).run()

    def _operator(self) -> Event:
        """Somebody who ends a run that never starts."""
        never = self.plant.tick < 0 and self.clock.now_ns() > self._give_up_ns
        return Event.STOP | Event.RELEASED if never else Event.NONE

    def _start(self, arm: str) -> int | None:
        self._ready.add(arm)
        if self.zero_ns is None and len(self._ready) == len(self.arms):
            now_ns = self.clock.now_ns()
            self.zero_ns = now_ns + self._ready_ns
            for injector in self._injectors:
                mine = [f for f in self._faults if f.arm == injector.arm.name]
                injector.add(
                    [f.model_copy(update={"start_s": f.start_s + self._ready_ns * 1e-9}) for f in mine], now_ns
                )
            self._physics.todo = [
                (self.zero_ns + round(t * 1e9), lambda happen=happen: happen(self))  # type: ignore[misc]
                for t, happen in sorted(self._happenings.items())
            ]
        return self.zero_ns

    def _beat(self, arm: str) -> None:
        if arm in self._killed:
            raise Killed

    def kill(self, name: str) -> None:
        """The process of a real arm's agent is gone: its servos and its twin keep what they have for a while."""
        seat = self.plant.seats[name]
        self._killed.add(name)
        seat.orphan()
        self._physics.todo.append((self.clock.now_ns() + round(WATCHDOG_S * 1e9), seat.switch_off))
        self._physics.todo.sort(key=lambda entry: entry[0])

    def watch(self, look: Callable[[float, Any], None], name: str = "left") -> None:
        """Show the physics of a real arm from now on, at most a millisecond apart, with the time from the start."""
        self._physics.watchers.append(lambda now_ns: look((now_ns - (self.zero_ns or 0)) * 1e-9, self.lone(name)))

    def apart_m(self, name: str) -> float:
        """Between the end effectors of a real arm and its twin, as they truly are."""
        lone = self.lone(name)
        here, q = lone.end_effector().translation.copy(), lone.q
        lone.q = self.plant.physics.q[self.plant.seats[name].part]
        there = lone.end_effector().translation.copy()
        lone.q = q
        return float(np.linalg.norm(here - there))

    # --- what came of it ----------------------------------------------------------------------------------------------

    def truth(self, from_s: float) -> tuple[Any, Any]:
        """Size of the object's true position error (k,) m and of each arm's internal force (k, N) N, from a time on."""
        trajectory = self.cell.trajectory()
        errors, wrenches, quats = [], [], []
        for stamp_ns, seen in self.plant.seen:
            t = (stamp_ns - (self.zero_ns or 0)) * 1e-9
            if t >= from_s:
                errors.append(np.linalg.norm(seen.p_object - np.array(trajectory.at(t).p)))
                wrenches.append(seen.grasp_wrench)
                quats.append(seen.quat_object)
        offsets = np.array([arm.entry.p_object_ee_m for arm in self.cell.arms])
        internal = internal_wrenches(np.array(wrenches), np.array(quats), offsets)
        return np.array(errors), np.linalg.norm(internal[:, :, :3], axis=2)

    def figures(self, from_s: float) -> tuple[float, float]:
        """Rms of the position error (mm) and of the internal force (N) from a time on."""
        error, force = self.truth(from_s)
        return float(np.sqrt(np.mean(error**2))) * 1e3, float(np.sqrt(np.mean(force**2)))
