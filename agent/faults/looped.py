"""The simulated cell of a rehearsal in virtual time: its plant, twins of arms in the loop, and simulated partners.

The plant goes in the order of `sim_backend.served.server` in real time, without sockets.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from agent.config.cell import Arm, Cell
from agent.config.schema.reality import Reality
from agent.process.simulated import plant_spec
from drivers.interface import (
    ArmInfo,
    BusCounters,
    Clock,
    JointState,
    Refusal,
    ServoHealth,
    StaleStateError,
    Vector,
)
from sim_backend.hil.coupling import TwinState
from sim_backend.physics.actuator import TorqueCommand
from sim_backend.physics.build import build_plant
from sim_backend.physics.delay import DelayLine, stretches
from sim_backend.physics.snapshot import Observation
from sim_backend.wire.arm import EmulatedArm
from sim_backend.wire.cell import EmulatedCell

MS: Final = 1_000_000
PHASE_NS: Final = 1_300_000  # of the plant's cycles
GIVE_UP_NS: Final = 3_000_000_000  # of virtual time, for arms that wait for the start
WAIT_NS: Final = 50 * MS  # of a partner for a state
GONE: Final = Refusal("plant", found="a connection that was closed", expected="a state", remedy="see its log")


class Seat:
    """One arm's place at the virtual plant; `limp_ns`: since when its torque is off for good."""

    def __init__(self, plant: VirtualPlant, index: int) -> None:
        spec = plant.physics.spec.arms[index]
        self.plant, self.part = plant, plant.physics.slices[index]
        self.line = DelayLine.of(spec.actuator, plant.physics.spec.substep_s, plant.substeps, index)
        self.limits = TorqueCommand.of(spec.actuator)
        self.on = self.limp = False
        self.limp_ns: int | None = None
        self.tau = self.lasting = np.zeros(len(spec.controlled))

    def orphan(self) -> None:
        """The agent's process is gone: what lasts of its torque stays."""
        if not self.limp:
            self.tau = self.lasting

    def switch_off(self) -> None:
        """Torque off for good."""
        if not self.limp:
            self.limp, self.limp_ns = True, self.plant.zero_ns + self.plant.tick * self.plant.period_ns
        self.tau = np.zeros_like(self.tau)
        self.line.clear()


class VirtualPlant:
    """The plant in the order of `sim_backend.served.server` in real time, paced by a clock that others move."""

    def __init__(
        self, cell: Cell, q_start: Sequence[Vector], phase_ns: int = PHASE_NS, reality: Reality | None = None
    ) -> None:
        """phase_ns: from the last arm's torque to the first cycle; reality: in the place of the cell's own."""
        self.physics = build_plant(plant_spec(cell, q_start, reality))
        self.physics.meter_grasps()
        self.substeps = cell.file.simulation.substeps_per_cycle
        self.seats = {arm.name: Seat(self, i) for i, arm in enumerate(cell.arms)}
        self.period_ns, self.phase_ns = cell.period_ns, phase_ns
        self.tick, self.zero_ns = -1, 0  # -1: not started
        self.killed = False  # it stands still
        self.gone = False  # and all who are connected know it
        self.grasps = [np.zeros(self.physics.joint_count)]
        self.reported = self.physics.reported()
        self.seen: list[tuple[int, Observation]] = []
        lines = [s.line for s in self.seats.values()]
        self._parts = stretches(lines, self.substeps)
        self._support = max(line.first_substep for line in lines)
        self._acting = np.zeros(self.physics.joint_count)

    def observe(self) -> Observation:
        """What is true at the last cycle."""
        return self.physics.observe(self._acting)

    def next_ns(self) -> int:
        """Instant of the next state; soon, while nothing has started."""
        return self.zero_ns + (self.tick + 1) * self.period_ns

    def advance_to(self, now_ns: int) -> None:
        """Let the ticks until then pass."""
        if self.killed or self.gone:
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
            self.seen.append((self.zero_ns + self.tick * self.period_ns, self.observe()))


class VirtualTwin:
    """`sim_backend.hil.guest.Twin` on a virtual plant.

    older_cycles: by which its states come later; lost: share of its commands that do not arrive.
    """

    def __init__(self, seat: Seat, older_cycles: int = 0, lost: float = 0.0) -> None:
        self._chance, self._lost = random.Random(1), lost
        self._seat, self._told, self._pulled = seat, -1, 0
        self._older: list[TwinState] = []
        self._older_cycles = older_cycles

    @property
    def ended(self) -> Refusal | None:
        """Why no state will come any more."""
        return GONE if self._seat.plant.gone else None

    def connect(self) -> str:
        """There is always room."""
        return "virtual plant"

    def enable(self) -> None:
        """The plant starts with the last arm."""
        self._seat.on = True

    def newest(self) -> TwinState | None:
        """The state since the last call."""
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

    def command(self, tau_Nm: Vector, lasting_Nm: Vector) -> None:
        """Torque (n,) from now on, and what stays of it when the agent's process is gone."""
        if not self._seat.limp and self._chance.random() >= self._lost:
            self._seat.tau, self._seat.lasting = self._seat.limits(tau_Nm), self._seat.limits(lasting_Nm)

    def limp(self) -> None:
        """Torque off for good."""
        self._seat.switch_off()

    def close(self) -> None:
        """Nobody waits for it."""


class VirtualSim:
    """A simulated partner's driver, as `SimDriver` in real time; silent: it says nothing and hears nothing."""

    def __init__(self, seat: Seat, arm: Arm, clock: Clock) -> None:
        self.counters = BusCounters()
        self.silent = False
        self._seat, self._arm, self._clock, self._told = seat, arm, clock, -1

    def connect(self) -> ArmInfo:
        """There is always room."""
        return ArmInfo(self._arm.name, tuple(self._arm.entry.controlled), self._seat.tau, "virtual")

    def enable(self) -> None:
        """The plant starts with the last arm."""
        self._seat.on = True

    def read(self) -> JointState:
        """The next state.  Raises StaleStateError where none comes."""
        plant, part = self._seat.plant, self._seat.part
        deadline_ns = self._clock.now_ns() + WAIT_NS
        while plant.tick <= self._told or plant.tick < 0 or self.silent:
            now_ns = self._clock.now_ns()
            never = plant.tick < 0 and now_ns > GIVE_UP_NS
            if never or ((self.silent or plant.killed or plant.gone) and now_ns > deadline_ns):
                raise StaleStateError("plant", found="nothing", expected="a state", remedy="none")
            self._clock.sleep_until(max(now_ns + MS // 4, 0))
        self._told = plant.tick
        q, dq, tau = (values[part].copy() for values in plant.reported)
        return JointState(plant.zero_ns + plant.tick * plant.period_ns, q, dq, tau)

    def write(self, tau_Nm: Vector) -> Vector:
        """Torque (n,) from now on; what of it is taken."""
        sent = self._seat.limits(tau_Nm)
        if not (self._seat.limp or self.silent):  # servos that say nothing hear nothing: the last torque stays
            self._seat.tau = sent
        return sent

    def health(self) -> ServoHealth:
        """There are no servos."""
        return ServoHealth.none(self._clock.now_ns())

    def disable(self) -> None:
        """The plant keeps the last torque, as of an agent that holds to its end."""

    def close(self) -> None:
        """Nobody waits for it."""


class Physics:
    """Emulated servos and plant, advanced together; what `SharedClock` and `Line` take for a cell."""

    def __init__(self, emulated: EmulatedCell | None, plant: VirtualPlant) -> None:
        self.arms: Any = emulated.arms if emulated is not None else ()
        self.time_ns = 0
        self.watchers: list[Callable[[int], None]] = []
        self.todo: list[tuple[int, Callable[[], None]]] = []
        self._emulated, self._plant = emulated, plant

    def advance_to(self, now_ns: int) -> None:
        """Do what is due, then let time pass, then show it."""
        while self.todo and self.todo[0][0] <= now_ns:
            self.todo.pop(0)[1]()
        if self._emulated is not None:
            self._emulated.advance_to(now_ns)
        self._plant.advance_to(now_ns)
        for watcher in self.watchers:
            watcher(now_ns)

    def sense(self, arm: EmulatedArm, now_ns: int) -> None:
        """As of the emulated cell."""
        assert self._emulated is not None
        self._emulated.sense(arm, now_ns)
