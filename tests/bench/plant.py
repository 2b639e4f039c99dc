"""How long one substep of the plant takes, every servo effect on, beside pinocchio's own solve of the same chain."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin

import configs
from agent.config.cell import load_cell
from agent.process.simulated import actuator_spec, plant_spec
from agent.verify.check import examine
from sim_backend.physics.plant import Plant
from sim_backend.physics.soft import SoftPlant
from sim_backend.physics.spec import GraspSpec
from tests.bench.common import Figure, median_us
from tests.support.plant.plant_cells import spatial_cell

SPATIAL = (2, 3, 4, 8, 12)
GROWTH = "plant_step_6dof_8_of_3"
SOFT = "plant_step_soft_planar_2"
NAMES = (SOFT, "plant_step_planar_2", *(f"plant_step_6dof_{n}" for n in SPATIAL), GROWTH)
SUBSTEPS, ROUNDS = 50, 61


def bench() -> dict[str, Figure]:
    """Median µs per substep; baseline: the `lcaba` call alone.  `8_of_3`: eight arms, and three as the baseline.

    All cells are measured in turn in each round, so that a busy machine slows them alike.
    """
    cell = load_cell(configs.CELLS_DIR / "paper.toml")
    wrist = actuator_spec(cell, cell.arms[0])
    servos = type(wrist).of(
        6, delay_s=0.005, tau_max_Nm=4.0, torque_lsb_Nm=0.005, stall_Nm=4.1, no_load_rad_s=4.8,
        coulomb_Nm=0.08, viscous_Nms_rad=0.03, position_lsb_rad=0.0015, velocity_lsb_rad_s=0.024,
    )  # fmt: skip
    plants = {"plant_step_planar_2": Plant(plant_spec(cell, examine(cell).q_start))}
    plants |= {f"plant_step_6dof_{n}": Plant(spatial_cell(n, servos)) for n in SPATIAL}
    rounds: dict[str, list[tuple[float, float]]] = {name: [] for name in plants}
    timers = {name: (_step(plant), _bare(plant)) for name, plant in plants.items()}
    for _ in range(ROUNDS):
        for name, (step, bare) in timers.items():
            rounds[name].append((median_us(step, 1, 1) / SUBSTEPS, median_us(bare, SUBSTEPS, 1)))
    figures = {name: _paired(taken) for name, taken in rounds.items()}
    eight, three = ([step for step, _ in rounds[f"plant_step_6dof_{n}"]] for n in (8, 3))
    return figures | {GROWTH: _paired(list(zip(eight, three, strict=True))), SOFT: _soft(plants["plant_step_planar_2"])}


def _soft(welded: Plant) -> Figure:
    """The same cell on pads; baseline: its welded plant in the same rounds."""
    soft = SoftPlant(replace(welded.spec, grasp=GraspSpec(1e4, 50.0)))
    tau, q, T, v = np.zeros(soft.joint_count), soft.q, soft.T_world_object, np.zeros(soft.joint_count + 6)

    def step() -> None:
        soft._q, soft._T, soft._behind = q, T, False
        soft.set_velocity(v)
        soft.advance(tau, SUBSTEPS)

    timers = (step, _step(welded))
    rounds = [tuple(median_us(timer, 1, 1) / SUBSTEPS for timer in timers) for _ in range(ROUNDS)]
    return _paired([(a, b) for a, b in rounds])


def _step(plant: Plant) -> Callable[[], None]:
    """Fifty substeps from the start pose, falling: so every call meets the same states."""
    tau, q, v = np.zeros(plant.joint_count), plant._q, np.zeros(plant._chain.model.nv)

    def step() -> None:
        plant._q = q
        plant.set_velocity(v)
        plant.advance(tau, SUBSTEPS)

    return step


def _bare(plant: Plant) -> Callable[[], object]:
    """The solver's call at the state in which `_step` ends."""
    _step(plant)()
    chain, q, v, tau = plant._chain, plant._q_mid, plant._v.copy(), plant._tau.copy()
    model, data, grasps, states, proximal = chain.model, chain.data, chain.grasps, chain.states, chain.proximal
    return lambda: pin.lcaba(model, data, q, v, tau, grasps, states, proximal)


def _paired(rounds: list[tuple[float, float]]) -> Figure:
    value, baseline = (statistics.median(column) for column in zip(*rounds, strict=True))
    return Figure(value, "µs", baseline, statistics.median(a / b for a, b in rounds))
