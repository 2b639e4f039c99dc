"""What the plant is told of an arm's servos: their own figures, each as far as the cell switches it on."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from agent.config.cell import load_cell
from agent.process.simulated import actuator_spec

REV_PER_MIN_RAD_S = 2.0 * math.pi / 60.0
GRIDS = {"position_quantisation": "position_lsb_rad", "velocity_quantisation": "velocity_lsb_rad_s"}


def test_measured_positions_and_velocities_are_as_fine_as_those_of_the_servos() -> None:
    """A turn of 4096 steps and 0.229 rev/min, as the makers of the servos state them."""
    cell = load_cell(Path("paper"))
    for arm in cell.arms:
        spec = actuator_spec(cell, arm)
        assert spec.position_lsb_rad == pytest.approx(2.0 * math.pi / 4096, rel=1e-12)
        assert spec.velocity_lsb_rad_s == pytest.approx(0.229 * REV_PER_MIN_RAD_S, rel=1e-12)


@pytest.mark.parametrize("off", GRIDS)
def test_a_grid_that_the_cell_switches_off_is_none_and_the_other_stays(off: str) -> None:
    cell = load_cell(Path("paper"), [f"simulation.effects.{off}=false"])
    spec = actuator_spec(cell, cell.arms[0])
    assert {name: getattr(spec, name) > 0.0 for name in GRIDS.values()} == {
        name: effect != off for effect, name in GRIDS.items()
    }
