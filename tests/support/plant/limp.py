"""A simulated cell in which one arm goes limp and the others hold, some time after; for what statics say of it."""

from __future__ import annotations

import numpy as np

from agent.config.cell import Cell
from agent.loop import initial_memory, step
from agent.modes import Mode
from agent.process.build import build_agent
from agent.process.simulated import plant_spec
from agent.standing import hold_after
from drivers.interface import JointState, Vector
from sim_backend.physics.build import build_plant
from tests.support.starts import start_joints


def sag_of_limp(cell: Cell, limp: int, at_s: float, *, noticed_s: float = 0.1, for_s: float = 1.5) -> float:
    """Largest way (m) of the object from its desired place when arm `limp` gives no torque from at_s on.

    The servos' own effects but delay are left out; commands act one cycle late.
    """
    plant = build_plant(plant_spec(cell, start_joints(cell)))
    agents = [build_agent(cell, arm) for arm in cell.arms]
    memories, acting = [initial_memory(a) for a in agents], np.zeros(plant.joint_count)
    holding, away, place = False, 0.0, np.zeros(3)
    fault, end = (round(t * cell.file.rate_hz) for t in (at_s, at_s + for_s))
    for tick in range(end):
        t = tick / cell.file.rate_hz
        coming: list[Vector] = []
        for i, agent in enumerate(agents):
            part = plant.slices[i]
            state = JointState(tick * cell.period_ns, plant.q[part], plant.dq[part], np.zeros(agent.model.n))
            mode = Mode.HOLD if holding else Mode.TRACK
            outcome = step(agent, state, t, mode, memories[i])
            memories[i] = outcome.memory
            if not holding and tick >= fault + noticed_s * cell.file.rate_hz:
                memories[i] = hold_after(agent, outcome)
            coming.append(outcome.tau * (i != limp or tick < fault))
        if tick == fault:
            place = plant.T_world_object.translation.copy()
        holding = holding or tick >= fault + noticed_s * cell.file.rate_hz
        plant.advance(acting, cell.file.simulation.substeps_per_cycle)
        acting = np.concatenate(coming)
        if holding:
            away = max(away, float(np.linalg.norm(plant.T_world_object.translation - place)))
    return away
