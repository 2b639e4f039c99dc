"""The singular value that a check judges is the one below which an agent holds."""

from __future__ import annotations

import pytest

import configs
from agent.config.cell import load_cell
from agent.control import joint_hold
from agent.verify.path import along_trajectory, start_configurations


@pytest.mark.parametrize("name", ["paper", "two_wx200", "three_wx250s"])
def test_a_path_is_judged_by_the_bound_that_its_agents_see(name: str) -> None:
    cell = load_cell(configs.CELLS_DIR / f"{name}.toml")
    models = [cell.model(arm) for arm in cell.arms]
    starts = start_configurations(cell, models)
    instants = [0.0, 0.1, 0.2]
    for arm, model, q in zip(cell.arms, models, starts, strict=True):
        path = along_trajectory(cell, arm, model, q, instants)
        seen = [joint_hold.sigma_min(model, q) for q in path.q]
        assert path.sigma_min == pytest.approx(min(seen), rel=1e-12)
        assert path.sigma_min_t == instants[seen.index(min(seen))]
