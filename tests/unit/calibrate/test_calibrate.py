"""Calibration of the closed chain on joint angles made from kinematics, with a truth to compare with."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agent.calibrate.chain import CalibrateError, as_loose_as_told, chain_of
from agent.calibrate.result import Outcome, calibrated
from agent.calibrate.solve import disagreement, explained, rms, solve
from agent.config.cell import load_cell
from drivers.dynamixel.servo.counts import TICK_RAD
from tests.support.calibrate_rig import Rig, reach, rig

SPATIAL, PLANAR = "three_wx250s", "two_wx200"
SEEDS = range(8)


def judged(made: Rig) -> tuple[float, float, float, float]:
    return calibrated(made.cell, made.chain, made.poses).judged


@pytest.mark.parametrize("cell", [SPATIAL, PLANAR])
def test_jacobian_is_the_derivative_of_what_each_arm_sees(cell: str) -> None:
    made = rig(cell, 0, count=3)
    for link, x, q in zip(made.chain.links, made.chain.parts(made.truth), made.poses.q, strict=True):
        seen, step = link.see(x, q), 1e-6
        for i in range(link.size):
            ahead, behind = (link.see(x + sign * step * np.eye(link.size)[i], q) for sign in (1.0, -1.0))
            turn = (ahead.R - behind.R) @ seen.R.transpose(0, 2, 1) / (2.0 * step)
            spin = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
            found = np.concatenate([(ahead.p - behind.p) / (2.0 * step), spin], axis=1)
            np.testing.assert_allclose(seen.by_parameters[:, :, i], found, atol=2e-8)


@pytest.mark.parametrize(
    ("cell", "noise_rad", "bound_m", "bound_rad", "seeds"),
    [
        (SPATIAL, 2e-3, 1.2e-3, 3e-3, SEEDS[:1]), (PLANAR, 0.0, 0.5e-3, 1e-3, SEEDS[:1]),
        pytest.param(SPATIAL, 2e-3, 1.2e-3, 3e-3, SEEDS[1:], marks=pytest.mark.long),
        pytest.param(PLANAR, 0.0, 0.5e-3, 1e-3, SEEDS[1:], marks=pytest.mark.long),
        pytest.param(SPATIAL, 0.0, 0.5e-3, 1e-3, SEEDS, marks=pytest.mark.long),
        pytest.param(PLANAR, 2e-3, 1.2e-3, 3e-3, SEEDS, marks=pytest.mark.long),
    ],
)  # fmt: skip
def test_disagreement_of_held_out_poses_falls_below_the_bounds(
    cell: str, noise_rad: float, bound_m: float, bound_rad: float, seeds: range
) -> None:
    for seed in seeds:
        before_m, after_m, _, after_rad = judged(rig(cell, seed, noise_rad))
        assert before_m > 1e-3
        assert after_m <= bound_m
        assert after_rad <= bound_rad


@pytest.mark.parametrize(
    ("cell", "noise_rad"),
    [
        (PLANAR, 2e-3), pytest.param(PLANAR, 0.0, marks=pytest.mark.long),
        pytest.param(SPATIAL, 0.0, marks=pytest.mark.long), pytest.param(SPATIAL, 2e-3, marks=pytest.mark.long),
    ],
)  # fmt: skip
def test_truth_lies_within_three_standard_errors(cell: str, noise_rad: float) -> None:
    away = []
    for seed in SEEDS:
        made = rig(cell, seed, noise_rad, count=32)
        solution = solve(made.chain, made.poses.some(~made.poses.held_out))
        known = solution.sigma > 0.0
        away.append((solution.x - made.truth)[known] / solution.sigma[known])
    sizes = np.abs(np.concatenate(away))
    assert (sizes <= 3.0).mean() >= 0.99  # of normal errors 0.3 % lie beyond
    assert sizes.max() <= 4.0
    assert 0.8 <= rms(sizes) <= 1.15  # the standard errors are neither too large nor too small


@pytest.mark.parametrize(("name", "parameters", "axes", "seen"), [(SPATIAL, 36, 12, 20), (PLANAR, 18, 6, 8)])
def test_what_no_motion_tells_is_counted(name: str, parameters: int, axes: int, seen: int) -> None:
    """Of two arms 24 parameters in space and 12 in a plane, beside the axes of world and object."""
    made = rig(name, 0, count=24)
    both = replace(
        made.chain, links=tuple(replace(link, scale=np.full(link.size, 0.01)) for link in made.chain.links[:2])
    )
    assert both.size == parameters
    assert solve(both, made.poses.q[:2]).observed == seen
    assert seen <= parameters - axes - 4  # two first zeros, two last ones


def test_unseen_parameters_keep_their_tolerance_and_say_so() -> None:
    made = rig(SPATIAL, 0)
    result = calibrated(made.cell, made.chain, made.poses)
    outcome = {(e.arm, e.name): e.outcome for e in result.estimates()}
    assert outcome["left", "zero of waist"] is Outcome.UNSEEN
    assert outcome["left", "zero of elbow"] is Outcome.MEASURED
    assert outcome["left", "grasp about x"] is Outcome.GIVEN
    assert result.solution.observed == 33
    assert result.free == 45


def test_a_slipped_pose_counts_little() -> None:
    made = rig(PLANAR, 0)
    q = [angles.copy() for angles in made.poses.q]
    q[0][5:9] += 0.05
    solution = solve(made.chain, q)
    clean = solve(made.chain, list(made.poses.q))
    assert solution.weights[5:9].max() < 0.2
    assert np.delete(solution.weights, range(5, 9)).min() > 0.5
    moved = np.abs(solution.x - clean.x)[clean.sigma > 0.0] / clean.sigma[clean.sigma > 0.0]
    assert moved.max() < 1.0


def test_zeros_are_written_as_whole_encoder_steps_to_which_the_rest_is_fitted() -> None:
    made = rig(SPATIAL, 6)
    result = calibrated(made.cell, made.chain, made.poses)
    for link, x in zip(made.chain.links, made.chain.parts(result.written), strict=True):
        ticks = x[link.zeros] / TICK_RAD
        np.testing.assert_allclose(ticks, np.rint(ticks), atol=1e-9)
    used = made.poses.some(~made.poses.held_out)
    bare = result.solution.x.copy()  # with the zeros alone rounded
    for link, x, own in zip(made.chain.links, made.chain.parts(result.written), made.chain.parts(bare), strict=True):
        own[link.zeros] = x[link.zeros]
    fitted, rounded = (rms(disagreement(made.chain, x, used)[1]) for x in (result.written, bare))
    assert fitted < rounded
    told = np.array([(e.value, e.sigma) for e in result.estimates()])
    known = told[:, 1] > 0.0
    away = np.abs(told[:, 0] - made.truth)[known] / told[known, 1]
    assert away.max() < 3.0, "the table's standard errors are of what is written"


def test_the_best_motion_comes_first_and_only_what_the_arms_can_do_is_proposed() -> None:
    made = rig(PLANAR, 0)
    proposals = calibrated(made.cell, made.chain, made.poses).proposals
    assert [p.what[-1] for p in proposals] == ["z", "y", "x"]
    assert all(p.factor > 1.05 for p in proposals)
    assert [p.factor for p in proposals] == sorted((p.factor for p in proposals), reverse=True)


@pytest.mark.parametrize("name", [SPATIAL, PLANAR])
def test_what_a_tolerance_explains_is_the_disagreement_of_arms_within_it(name: str) -> None:
    made = rig(name, 0, count=4)
    rng, nothing = np.random.default_rng(1), np.zeros(made.chain.size)
    agreeing = [
        np.array([reach(link, own, q, made.cell.T_world_object_start, made.chain.basis) for q in angles])
        for link, own, angles in zip(made.chain.links, made.chain.parts(nothing), made.poses.q, strict=True)
    ]
    drawn = [
        [rms(of) for of in disagreement(made.chain, made.chain.scale * rng.normal(size=made.chain.size), agreeing)]
        for _ in range(200)
    ]
    np.testing.assert_allclose(
        explained(made.chain, nothing, agreeing), [rms(of) for of in np.array(drawn).T], rtol=0.08
    )


def test_a_pad_that_gives_under_the_weight_of_the_object_is_explained_too() -> None:
    cell = load_cell(Path(PLANAR), ["tolerance.pads_N_per_m=[100.0, 1e4]", "tolerance.pads_Nm_per_rad=[1.0, 10.0]"])
    weight_N = 9.81 * 0.062
    for link, told in zip(chain_of(cell).links, as_loose_as_told(cell).links, strict=True):
        give = [weight_N / 100.0] * 2 + [weight_N * 0.073 / 1.0]
        np.testing.assert_allclose(told.scale[3:6], np.hypot(link.scale[3:6], give))
        np.testing.assert_array_equal(np.delete(told.scale, [3, 4, 5]), np.delete(link.scale, [3, 4, 5]))


def test_where_every_tolerance_is_zero_the_encoders_grid_is_left() -> None:
    made = rig(PLANAR, 0)
    exact = replace(made.chain, links=tuple(replace(link, scale=0.0 * link.scale) for link in made.chain.links))
    m, rad = explained(exact, made.truth, made.poses.q)
    assert 0.5e-4 < m < 3e-4
    assert rad == pytest.approx(TICK_RAD / math.sqrt(12.0) * math.sqrt(3.0 * 2.0 / 4.0))  # of three joints of two arms


def test_one_arm_is_refused() -> None:
    with pytest.raises(CalibrateError, match="one arm"):
        chain_of(load_cell(Path("identify_wx200")))
