"""How near arms come that go their ways at times of their own: no more than the truth, and refused where they meet."""

from __future__ import annotations

import numpy as np
import pytest

import configs
from agent.config.cell import Cell, load_cell
from agent.verify.check import examine, start_configurations
from agent.verify.collision.scene import Scene
from agent.verify.collision.way import Way
from agent.verify.finding import Finding, Verdict
from agent.verify.session import lives
from agent.verify.ways import NEAR_ENOUGH, _opening, nearest, ways

SESSION = "session.lift_m=0.02"
BETWEEN, ALONE = "distance of the arms, each anywhere between rest and grasp", "distance of the arm to itself, object"


def cell_of(name: str, *overrides: str) -> Cell:
    return load_cell(configs.CELLS_DIR / f"{name}.toml", [SESSION, *overrides])


def scene_of(cell: Cell) -> Scene:
    return Scene(cell, [cell.model(arm) for arm in cell.arms])


def found(cell: Cell) -> list[Finding]:
    """Of the ways alone; the motion is its start."""
    models = [cell.model(arm) for arm in cell.arms]
    paths = [[q] for q in start_configurations(cell, models)]
    return ways(cell, models, Scene(cell, models), lives(cell), paths, [0.0])


OUT, FOLDED = np.array([0.14, 0.36, -0.45]), np.array([-1.88, 1.5, 0.8])


def swung(cell: Cell, scene: Scene, i: int, *, back: bool, places: int) -> Way:
    """Arm i folds from far out over the other one's side and stays so, or unfolds after a wait."""
    parts = np.clip(2.0 * np.linspace(0.0, 1.0, places), 0.0, 1.0)
    path = [OUT + part * (FOLDED - OUT) for part in parts]
    return scene.alone(i, path[::-1] if back else path, cell.T_world_object_start)


def every(first: Way, second: Way, pairs: list[tuple[int, int]]) -> float:
    """The least distance over all places of one and all of the other, by trying them."""
    least = np.inf
    for k in range(len(second.p)):
        R, p = first.R.copy(), first.p.copy()
        for _, b in pairs:
            R[:, b], p[:, b] = second.R[k, b], second.p[k, b]
        least = min(least, float(Way(first.shapes, R, p).distances(pairs).min()))
    return least


def test_arms_that_never_meet_at_one_time_meet_at_times_of_their_own() -> None:
    cell = cell_of("two_wx200")
    scene = scene_of(cell)
    pairs = scene.between(0, 1)
    left, right = (swung(cell, scene, i, back=i == 1, places=33) for i in (0, 1))
    together = min(every(_place(left, k), _place(right, k), pairs) for k in range(33))
    apart = nearest(left, right, pairs, margin_m=0.005)
    assert together > 0.01
    assert apart is not None
    assert apart.distance_m < 0.0
    assert apart.at[0] < 0.3  # left is far out at the beginning of its way, right at the end of its own
    assert apart.at[1] > 0.7


def _place(way: Way, k: int) -> Way:
    """One of its places."""
    return Way(way.shapes, way.R[k : k + 1], way.p[k : k + 1])


@pytest.mark.parametrize("lift_rad", [0.25, pytest.param(0.6, marks=pytest.mark.long)])
def test_what_is_reported_is_below_the_truth_and_not_far_below(lift_rad: float) -> None:
    cell = cell_of("two_wx200")
    scene = scene_of(cell)
    pairs = scene.between(0, 1)
    start = start_configurations(cell, scene._models)
    paths = [[q + s * np.array([-lift_rad, lift_rad, 0.3]) for s in np.linspace(0.0, 1.0, 33)] for q in start]
    first, second = (scene.alone(i, path, cell.T_world_object_start) for i, path in enumerate(paths))
    met, truth = nearest(first, second, pairs, margin_m=0.0), every(first, second, pairs)
    assert met is not None
    assert NEAR_ENOUGH * truth <= met.distance_m <= truth + 1e-9
    assert truth > 0.0


@pytest.mark.parametrize("name", ["two_wx200", "three_wx250s"])
def test_shipped_cells_have_ways_that_are_free(name: str) -> None:
    cell = cell_of(name, "table.z_m=0.0")
    findings = found(cell)
    assert [f.line for f in findings if f.verdict is not Verdict.OK] == []
    arms = len(cell.arms)
    assert sum(f.what == BETWEEN for f in findings) == arms * (arms - 1) // 2
    assert sum(f.what.startswith(ALONE) for f in findings) == arms


def test_a_cell_without_a_session_has_no_ways() -> None:
    cell = load_cell(configs.CELLS_DIR / "two_wx200.toml")
    assert found(cell) == []


def test_a_gripper_that_comes_from_within_the_object_is_refused_and_check_asks() -> None:
    cell = cell_of("two_wx200", "session.back_off_m=0.004", "safety.collision_margin_m=0.012")
    refused = [f for f in examine(cell, thorough=True).findings if f.verdict is Verdict.REFUSED]
    assert any(f.what.startswith(ALONE) and "object" in f.found for f in refused)


def test_links_that_lie_at_each_other_at_rest_may_open_and_not_press() -> None:
    cell = cell_of("three_wx250s")
    scene = scene_of(cell)
    path = lives(cell)[0].path
    joints = [path.at(t).q for t in np.linspace(0.0, 0.2 * path.seconds, 9)]
    way, shut = (scene.alone(0, along, cell.T_world_object_start) for along in (joints, joints[::-1]))
    lying = [pair for pair, at_rest in zip(scene.itself(0), way.first(scene.itself(0)), strict=True) if at_rest < 5e-3]
    assert lying
    opens, presses = _opening(scene, 0, way, lying), _opening(scene, 0, shut, lying)
    assert opens.verdict is Verdict.OK
    assert presses.verdict is Verdict.REFUSED
