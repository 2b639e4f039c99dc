"""How long one substep of the plant takes, every servo effect on, beside pinocchio's own solve of the same chain."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

import configs
from agent.config.cell import load_cell
from agent.process.simulated import actuator_spec, plant_spec
from agent.verify.check import examine
from sim_backend.physics.plant import Plant
from tests.bench.common import Figure, median_us
from tests.support.plant.plant_cells import spatial_cell

SPATIAL = (2, 3, 4, 8)
NAMES = ("plant_step_planar_2", *(f"plant_step_6dof_{n}" for n in SPATIAL))
SUBSTEPS = 100


def bench() -> dict[str, Figure]:
    """Median µs per substep; baseline: the constraintDynamics call alone, in the same run."""
    cell = load_cell(configs.CELLS_DIR / "paper.toml")
    figures = {"plant_step_planar_2": _figure(Plant(plant_spec(cell, examine(cell).q_start)))}
    wrist = actuator_spec(cell, cell.arms[0])
    servos = type(wrist).of(
        6, delay_s=0.005, tau_max_Nm=4.0, torque_lsb_Nm=0.005, stall_Nm=4.1, no_load_rad_s=4.8,
        coulomb_Nm=0.08, viscous_Nms_rad=0.03, position_lsb_rad=0.0015, velocity_lsb_rad_s=0.024,
    )  # fmt: skip
    for count in SPATIAL:
        figures[f"plant_step_6dof_{count}"] = _figure(Plant(spatial_cell(count, servos)))
    return figures


def _figure(plant: Plant) -> Figure:
    tau = np.zeros(plant.joint_count)
    step = median_us(lambda: plant.advance(tau, SUBSTEPS), 1, 15) / SUBSTEPS
    chain = plant._chain
    model, data, q = chain.model, chain.data, plant._q
    v, full = np.zeros(model.nv), np.zeros(model.nv)
    bare = median_us(
        lambda: pin.constraintDynamics(model, data, q, v, full, chain.grasps, chain.forces, chain.proximal), 200, 15
    )
    return Figure(step, "µs", bare)
