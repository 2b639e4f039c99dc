"""Two arms on one object that see it elsewhere: what alignment makes of the force between them, and what is noticed."""

from __future__ import annotations

import numpy as np
import pytest

import configs
from agent.config.cell import Cell, load_cell
from agent.loop import Outcome
from agent.safety import Flag
from sim_backend.physics.snapshot import Observation
from tests.support.plant.inprocess import simulate

ARMS = ("arms.right.p_world_base_m=[0.607, -0.125, 0.0]",)  # what the agents believe: a base 4 mm off
STILL = ("object.p_start_m=[0.3, 0.12, 0.0]", "trajectory.p_amplitude_m=[0.0, 0.0, 0.0]", "trajectory.angle_rad=0.0")
ALIGNED = (
    "controller.alignment.enabled=true",
    "controller.alignment.track_per_s=0.6",
    "controller.alignment.dead_zone_m=0.7e-3",
)
NOTICING = ("safety.noticing.enabled=true", "safety.noticing.fast_N=2.0")


def paper(*overrides: str) -> Cell:
    return load_cell(configs.CELLS_DIR / "paper_ideal.toml", [*STILL, *overrides])


def squeeze(aligned: bool, duration_s: float) -> tuple[float, float]:
    """Force between the arms at the end (N), and how far the second arm shifted (m)."""
    extra = ALIGNED if aligned else ()
    shifts: list[float] = [0.0]

    def watch(_tick: int, outcomes: list[Outcome]) -> None:
        shifts[0] = float(np.linalg.norm(outcomes[1].memory.shift[:3]))

    end = simulate(paper(), duration_s, agents_cell=paper(*extra, *ARMS), watch=watch).end
    assert end is not None
    return between(end), shifts[0]


def between(seen: Observation) -> float:
    """Force by which two arms press against each other, N."""
    forces = seen.grasp_wrench[:, :3]
    return float(np.linalg.norm(forces[0] - forces[1])) / 2.0


def test_alignment_takes_the_force_out_of_a_disagreement() -> None:
    """Who does not align presses with the same force all the time."""
    (fought, unmoved), (together, shift) = squeeze(False, 2.0), squeeze(True, 5.5)
    assert unmoved == 0.0
    assert shift > 2e-3
    assert together < 0.6 * fought


def adaptive_force(leak: float) -> float:
    """Mean force between two adaptive arms that align, over the last second of 3.3; one base believed 1 mm off."""
    forces: list[float] = []
    path = configs.CELLS_DIR / "paper_adaptive.toml"
    overrides = (f"controller.adaptive.leak_per_s={leak}", "controller.alignment.track_per_s=0.3")
    true, believed = (
        load_cell(path, overrides),
        load_cell(path, [*overrides, "arms.right.p_world_base_m=[0.604, -0.125, 0.0]"]),
    )

    def see(t: float, seen: Observation) -> None:
        if t > 2.3:
            forces.append(between(seen))

    simulate(true, 3.3, agents_cell=believed, see=see)
    return float(np.mean(forces))


def test_a_leak_keeps_adaptive_arms_that_disagree_from_winding_up() -> None:
    assert adaptive_force(2.0) < 0.6 * adaptive_force(0.0)


@pytest.mark.parametrize("wrench", [0.0, 12.0])
@pytest.mark.fault("F5")
def test_a_push_on_the_object_is_noticed_and_nothing_else_is(wrench: float) -> None:
    noticed: list[int] = []

    def watch(tick: int, outcomes: list[Outcome]) -> None:
        if any(Flag.UNEXPECTED in o.flags for o in outcomes):
            noticed.append(tick)

    push = {100: np.array([0.0, -wrench, 0.0, 0.0, 0.0, 0.0])}
    simulate(paper(*NOTICING), 1.0, watch=watch, push_world=push)
    if not wrench:
        assert noticed == []
    else:
        assert 100 < noticed[0] <= 110, "within 50 ms"
