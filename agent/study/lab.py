"""A simulated cell in one process: its plant, and `agent.loop.step` and monitors of each arm, no sockets and no log.

Order of events, support at the start, clocks and delays are those of a lockstep run, and so is the motion, bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from agent.config import monitors
from agent.config.cell import Cell
from agent.config.schema.fault import NS, Fault, FaultKind
from agent.config.schema.reality import Reality
from agent.control.memory import Memory
from agent.control.quaternion import Quat, Vec3
from agent.loop import Agent, Outcome, explained, initial_memory, step
from agent.modes import Event, Mode, next_mode
from agent.monitors.watch import Watch
from agent.process.build import build_agent
from agent.process.simulated import plant_spec
from agent.runner import TROUBLE
from agent.safety import Flag
from agent.standing import wait_here
from agent.transition import entered
from agent.verify.check import start_configurations
from drivers.interface import JointState, ServoHealth, Vector
from sim_backend.physics.actuator import TorqueCommand
from sim_backend.physics.build import AnyPlant, build_plant
from sim_backend.physics.delay import DelayLine, stretches
from sim_backend.physics.snapshot import Observation
from sim_backend.physics.spec import PlantSpec

_TROUBLE: Final = int(TROUBLE)  # asking a flag for another one takes 0.5 µs


class Laboratory:
    """A cell made ready for many runs, whose plants `build` makes.

    Raises Refusal as the cell's models and start poses do.
    """

    def __init__(self, cell: Cell, build: Callable[[PlantSpec], AnyPlant] = build_plant) -> None:
        self.cell, self.build = cell, build
        self.q_start = start_configurations(cell, [cell.model(arm) for arm in cell.arms])
        self.agents: tuple[Agent, ...] = tuple(build_agent(cell, arm) for arm in cell.arms)
        self.bounds = tuple(monitors.bounds_of_all(cell))
        self.stall_Nm = np.concatenate([arm.tau_stall_Nm for arm in cell.arms])


def faults_of(cell: Cell, faults: Sequence[Fault]) -> tuple[Fault, ...]:
    """What befalls the arms in every run of the cell, each fault once: the cell's own, and `faults` of a study."""
    return tuple(dict.fromkeys((*cell.file.simulation.fault, *faults)))


@dataclass(frozen=True)
class Trip:
    """An arm that gave up following the trajectory, by itself."""

    t: float
    arm: str
    flags: Flag
    why: str = ""  # of an unexpected wrench: what may be behind it
    monitor: str = ""  # what the monitor that stopped it says, its name first

    @property
    def by(self) -> str:
        """What stopped the arm: its flags, or its monitor."""
        wrong = self.flags & TROUBLE
        return str(wrong.name) if wrong else self.monitor.partition(":")[0]

    @property
    def told(self) -> str:
        """For a person."""
        words = f"{self.flags.name} {self.why}".rstrip() if self.flags & TROUBLE else self.monitor
        return f"t = {self.t:.3f} s: arm {self.arm} {words}"


class Place:
    """One arm of a run: its agent, what it remembers, and its torque on the way."""

    def __init__(
        self, agent: Agent, joints: slice, command: TorqueCommand, line: DelayLine, skew_ns: int, watch: Watch
    ) -> None:
        self.agent, self.joints, self.line = agent, joints, line
        self.watch: Watch | None = watch
        self.said = ""  # by the monitor that stopped it
        self.mode = Mode.TRACK
        self.memory: Memory = initial_memory(agent)
        self.outcome: Outcome | None = None  # of the last cycle
        self.limp = self.open = False  # by a fault: its servos, its gripper
        self._q: Vector = np.zeros(agent.model.n)  # reported in the last cycle
        self._command = command
        self._skew_ns = skew_ns

    def cycle(self, stamp_ns: int, zero_ns: int, reported: Vector, happened: Event) -> Vector:
        """One cycle as `agent.runner` does it; the torque that its servos are told.  reported: (3, J)."""
        q, dq, tau = (values[self.joints] for values in reported)
        self._q = q
        if self.limp:
            return np.zeros(self.agent.model.n)
        state = JointState(stamp_ns + self._skew_ns, q, dq, tau)
        if self.mode is not Mode.TRACK and self.memory.hold is None:
            self.memory = wait_here(self.agent, state.q, self.memory)
        outcome = step(self.agent, state, (state.stamp_ns - zero_ns) * NS, self.mode, self.memory)
        self.memory, self.outcome = outcome.memory, outcome
        if self.watch is not None:
            said = self.watch.after(state, outcome, self.mode, lambda: ServoHealth.none(stamp_ns))
            if said:
                self.said = said
                happened |= Event.TROUBLE
        if int(outcome.flags) & _TROUBLE:
            happened |= Event.TROUBLE
        if happened:
            self._change_mode(happened, outcome)
        return self._command(outcome.tau)

    def sees(self) -> tuple[Vec3, Quat] | None:
        """Where the arm's joints say that the object is, as of its last cycle; None where they say nothing of it."""
        if self.open:
            return None
        if self.limp:  # no law has worked with what its servos report
            k = self.agent.model.evaluate(self._q, np.zeros_like(self._q))
        elif self.outcome is None or self.outcome.terms is None:
            return None
        else:
            k = self.outcome.terms.kinematics
        return k.p_object, k.quat_object

    def _change_mode(self, happened: Event, outcome: Outcome) -> None:
        before, self.mode = self.mode, next_mode(self.mode, happened)
        if self.mode is before:
            return
        self.memory = entered(self.agent, self.mode, self.memory, outcome)


class Run:
    """One run of a laboratory's cell in one reality, tick by tick."""

    def __init__(self, lab: Laboratory, reality: Reality | None, faults: Sequence[Fault] = ()) -> None:
        """reality None: as the cell file says; faults: beside the cell's own.  Raises PlantError, ConfigError."""
        file = lab.cell.file
        self.plant = lab.build(plant_spec(lab.cell, lab.q_start, reality, faults))
        self.period_ns = lab.cell.period_ns
        self.ready_ticks = round(file.simulation.ready_s * file.rate_hz)
        self.tick = 0
        self.trips: list[Trip] = []
        self.faults = faults_of(lab.cell, faults)
        self.peak_Nm = np.zeros(self.plant.joint_count)  # largest torque sent so far
        spec, self._substeps = self.plant.spec, file.simulation.substeps_per_cycle
        self.places = []
        each = zip(lab.agents, spec.arms, self.plant.slices, lab.bounds, strict=True)
        for i, (agent, arm, joints, bounds) in enumerate(each):
            line = DelayLine.of(arm.actuator, spec.substep_s, self._substeps, i)
            skew_ns, watch = round(arm.skew_s * 1e9), Watch(bounds)
            place = Place(agent, joints, TorqueCommand.of(arm.actuator), line, skew_ns, watch)
            place.mode = Mode.READY if self.ready_ticks else Mode.TRACK
            self.places.append(place)
        self._parts = stretches([p.line for p in self.places], self._substeps)
        self._support = max(p.line.first_substep for p in self.places)
        self._tau = np.zeros(self.plant.joint_count)
        self._due = sorted(self.faults, key=lambda fault: -fault.at_s)

    @property
    def t(self) -> float:
        """Time of the next tick on the trajectory's clock, s; negative while the arms wait for the common start."""
        return (self.tick - self.ready_ticks) * self.period_ns * NS

    def observe(self) -> Observation:
        """The truth at the beginning of the next tick."""
        return self.plant.observe(self._acting(0))

    def advance(self) -> None:
        """One tick.  Raises PlantError once the motion is not finite any more, TorqueCommandError for such a torque."""
        requests = self._strike()
        reported, stamp_ns = self.plant.reported(), self.tick * self.period_ns
        zero_ns = self.ready_ticks * self.period_ns
        for place in self.places:
            happened, before = requests.get(place.agent.name, Event.NONE), place.mode
            if before is Mode.READY and stamp_ns + self.period_ns >= zero_ns:
                happened |= Event.STARTED
            tau = place.cycle(stamp_ns, zero_ns, reported, happened)
            if place.mode is Mode.HOLD and before is not Mode.HOLD and Event.STOP not in happened:
                assert place.outcome is not None
                why = explained(place.agent, place.outcome)
                self.trips.append(Trip(self.t, place.agent.name, place.outcome.flags, why, place.said))
            place.line.push(self.tick, tau)
            peak = self.peak_Nm[place.joints]
            np.maximum(peak, np.abs(tau), out=peak)
        for begin, count in self._parts:
            if self.tick * self._substeps + begin < self._support:
                self.plant.rest(count)
            else:
                self.plant.advance(self._acting(begin), count)
        self.tick += 1

    def _acting(self, substep: int) -> Vector:
        for place in self.places:
            self._tau[place.joints] = place.line.acting(self.tick, substep)
        return self._tau

    def _strike(self) -> dict[str, Event]:
        """Let happen to the agents what is due, for the plant has a calendar; requests of operators by arm."""
        requests, cycle = {}, self.tick - self.ready_ticks
        while self._due and self._due[-1].cycle(self.period_ns) <= cycle:
            fault = self._due.pop()
            struck = next(p for p in self.places if p.agent.name == fault.arm)
            if fault.kind is FaultKind.HOLD:
                requests[fault.arm] = Event.STOP
            elif fault.kind is FaultKind.LIMP:
                struck.limp = True
            elif fault.kind is FaultKind.OPEN:
                struck.open = True
        return requests
