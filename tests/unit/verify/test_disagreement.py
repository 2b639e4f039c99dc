"""Internal wrenches at the stated tolerance, against the plant and against what their size must depend on."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from agent.config.cell import Cell
from agent.control import ik
from agent.verify.check import start_configurations
from agent.verify.disagreement import (
    MEAN_SHARE,
    Disagreement,
    _beyond,
    _Errors,
    _errors,
    _followers,
    _turn,
    _wrenches,
    disagreement,
)
from agent.verify.force import mean_bound_N
from agent.verify.robustness import Walk, poses
from tests.support.arm_files import with_figures
from tests.support.control.criterion_cells import cell_of, gentle
from tests.support.plant.inprocess import simulate

KEYS = ("base_m", "base_rad", "grasp_m", "grasp_rad", "zeros_rad", "masses", "torque_constant", "skew_s")
EXACT = (*(f"tolerance.{key}=0.0" for key in KEYS), "tolerance.friction=[1.0, 1.0]")
STILL = ("trajectory.p_amplitude_m=[0.0, 0.0, 0.0]", "trajectory.angle_rad=0.0")
IDEAL = (
    "simulation.effects.friction=false", "simulation.effects.position_quantisation=false",
    "simulation.effects.velocity_quantisation=false", "simulation.effects.torque_quantisation=false",
    "controller.friction_feedforward=false", "world.gravity_m_per_s2=[0.0, 0.0, 0.0]",
)  # fmt: skip


def found(cell: Cell, *times: float) -> tuple[Disagreement, ...]:
    """At these times, or at the first; the arms stand at the start."""
    models = [cell.model(a) for a in cell.arms]
    instants = times or (0.0,)
    walk = Walk(cell, models, [start_configurations(cell, models)] * len(instants), list(instants))
    return disagreement(cell, models, poses(walk), walk.along, walk.instants)


def test_a_base_that_is_off_squeezes_the_object_as_predicted() -> None:
    """Each of two arms 2 mm off in a random direction is √2 times one of them off along x."""
    believed = gentle("paper", *STILL, *IDEAL)
    x, y, z = believed.arms[1].entry.p_world_base_m
    true = gentle("paper", *STILL, *IDEAL, f"arms.right.p_world_base_m=[{x + 2e-3}, {y}, {z}]")
    end = simulate(true, 3.0, agents_cell=believed).end
    assert end is not None
    measured = float(np.linalg.norm(end.grasp_wrench[0, :3] - end.grasp_wrench[1, :3])) / 2.0
    assert measured == pytest.approx(0.5 * (1.5 * 100.0 + 0.5) * 2e-3, rel=0.02)
    rubbing = found(gentle("paper", *STILL, *IDEAL, *EXACT))  # friction, which the plant here has not
    both = found(gentle("paper", *STILL, *IDEAL, *EXACT, "tolerance.base_m=2e-3"))
    for rubs, arm in zip(rubbing, both, strict=True):
        assert math.sqrt(arm.force_N**2 - rubs.force_N**2) == pytest.approx(math.sqrt(2.0) * measured, rel=0.02)


def test_a_cell_without_errors_squeezes_nothing() -> None:
    for name in ("paper", "three_wx250s"):
        for arm in found(gentle(name, *EXACT)):
            assert arm.force_N == pytest.approx(0.0, abs=1e-9)
            assert arm.moment_Nm == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("name", ["paper", "three_wx250s"])
def test_every_error_counts_and_twice_the_error_is_twice_the_wrench(name: str, key: str) -> None:
    one, two = (found(gentle(name, *EXACT, f"tolerance.{key}={size}"), 3.0) for size in (2e-3, 4e-3))
    for a, b in zip(one, two, strict=True):
        assert a.force_N > 1e-6
        assert b.force_N == pytest.approx(2.0 * a.force_N)


def test_independent_errors_add_as_squares() -> None:
    def force(*keys: str) -> float:
        return found(gentle("paper", *EXACT, *(f"tolerance.{key}=0.003" for key in keys)), 3.0)[0].force_N

    assert force("base_m", "zeros_rad", "masses") == pytest.approx(
        math.hypot(force("base_m"), force("zeros_rad"), force("masses"))
    )


def test_of_friction_counts_what_the_feed_forward_does_not_know() -> None:
    def force(friction: str, *overrides: str) -> float:
        return found(gentle("paper", *EXACT, f"tolerance.friction={friction}", *overrides))[0].force_N

    assert force("[1.0, 1.4]") == pytest.approx(force("[0.3, 1.0]") * 0.4 / 0.7)
    assert force("[0.3, 1.4]") == pytest.approx(force("[0.3, 1.0]"))
    plain = "controller.friction_feedforward=false"
    assert force("[1.0, 1.0]", plain) > force("[0.3, 1.4]") > 0.1
    assert force("[1.0, 2.0]", plain) == pytest.approx(2.0 * force("[0.5, 1.0]", plain))


def test_friction_of_a_joint_at_rest_counts_with_its_breakaway_and_what_load_makes_of_it(tmp_path: Path) -> None:
    def columns(cell: Cell) -> np.ndarray:
        arm, model = cell.arms[0], cell.model(cell.arms[0])
        errors = _errors(cell, arm, model, q, PLANE, np.zeros(3), NOTHING)
        return J.T @ errors.wrench[:, model.n + 1 :]

    cell = gentle("paper", *EXACT, "tolerance.friction=[0.6, 1.5]")
    arm, model = cell.arms[0], cell.model(cell.arms[0])
    q = start_configurations(cell, [cell.model(a) for a in cell.arms])[0]
    k = model.evaluate(q, np.zeros(model.n))
    J = PLANE @ model.task_basis.T @ k.J
    held = k.g + J.T @ (cell.offline(arm).load_share * PLANE[:, :3] @ (-cell.file.object.mass_kg * cell.gravity))
    coulomb = np.array([s.coulomb_Nm.value for s in arm.servos])
    np.testing.assert_allclose(columns(cell), 0.5 * np.diag(coulomb), atol=1e-9)
    unfiled = gentle("paper", *EXACT, "tolerance.breakaway=0.8", "tolerance.load_friction=0.05")
    np.testing.assert_allclose(columns(unfiled), np.diag(0.8 * coulomb + 0.05 * np.abs(held)), atol=1e-9)
    figures = {"breakaway_Nm": 0.3, "stribeck_rad_per_s": 1.5, "load_friction": 0.05, "breakaway_load_friction": 0.1}
    stuck = with_figures(cell, tmp_path / "arms", lambda _: figures)
    np.testing.assert_allclose(columns(stuck), 0.5 * np.diag(coulomb + 0.3 + 0.15 * np.abs(held)), atol=1e-9)
    assert float(np.abs(held).max()) > 0.1


def test_arms_that_align_themselves_keep_their_dead_zone_only() -> None:
    stiff = ("tolerance.base_m=0.01",)
    rigid = found(gentle("paper", *EXACT, *stiff))
    aligned = found(gentle("paper", *EXACT, *stiff, "controller.alignment.dead_zone_m=0.001"))
    assert aligned[0].force_N < 0.2 * rigid[0].force_N
    zone = found(gentle("paper", *EXACT, *stiff, "controller.alignment.dead_zone_m=0.002"))
    assert zone[0].force_N == pytest.approx(2.0 * aligned[0].force_N, rel=0.05)
    off = found(gentle("paper", *EXACT, *stiff, "controller.alignment.track_per_s=0.0"))
    assert off == rigid


def test_what_the_largest_shift_leaves_of_both_arms_errors_squeezes() -> None:
    """An arm that may give way by 20 mm leaves of 50 mm what remains, however small its dead zone is."""
    wide = ("tolerance.base_m=0.05", "controller.alignment.dead_zone_m=0.0")

    def force(*settings: str) -> float:
        return found(gentle("paper", *EXACT, *wide, *settings))[0].force_N

    apart = math.sqrt(2.0) * 0.05  # both bases are off
    rigid, bound = force("controller.alignment.max_m=1e-6"), force("controller.alignment.max_m=0.02")
    assert rigid > 1.0
    assert bound == pytest.approx(rigid * (apart - 0.02) / apart, rel=0.01)
    assert force("controller.alignment.max_m=0.08") == pytest.approx(0.0, abs=1e-9)


def test_arms_that_do_not_align_themselves_keep_all_of_an_error_however_large() -> None:
    small, large = (found(gentle("paper", *EXACT, f"tolerance.base_m={size}"))[0].force_N for size in (2e-3, 0.05))
    assert large == pytest.approx(25.0 * small)


@pytest.mark.parametrize("anchor", [0, 1, 2])
def test_all_arms_but_the_anchor_give_way_where_they_align_themselves(anchor: int) -> None:
    names = [arm.name for arm in gentle("three_wx250s").arms]
    chosen = f'controller.alignment.anchor="{names[anchor]}"'
    assert _followers(gentle("three_wx250s", chosen)) == [i != anchor for i in range(3)]
    assert not any(_followers(gentle("three_wx250s", chosen, "controller.alignment.track_per_s=0.0")))
    assert not any(_followers(gentle("three_wx250s")))


def test_of_several_places_the_one_of_the_largest_force_counts() -> None:
    cell = gentle("paper", *EXACT, "tolerance.skew_s=0.002")
    fast, slow = found(cell, 0.0), found(cell, 3.0)
    assert 1.5 * slow[0].force_N < fast[0].force_N
    assert found(cell, 0.0, 3.0) == found(cell, 3.0, 0.0) == fast


PLANE = np.eye(6)[[0, 1, 5]]
NOTHING = np.zeros(1)  # was off at the begin


def test_a_turn_moves_the_object_by_its_lever_and_turns_it_about_any_axis_there_is() -> None:
    lever = np.array([0.3, -0.2, 0.5])
    twists = np.vstack([np.cross(np.eye(3), lever).T, np.eye(3)])
    np.testing.assert_allclose(_turn(np.eye(6), 0.3, lever), 0.3 / math.sqrt(3.0) * twists)
    np.testing.assert_allclose(_turn(PLANE, 0.3, lever), 0.3 * PLANE @ twists * [0.0, 0.0, 1.0])


def test_of_a_follower_s_error_the_dead_zone_is_left_in_metres_and_in_angle() -> None:
    cell = gentle("paper", "controller.alignment.dead_zone_m=0.003", "controller.alignment.dead_zone_rad=0.006")
    for P, zone in ((np.eye(6), [3e-3 / math.sqrt(3.0)] * 3 + [6e-3 / math.sqrt(3.0)] * 3),
                    (PLANE, [3e-3 / math.sqrt(2.0)] * 2 + [6e-3])):  # fmt: skip
        m = len(P)
        large = _Errors(np.full((m, 2), 0.1), np.zeros((m, 2)), np.ones((m, 1)))
        kept = _wrenches(cell, P, np.eye(m), large, follows=True)
        np.testing.assert_allclose(np.abs(kept), np.hstack([np.diag(zone), np.ones((m, 1))]))
        small = _Errors(np.full((m, 2), 1e-4), np.full((m, 2), 1e-4), np.ones((m, 1)))
        kept = _wrenches(cell, P, np.eye(m), small, follows=True)
        np.testing.assert_allclose(np.abs(kept[:, :m]), math.sqrt(2.0) * 1e-4 * np.eye(m))


def test_of_what_an_error_makes_along_the_way_the_part_is_left_that_goes_back() -> None:
    """Of 10 mm that came, beyond a dead zone of 2 mm, a third at 0.1/s back and 0.2/s after it, and never all of it."""
    law = "controller.alignment = { dead_zone_m = 0.002, dead_zone_rad = 0.004, track_per_s = 0.2, return_per_s = 0.1 }"
    cell, m = gentle("paper", law), 6
    came = np.hstack([np.diag([0.01] * 3 + [0.02] * 3), np.zeros((m, 1))])
    errors = _Errors(np.hstack([came[:, :m], np.full((m, 1), 0.5)]), came, np.ones((m, 1)))
    kept = np.abs(np.diag(_wrenches(cell, np.eye(m), np.eye(m), errors, follows=True)[:, :m]))
    zone = np.array([2e-3 / math.sqrt(3.0)] * 3 + [4e-3 / math.sqrt(3.0)] * 3)
    assert kept == pytest.approx(zone + (came.sum(axis=1) - zone) / 3.0)
    forgets_nothing = gentle("paper", law.replace("return_per_s = 0.1", "return_per_s = 0.0"))
    assert np.abs(np.diag(_wrenches(forgets_nothing, np.eye(m), np.eye(m), errors, follows=True)[:, :m])) == (
        pytest.approx(zone)
    )
    small = _Errors(came, came, np.ones((m, 1)))
    quick = gentle("paper", law.replace("return_per_s = 0.1", "return_per_s = 20.0"))
    assert (np.abs(_wrenches(quick, np.eye(m), np.eye(m), small, follows=True)[:, :m]).max(axis=1) <= came.sum(1)).all()


def test_a_base_that_is_turned_squeezes_more_along_the_way_where_shifts_go_back() -> None:
    limits = [f"controller.alignment.{most}" for most in ("max_m=0.1", "max_rad=0.5", "dead_zone_m=0.0005")]
    turned = ("tolerance.base_rad=0.1", "controller.alignment.dead_zone_rad=0.0005", *limits)

    def force(return_per_s: float, *times: float) -> float:
        cell = gentle("paper", *EXACT, *turned, f"controller.alignment.return_per_s={return_per_s}")
        models = [cell.model(a) for a in cell.arms]
        q, along = start_configurations(cell, models), []
        for t in times:
            at = cell.trajectory().at(t)
            there = pin.SE3(pin.Quaternion(*at.quat), np.array(at.p))
            along.append([ik.solve(model, there, q_i) for model, q_i in zip(models, q, strict=True)])
        walk = Walk(cell, models, along, list(times))
        return disagreement(cell, models, poses(walk), walk.along, walk.instants)[0].force_N

    assert force(0.3, 0.0) == force(0.0, 0.0), "at the begin they have found together"
    assert force(0.3, 0.0, 3.75) > 3.0 * force(0.0, 0.0, 3.75)
    assert force(0.1, 0.0, 3.75) == pytest.approx(0.5 * force(0.3, 0.0, 3.75), rel=0.2)


def test_an_error_of_the_torque_constant_is_a_part_of_what_holds_arm_and_share_and_a_base_turns_about_itself() -> None:
    cell = gentle("paper", *EXACT, "tolerance.torque_constant=0.1", "tolerance.base_rad=0.01")
    arm = cell.arms[1]
    model, share = cell.model(arm), cell.offline(arm).load_share
    q = start_configurations(cell, [cell.model(a) for a in cell.arms])[1]
    k = model.evaluate(q, np.zeros(model.n))

    def lifted(q: np.ndarray) -> float:
        p = np.array(model.evaluate(q, np.zeros(model.n)).p_object)
        return -share * cell.file.object.mass_kg * float(cell.gravity @ p)

    carries = [(lifted(q + step) - lifted(q - step)) / 2e-6 for step in 1e-6 * np.eye(model.n)]
    errors = _errors(cell, arm, model, q, PLANE, np.zeros(3), NOTHING)
    J = PLANE @ model.task_basis.T @ k.J
    np.testing.assert_allclose(J.T @ errors.wrench[:, : model.n], 0.1 * np.diag(k.g + carries), atol=1e-8)
    assert float(np.abs(carries).max()) > 0.05
    lever = np.array(k.p_object) - arm.T_world_base.translation
    np.testing.assert_allclose(errors.off[:, 3:6], _turn(PLANE, 0.01, lever))
    assert float(np.abs(arm.T_world_base.translation).max()) > 0.1


def off_by(shift_m: float, turn_rad: float) -> _Errors:
    """An arm that is off by so much, half of it in each of two columns, in the direction of no axis."""
    sizes = np.repeat([shift_m, turn_rad], 3) / math.sqrt(3.0)
    return _Errors(np.outer(sizes, [1.0, -1.0]) / math.sqrt(2.0), np.zeros((6, 2)), np.zeros((6, 0)))


@pytest.mark.parametrize("anchor", [0, 1, 2])
def test_what_a_shift_leaves_is_that_of_the_arm_farthest_from_the_anchor_in_metres_and_in_angle(anchor: int) -> None:
    names = [arm.name for arm in gentle("three_wx250s").arms]
    most = ("controller.alignment.max_m=0.02", "controller.alignment.max_rad=0.065")
    cell = gentle("three_wx250s", f'controller.alignment.anchor="{names[anchor]}"', *most)

    def left(anchors: _Errors, *others: _Errors) -> list[float]:
        errors = [*others[:anchor], anchors, *others[anchor:]]
        return [float(x) for x in _beyond(cell, np.eye(6), errors)[[0, 5], 0]]

    assert left(off_by(0.03, 0.05), off_by(0.04, 0.03), off_by(0.01, 0.12)) == pytest.approx([0.6, 0.5])
    assert left(off_by(0.03, 0.05), off_by(0.0, 0.12), off_by(0.04, 0.0)) == pytest.approx([0.6, 0.5])
    assert left(off_by(0.0, 0.06), off_by(0.019, 0.0), off_by(0.0, 0.02)) == [0.0, 0.0]
    assert left(off_by(0.0, 0.0), off_by(0.0, 0.0), off_by(0.0, 0.0)) == [0.0, 0.0]


@pytest.mark.parametrize("anchor", [0, 2])
def test_the_anchor_bears_what_the_followers_leave_to_it(anchor: int) -> None:
    names = [arm.name for arm in gentle("three_wx250s").arms]
    cell = gentle("three_wx250s", f'controller.alignment.anchor="{names[anchor]}"')
    forces = [arm.force_N for arm in found(cell)]
    assert int(np.argmax(forces)) == anchor


def test_in_the_mean_a_run_may_press_by_a_newton_in_a_plane_and_by_four_elsewhere_half_of_the_sum() -> None:
    assert [mean_bound_N(cell_of(name)) for name in ("paper_real", "three_wx250s")] == [1.0, 4.0]
    assert MEAN_SHARE == 0.5
