"""A rehearsal in virtual time: real drivers on emulated servos of lone arms, the bridge, and a plant with the rest.

The same loops and agents as in processes; the plant is called as its server calls it, without sockets.  With no arm in
the loop it is the fully simulated cell, which a rehearsal is measured by.
"""

from __future__ import annotations

import random
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from agent.config.cell import Arm, Cell
from agent.config.schema.cell import DriverKind
from agent.config.servo_map import arm_map
from agent.faults.virtual import Line, SharedClock
from agent.modes import Event
from agent.process.build import Connection, build_agent
from agent.process.emulate import wiring
from agent.process.rehearse import BridgedRows, bridge
from agent.process.schedule import AgentOptions, schedule_of
from agent.process.simulated import lone_spec, plant_spec
from agent.report.series import internal_wrenches
from agent.runner import Runner, Surroundings
from agent.telemetry.row.fill import AgentRow
from agent.verify.check import examine
from drivers.dynamixel.driver import DynamixelDriver
from drivers.interface import (
    ArmInfo,
    BusCounters,
    JointState,
    Refusal,
    ServoHealth,
    StaleStateError,
    Vector,
)
from sim_backend.hil.coupling import TwinState
from sim_backend.hil.driver import BridgeDriver
from sim_backend.physics.actuator import TorqueCommand
from sim_backend.physics.build import build_plant
from sim_backend.physics.delay import DelayLine, stretches
from sim_backend.physics.plant import Observation
from sim_backend.wire.cell import EmulatedCell
from sim_backend.wire.faults import Fault
from sim_backend.wire.injector import Injector
from sim_backend.wire.lone_world import LoneWorld, emulate_alone
from sim_backend.wire.timing import BusTiming
from tests.support.servos.coupled_rig import ArmRun
from tests.support.servos.dxl_rig import VirtualPort

MS = 1_000_000
GIVE_UP_NS = 3_000_000_000  # of virtual time, for arms that wait for the start
PHASE_NS = 1_300_000  # of the plant's cycles
READY_NS = 1_500_000_000  # from the last arm's first cycle to the common start


class Seat:
    """One arm's place at the virtual plant."""

    def __init__(self, plant: VirtualPlant, index: int) -> None:
        spec = plant.physics.spec.arms[index]
        self.plant, self.part = plant, plant.physics.slices[index]
        self.line = DelayLine.of(spec.actuator, plant.physics.spec.substep_s, plant.substeps, index)
        self.limits = TorqueCommand.of(spec.actuator)
        self.on = self.limp = False
        self.limp_ns: int | None = None
        self.tau = np.zeros(len(spec.controlled))

    def switch_off(self) -> None:
        """Torque off for good."""
        if not self.limp:
            self.limp, self.limp_ns = True, self.plant.zero_ns + self.plant.tick * self.plant.period_ns
        self.tau = np.zeros_like(self.tau)
        self.line.clear()


class VirtualPlant:
    """The plant in the order of `sim_backend.served.server` in real time, paced by a clock that others move."""

    def __init__(self, cell: Cell, q_start: Sequence[Vector], phase_ns: int) -> None:
        self.physics = build_plant(plant_spec(cell, q_start))
        self.physics.meter_grasps()
        self.substeps = cell.file.simulation.substeps_per_cycle
        self.seats = {arm.name: Seat(self, i) for i, arm in enumerate(cell.arms)}
        self.period_ns, self.phase_ns = cell.period_ns, phase_ns
        self.tick, self.zero_ns = -1, 0  # -1: not started
        self.killed = False
        self.grasps = [np.zeros(self.physics.joint_count)]
        self.reported = self.physics.reported()
        self.seen: list[tuple[int, Observation]] = []
        lines = [s.line for s in self.seats.values()]
        self._parts = stretches(lines, self.substeps)
        self._support = max(line.first_substep for line in lines)
        self._acting = np.zeros(self.physics.joint_count)

    def next_ns(self) -> int:
        """Instant of the next state; soon, while nothing has started."""
        return self.zero_ns + (self.tick + 1) * self.period_ns

    def advance_to(self, now_ns: int) -> None:
        """Let the ticks until then pass."""
        if self.killed:
            return
        if self.tick < 0:
            if all(s.on for s in self.seats.values()):
                self.zero_ns = now_ns + self.phase_ns
                self.tick = 0
            return
        while self.next_ns() <= now_ns:
            self._one_tick()

    def _one_tick(self) -> None:
        for seat in self.seats.values():
            seat.line.push(self.tick, seat.tau)
        for begin, count in self._parts:
            for seat in self.seats.values():
                self._acting[seat.part] = seat.line.acting(self.tick, begin)
            if self.tick * self.substeps + begin < self._support:
                self.physics.rest(count)
            else:
                self.physics.advance(self._acting, count)
        self.tick += 1
        self.reported = self.physics.reported()
        self.grasps.append(self.physics.grasp_torque())
        if self.tick % 2 == 0:
            self.seen.append((self.zero_ns + self.tick * self.period_ns, self.physics.observe(self._acting)))


class VirtualTwin:
    """`sim_backend.hil.guest.Twin` on a virtual plant.

    older_cycles: by which its states come later; lost: share of its commands that do not arrive.
    """

    def __init__(self, seat: Seat, older_cycles: int = 0, lost: float = 0.0) -> None:
        self._chance, self._lost = random.Random(1), lost
        self.ended: Refusal | None = None
        self._seat, self._told, self._pulled = seat, -1, 0
        self._older: list[TwinState] = []
        self._older_cycles = older_cycles

    def connect(self) -> str:
        return "virtual plant"

    def enable(self) -> None:
        self._seat.on = True

    def newest(self) -> TwinState | None:
        plant, part = self._seat.plant, self._seat.part
        if plant.tick == self._told or plant.tick < 0:
            return None
        self._told = plant.tick
        stamp_ns = plant.zero_ns + plant.tick * plant.period_ns
        physics = plant.physics
        ticks = np.array([g[part] for g in plant.grasps[self._pulled :]])
        self._pulled = len(plant.grasps)
        state = TwinState(stamp_ns, physics.q[part], physics.dq[part], ticks[-1], ticks.mean(axis=0))
        self._older.append(state)
        return self._older.pop(0) if len(self._older) > self._older_cycles else None

    def command(self, tau_Nm: Vector) -> None:
        if not self._seat.limp and self._chance.random() >= self._lost:
            self._seat.tau = self._seat.limits(tau_Nm)

    def limp(self) -> None:
        self._seat.switch_off()

    def close(self) -> None: ...


class VirtualSim:
    """A simulated partner's driver, as `SimDriver` in real time."""

    def __init__(self, seat: Seat, arm: Arm, clock: SharedClock) -> None:
        self.counters = BusCounters()
        self.silent = False
        self._seat, self._arm, self._clock, self._told = seat, arm, clock, -1

    def connect(self) -> ArmInfo:
        return ArmInfo(self._arm.name, tuple(self._arm.entry.controlled), self._seat.tau, "virtual")

    def enable(self) -> None:
        self._seat.on = True

    def read(self) -> JointState:
        plant, part = self._seat.plant, self._seat.part
        deadline_ns = self._clock.now_ns() + 50 * MS
        while plant.tick <= self._told or plant.tick < 0 or self.silent:
            now_ns = self._clock.now_ns()
            never = plant.tick < 0 and now_ns > GIVE_UP_NS
            if never or ((self.silent or plant.killed) and now_ns > deadline_ns):
                raise StaleStateError("plant", found="nothing", expected="a state", remedy="none")
            self._clock.sleep_until(max(now_ns + MS // 4, 0))
        self._told = plant.tick
        q, dq, tau = (values[part].copy() for values in plant.reported)
        return JointState(plant.zero_ns + plant.tick * plant.period_ns, q, dq, tau)

    def write(self, tau_Nm: Vector) -> Vector:
        sent = self._seat.limits(tau_Nm)
        if not (self._seat.limp or self.silent):  # servos that say nothing hear nothing: the last torque stays
            self._seat.tau = sent
        return sent

    def health(self) -> ServoHealth:
        return ServoHealth.none(self._clock.now_ns())

    def disable(self) -> None: ...

    def close(self) -> None: ...


class LossyDriver(DynamixelDriver):
    """The real driver on a line that loses a share of the commands."""

    lost = 0.0
    _chance = random.Random(2)

    def write(self, tau_Nm: Vector) -> Vector:
        return tau_Nm if self._chance.random() < self.lost else super().write(tau_Nm)


class Physics:
    """Emulated servos and plant, advanced together; what `SharedClock` takes for a cell."""

    def __init__(self, emulated: EmulatedCell | None, plant: VirtualPlant) -> None:
        self.arms: Any = emulated.arms if emulated is not None else ()
        self.time_ns = 0
        self.watchers: list[Callable[[int], None]] = []
        self.todo: list[tuple[int, Callable[[], None]]] = []
        self._emulated, self._plant = emulated, plant

    def advance_to(self, now_ns: int) -> None:
        while self.todo and self.todo[0][0] <= now_ns:
            self.todo.pop(0)[1]()
        if self._emulated is not None:
            self._emulated.advance_to(now_ns)
        self._plant.advance_to(now_ns)
        for watcher in self.watchers:
            watcher(now_ns)

    def sense(self, arm: Any, now_ns: int) -> None:
        assert self._emulated is not None
        self._emulated.sense(arm, now_ns)


@dataclass
class Hil(ArmRun):
    """What the run of one arm left, and its bridge."""

    bridge: BridgeDriver | None = None


Happening = Callable[["Rehearsal"], None]


class Rehearsal:
    """A run of a cell whose [hil] names the arms in the loop; without the table all are simulated.

    faults and happenings count from the common start.
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
    ) -> None:
        q_start = examine(cell).q_start
        hil = cell.file.hil
        self.real = tuple(hil.arms) if hil is not None else ()
        self.plant = VirtualPlant(cell, q_start, phase_ns)
        self._emulated, self.world = self._lone(cell, q_start)
        self._injectors = [Injector(arm, None, seed=1) for arm in self._emulated.arms] if self._emulated else []
        self._physics = Physics(self._emulated, self.plant)
        self.clock = SharedClock(self._physics, self._injectors, len(cell.arms))
        self.cell, self._faults, self._late = cell, faults, (older_cycles, lost)
        self._happenings = happenings or {}
        self._ready: set[str] = set()
        self.zero_ns: int | None = None
        self.ports: dict[str, VirtualPort] = {}
        self.sims: dict[str, VirtualSim] = {}
        self.arms = {arm.name: Hil() for arm in cell.arms}
        if begin is not None:
            begin(self)
        threads = [
            threading.Thread(target=self._run, args=(arm, q), daemon=True)
            for arm, q in zip(cell.arms, q_start, strict=True)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        for run in self.arms.values():
            if run.error is not None:
                raise run.error

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
        run = self.arms[arm.name]
        self.clock.join()
        try:
            self._loop(run, arm, q_start)
        except BaseException as error:  # noqa: BLE001 - raised again where the run was asked for
            run.error = error
        finally:
            self.clock.leave()

    def _driver(self, run: Hil, arm: Arm, q_start: Vector) -> Any:
        seat = self.plant.seats[arm.name]
        if arm.name not in self.real:
            self.sims[arm.name] = VirtualSim(seat, arm, self.clock)
            return self.sims[arm.name]
        index = next(i for i, a in enumerate(self._emulated.arms) if a.name == arm.name)  # type: ignore[union-attr]
        line = Line(self._physics, index, self._injectors[index], self.clock)
        port = self.ports[arm.name] = VirtualPort(line, arm.baud)
        real = LossyDriver(
            arm_map(self.cell, arm, "virtual", q_start), self.clock, on_event=run.events.append, scan_s=0.05, port=port
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
            heartbeat=lambda: None,
            mode_changed=lambda _: None,
        )
        kind = DriverKind.DYNAMIXEL if arm.name in self.real else DriverKind.SIM
        options: Any = AgentOptions(arm.name, kind, Connection(), None, None, lockstep=False, hold=False)  # type: ignore[arg-type]
        row = AgentRow(run.log.message, arm.n, self.cell.config_id)
        schedule = schedule_of(self.cell, options)
        sink: Any = BridgedRows(run.log, row, driver) if run.bridge is not None else run.log
        run.summary = Runner(build_agent(self.cell, arm), driver, self.clock, schedule, row, sink, around).run()

    def _operator(self) -> Event:
        """Somebody who ends a run that never starts."""
        never = self.plant.tick < 0 and self.clock.now_ns() > GIVE_UP_NS
        return Event.STOP | Event.RELEASED if never else Event.NONE

    def _start(self, arm: str) -> int | None:
        self._ready.add(arm)
        if self.zero_ns is None and len(self._ready) == len(self.arms):
            now_ns = self.clock.now_ns()
            self.zero_ns = now_ns + READY_NS
            for injector in self._injectors:
                mine = [f for f in self._faults if f.arm == injector.arm.name]
                injector.add([f.model_copy(update={"start_s": f.start_s + READY_NS * 1e-9}) for f in mine], now_ns)
            self._physics.todo = [
                (self.zero_ns + round(t * 1e9), lambda happen=happen: happen(self))  # type: ignore[misc]
                for t, happen in sorted(self._happenings.items())
            ]
        return self.zero_ns

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
