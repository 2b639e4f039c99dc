"""What the grasps really carry in closed loop at rest: internal forces and load shares as configured."""

from __future__ import annotations

import numpy as np
import pytest

import configs
from agent.config.cell import load_cell
from agent.control.internal_force import internal_wrenches
from drivers.interface import Vector
from tests.support.plant.inprocess import simulate

AT_REST = ("trajectory.p_amplitude_m=[0.0, 0.0, 0.0]", "trajectory.angle_rad=0.0")
SECONDS = 4.0


def grasp_wrenches(*overrides: str) -> Vector:
    """(2, 6) of each arm on the object at its end effector, world axes, once everything has come to rest."""
    cell = load_cell(configs.CELLS_DIR / "paper_ideal.toml", (*AT_REST, *overrides))
    end = simulate(cell, SECONDS).end
    assert end is not None
    assert float(np.linalg.norm(end.v_object)) < 1e-5
    return end.grasp_wrench


@pytest.mark.parametrize("squeeze_N", [pytest.param(1.0, marks=pytest.mark.long), -0.6])
def test_internal_force_is_realised_within_five_percent(squeeze_N: float) -> None:
    wanted = [[squeeze_N, 0.0, 0.0, 0.0, 0.0, 0.1], [-squeeze_N, 0.0, 0.0, 0.0, 0.0, -0.1]]
    names = ("left", "right")
    moved = (
        grasp_wrenches(*(f"arms.{name}.internal_wrench_N_Nm={w}" for name, w in zip(names, wanted, strict=True)))
        - grasp_wrenches()
    )
    cell = load_cell(configs.CELLS_DIR / "paper_ideal.toml")
    points = [arm.entry.p_object_ee_m for arm in cell.arms]
    expected = np.array(internal_wrenches(points, [tuple(w) for w in wanted]))  # type: ignore[misc]
    np.testing.assert_allclose(moved[:, [0, 1, 5]], expected[:, [0, 1, 5]], atol=0.05 * abs(squeeze_N))


@pytest.mark.parametrize("left_share", [pytest.param(0.5, marks=pytest.mark.long), 0.3])
def test_vertical_load_is_shared_as_configured_within_three_percent(left_share: float) -> None:
    wrenches = grasp_wrenches(f"arms.left.load_share={left_share}", f"arms.right.load_share={1 - left_share}")
    weight = 0.062 * 9.81
    shares = wrenches[:, 1] / weight
    np.testing.assert_allclose(shares, [left_share, 1 - left_share], atol=0.03)
