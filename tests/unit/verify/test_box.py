"""The largest wrench by which adaptive arms can press against each other."""

from __future__ import annotations

import numpy as np
import pytest

import configs
from agent.config.cell import Cell, load_cell
from agent.control import adaptive
from agent.control.adaptation import Estimate
from agent.control.trajectory import Desired
from agent.verify import check
from agent.verify.box import largest_internal_wrench, largest_norm
from agent.verify.check import examine, start_configurations
from agent.verify.finding import Verdict
from drivers.interface import Vector

ADAPTIVE = configs.CELLS_DIR / "paper_adaptive.toml"


def found(cell: Cell) -> tuple[float, float]:
    models = [cell.model(arm) for arm in cell.arms]
    return largest_internal_wrench(cell, models, [start_configurations(cell, models)], [0.0])


def test_the_longest_vector_is_that_of_the_best_corner() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        columns, low, high = rng.normal(size=(3, 8)), -rng.uniform(0.0, 1.0, 8), rng.uniform(0.0, 2.0, 8)
        corners = np.where(np.array(list(np.ndindex(*(2,) * 8))) > 0, high, low)
        assert largest_norm(columns, low, high) == pytest.approx(np.linalg.norm(corners @ columns.T, axis=1).max())


def commanded(cell: Cell, estimates: list[Estimate]) -> list[Vector]:
    """Wrench (6,) about the object's centre that each arm commands by its estimate, on the desired motion at rest."""
    wrenches = []
    for arm, estimate in zip(cell.arms, estimates, strict=True):
        model, offline = cell.model(arm), cell.offline(arm)
        q = start_configurations(cell, [cell.model(a) for a in cell.arms])[cell.arms.index(arm)]
        k = model.evaluate(q, np.zeros(model.n))
        still = Desired(k.p_object, k.quat_object, (0.0,) * 6, (0.0,) * 6)
        terms, _ = adaptive.torque(model, offline, offline.adaptation, estimate, q, np.zeros(model.n), still)
        wrenches.append(terms.J_inv_P.T @ (terms.tau_adaptive + terms.tau_object))
    return wrenches


@pytest.mark.parametrize("left", [0.5, 0.1])
def test_estimates_at_corners_of_the_box_press_by_no_more_and_nearly_by_as_much(left: float) -> None:
    """The law itself, for two arms at rest: what one commands beyond its share of both, less that of the truth."""
    shares = (f"arms.left.load_share={left}", f"arms.right.load_share={1.0 - left}", "object.mass_kg=2.0")
    cell = load_cell(ADAPTIVE, ("trajectory.p_amplitude_m=[0.0, 0.0, 0.0]", "trajectory.angle_rad=0.0", *shares))
    force, _ = found(cell)
    data = [cell.offline(arm).adaptation for arm in cell.arms]
    truth = commanded(cell, [d.nominal for d in data])
    rng, largest = np.random.default_rng(4), 0.0
    for _ in range(60):
        sides = rng.normal(size=10)  # a direction of the force decides the corner, so that bodies pull together
        corners = []
        for d, sign in zip(data, (1.0, -1.0), strict=True):
            pick = [np.resize(sign * sides, x.shape) > 0.0 for x in d.nominal]
            corners.append(Estimate(*(np.where(up, h, lo) for up, h, lo in zip(pick, d.upper, d.lower, strict=True))))
        wrenches = [w - t for w, t in zip(commanded(cell, corners), truth, strict=True)]
        largest = max(largest, float(np.linalg.norm((wrenches[0] - left * sum(wrenches))[:3])))
    assert largest <= force * (1.0 + 1e-9)
    assert largest > 0.5 * force


def test_narrower_bounds_allow_less() -> None:
    wide, narrow = (load_cell(ADAPTIVE, (f"controller.adaptive.bounds.relative_max={r}",)) for r in (5.0, 2.0))
    assert found(narrow)[0] < 0.6 * found(wide)[0]


@pytest.mark.parametrize(("leak", "said"), [(0.0, "no leak"), (2.0, "leak 2/s")])
def test_check_says_it_of_an_adaptive_cell(leak: float, said: str) -> None:
    report = examine(load_cell(ADAPTIVE, (f"controller.adaptive.leak_per_s={leak}",)))
    (line,) = (f for f in report.findings if f.what == "internal wrench within the bounds of the estimates")
    assert said in line.found
    assert line.verdict is (Verdict.OK if leak else Verdict.WARNING), "without a leak they drift that far apart"
    assert 10.0 < float(line.found.removeprefix("≤ ").split(" N")[0]) < 60.0


def test_bounds_that_allow_little_need_no_leak() -> None:
    cell = load_cell(ADAPTIVE, ("controller.adaptive.leak_per_s=0.0",))
    verdicts = [check._box(cell, force_N, 9.0).verdict for force_N in (0.99, 1.01)]
    assert verdicts == [Verdict.OK, Verdict.WARNING]
