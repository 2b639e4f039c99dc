"""Cells whose file gives their grasps pads: the keys reach every plant, and the loop feels them."""

from __future__ import annotations

import pytest

import configs
from agent.config.cell import Cell, load_cell
from agent.process.simulated import plant_spec
from drivers.interface import Refusal
from sim_backend.physics.build import build_plant
from sim_backend.physics.plant import Plant
from sim_backend.physics.soft import SoftPlant
from sim_backend.physics.spec import GraspSpec, PlantError
from sim_backend.wire.plant_world import emulate
from tests.support.plant.inprocess import simulate
from tests.support.starts import start_joints

PADS = ("simulation.grasp.stiffness_N_per_m=1e4", "simulation.grasp.stiffness_Nm_per_rad=50.0")
SOFTER = (
    "controller.k_p_per_s=100.0",
    "controller.k_eps_rad_per_s=60.0",
    "controller.k_p_rate_per_s=70.0",
    "controller.k_eps_rate_rad_per_s=42.0",
    "arms.left.k_v_N_s_per_m=1.5",
    "arms.left.k_v_Nm_s_per_rad=0.1",
    "arms.right.k_v_N_s_per_m=1.5",
    "arms.right.k_v_Nm_s_per_rad=0.1",
)


def paper(*overrides: str) -> Cell:
    return load_cell(configs.CELLS_DIR / "paper.toml", list(overrides))


def test_grasp_keys_reach_the_plant_of_lockstep_and_of_emulated_servos() -> None:
    cell = paper(
        *PADS,
        "simulation.grasp.damping_ratio=0.4",
        "simulation.grasp.slip_N=9.0",
        "simulation.grasp.slip_Nm=0.5",
        "simulation.grasp.open_m=0.01",
    )
    spec = plant_spec(cell, start_joints(cell))
    assert spec.grasp == GraspSpec(1e4, 50.0, 0.4, 9.0, 0.5, 0.01)
    assert isinstance(build_plant(spec), SoftPlant)
    _, world = emulate(spec, [], timing=None)
    assert isinstance(world.plant, SoftPlant)


def test_grasps_of_shipped_cells_are_welded() -> None:
    for path in sorted(configs.CELLS_DIR.glob("*.toml")):
        assert load_cell(path).file.simulation.grasp is None
    cell = paper()
    assert isinstance(build_plant(plant_spec(cell, start_joints(cell))), Plant)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("simulation.grasp.stiffness_N_per_m=1.0", "stiffness_N_per_m"),
        ("simulation.grasp.damping_ratio=-1.0", "damping_ratio"),
        ("simulation.grasp.open_m=0.01", "slip_N"),
    ],
)
def test_impossible_pads_are_refused(override: str, message: str) -> None:
    with pytest.raises(Refusal, match=message):
        paper(*PADS, override)


def test_printed_gains_lose_the_object_on_pads_and_softer_gains_keep_it() -> None:
    """Findings on reality: stable when welded is not stable on pads."""
    assert simulate(paper(), 1.0).after(0.5)[0] < 1e-3
    try:
        lost = simulate(paper(*PADS), 1.0).after(0.5)[0] > 0.02
    except PlantError:
        lost = True
    assert lost
    assert simulate(paper(*PADS, *SOFTER), 1.0).after(0.5)[0] < 2e-3
