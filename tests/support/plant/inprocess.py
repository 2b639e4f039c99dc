"""A simulated cell in one process: the real plant and the real `step` of each agent, without sockets or a log.

For properties that need a closed loop and no processes; the order of events is that of the lockstep server.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from agent.config.cell import Cell
from agent.control.memory import Memory
from agent.control.quaternion import angle_between
from agent.loop import Agent, Outcome, initial_memory, step
from agent.modes import Mode
from agent.process.build import build_agent
from agent.process.simulated import plant_spec
from drivers.interface import JointState, Vector
from sim_backend.physics.actuator import Grid, TorqueCommand
from sim_backend.physics.build import build_plant
from sim_backend.physics.delay import DelayLine, stretches
from sim_backend.physics.snapshot import Observation
from tests.support.starts import start_joints


@dataclass
class History:
    """What happened, one entry per tick."""

    t: list[float] = field(default_factory=list)
    e_p_m: list[float] = field(default_factory=list)
    attitude_rad: list[float] = field(default_factory=list)
    tau: list[Vector] = field(default_factory=list)
    V: list[float] = field(default_factory=list)
    q_measured: list[Vector] = field(default_factory=list)  # of all arms
    tau_sent: list[Vector] = field(default_factory=list)
    end: Observation | None = None  # the truth after the last tick

    def after(self, t_s: float) -> tuple[float, float]:
        """Largest position (m) and attitude error (rad) from t_s on."""
        late = np.array(self.t) >= t_s
        return float(np.array(self.e_p_m)[late].max()), float(np.array(self.attitude_rad)[late].max())

    def chatter(self, t_s: float) -> float:
        """Mean |Δτ| per tick from t_s on, N·m."""
        late = np.array(self.t) >= t_s
        return float(np.abs(np.diff(np.array(self.tau)[late], axis=0)).mean())


def simulate(
    cell: Cell,
    duration_s: float,
    *,
    agents_cell: Cell | None = None,
    watch: Callable[[int, list[Outcome]], None] | None = None,
    push_world: Mapping[int, Vector] | None = None,
    see: Callable[[float, Observation], None] | None = None,
) -> History:
    """Closed loop of `cell` for duration_s.

    agents_cell: what the agents believe, when it differs from the plant's; push_world: by tick, the wrench (6,) on the
    object from then on; see: is told time and truth at the end of every tick.
    """
    q_start = start_joints(cell)
    plant = build_plant(plant_spec(cell, q_start))
    believed = agents_cell or cell
    agents: list[Agent] = [build_agent(believed, arm) for arm in believed.arms]
    specs = [a.actuator for a in plant.spec.arms]
    substeps = cell.file.simulation.substeps_per_cycle
    lines = [DelayLine(s.delay_s, plant.spec.substep_s, substeps, s.joint_count) for s in specs]
    commands = [TorqueCommand.of(s) for s in specs]
    q_grids = [Grid(np.full(s.joint_count, s.position_lsb_rad)) for s in specs]
    dq_grids = [Grid(np.full(s.joint_count, s.velocity_lsb_rad_s)) for s in specs]
    memories: list[Memory] = [initial_memory(a) for a in agents]
    history, trajectory = History(), cell.trajectory()
    for tick in range(round(duration_s * cell.file.rate_hz)):
        t = tick * cell.period_ns * 1e-9
        if push_world is not None and tick in push_world:
            plant.push(push_world[tick])
        desired, T = trajectory.at(t), plant.T_world_object
        x, y, z, w = pin.Quaternion(T.rotation).coeffs().tolist()
        history.t.append(t)
        history.e_p_m.append(float(np.linalg.norm(T.translation - np.array(desired.p))))
        history.attitude_rad.append(angle_between((w, x, y, z), desired.quat))
        q, dq = plant.q, plant.dq
        outcomes, measured, sent = [], [], []
        for i, agent in enumerate(agents):
            part = plant.slices[i]
            state = JointState(
                tick * cell.period_ns, q_grids[i](q[part]), dq_grids[i](dq[part]), np.zeros(agent.model.n)
            )
            outcome = step(agent, state, t, Mode.TRACK, memories[i])
            memories[i] = outcome.memory
            outcomes.append(outcome)
            measured.append(state.q)
            sent.append(commands[i](outcome.tau))
            lines[i].push(tick, sent[i])
        history.tau.append(np.concatenate([o.tau for o in outcomes]))
        history.q_measured.append(np.concatenate(measured))
        history.tau_sent.append(np.concatenate(sent))
        history.V.append(sum(o.terms.lyapunov for o in outcomes if o.terms is not None))
        if watch is not None:
            watch(tick, outcomes)
        for begin, count in stretches(lines, substeps):
            acting = np.concatenate([line.acting(tick, begin) for line in lines])
            plant.advance(acting, count)
        if see is not None:
            see(t, plant.observe(acting))
    history.end = plant.observe(acting)
    return history
