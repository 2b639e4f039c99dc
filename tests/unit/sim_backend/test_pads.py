"""Finger pads: what they bear, how they slip and when they open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from drivers.interface import Vector
from sim_backend.physics.pads import Pads
from sim_backend.physics.soft import SoftPlant
from sim_backend.physics.spec import GraspSpec, PlantError
from tests.support.plant.plant_cells import planar_cell
from tests.support.plant.soft_cells import soft, viscous


def pulled(pads: GraspSpec, force_N: float) -> tuple[SoftPlant, Vector]:
    """One braked arm holds the object, which is pulled along x without gravity."""
    spec = replace(planar_cell(viscous(3), names=("left",)), gravity=np.zeros(3))
    plant = soft(spec, pads)
    plant.brake("left", 1e6)
    plant.push(np.array([force_N, 0.0, 0.0, 0.0, 0.0, 0.0]))
    return plant, np.zeros(3)


def test_pad_holds_below_its_bound_and_slips_above_for_good() -> None:
    pads = GraspSpec(2e3, 20.0, damping_ratio=1.0, slip_N=4.0)
    plant, tau = pulled(pads, 3.9)
    plant.advance(tau, 1000)
    assert plant.observe(tau).contact_error_m[0] == pytest.approx(3.9 / 2e3, rel=1e-3)
    plant.push(np.zeros(6))
    plant.advance(tau, 1000)
    assert plant.observe(tau).contact_error_m[0] < 1e-6
    plant.push(np.array([6.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    plant.advance(tau, 60)
    plant.push(np.zeros(6))
    plant.advance(tau, 1000)
    seen = plant.observe(tau)
    assert seen.contact_error_m[0] > 1e-3
    assert np.linalg.norm(seen.grasp_wrench[0, :3]) < 1e-3


def test_of_two_arms_the_one_on_the_softer_pad_is_stretched_more() -> None:
    spec = replace(planar_cell(viscous(3)), gravity=np.zeros(3))
    unlike = replace(spec, arms=(replace(spec.arms[0], pads=(1e3, None)), spec.arms[1]))
    plant = soft(unlike, GraspSpec(4e3, 20.0, damping_ratio=1.0))
    for arm in unlike.names:
        plant.brake(arm, 1e6)
    plant.push(np.array([5.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    plant.advance(np.zeros(6), 1000)
    seen = plant.observe(np.zeros(6))
    assert seen.contact_error_m == pytest.approx([1e-3, 1e-3], rel=1e-3), "one object is where it is"
    assert seen.grasp_wrench[:, 0] == pytest.approx([-1.0, -4.0], rel=1e-3)


def test_pad_that_has_slipped_too_far_opens() -> None:
    plant, tau = pulled(GraspSpec(2e3, 20.0, damping_ratio=1.0, slip_N=4.0, open_m=5e-3), 8.0)
    plant.advance(tau, 400)
    seen = plant.observe(tau)
    assert np.isnan(seen.contact_error_m[0])
    assert not seen.grasp_wrench.any()


def test_pad_slips_under_a_moment() -> None:
    plant, tau = pulled(GraspSpec(2e3, 20.0, damping_ratio=1.0, slip_Nm=0.1), 0.0)
    plant.push(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.09]))
    plant.advance(tau, 1000)
    assert plant.observe(tau).contact_error_rad[0] == pytest.approx(0.09 / 20.0, rel=1e-2)
    plant.push(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.2]))
    plant.advance(tau, 200)
    seen = plant.observe(tau)
    assert seen.contact_error_rad[0] > 0.02
    assert seen.slip_rad[0] == pytest.approx(seen.contact_error_rad[0] - 0.1 / 20.0, rel=0.1)
    assert seen.slip_m[0] == 0.0


def two_pads(**bounds: float) -> Pads:
    return Pads(GraspSpec(100.0, 10.0, damping_ratio=0.25, **bounds), np.ones((2, 6)), [(None, None)] * 2)


def test_each_pad_slips_by_itself_in_its_own_direction() -> None:
    pads = two_pads(slip_N=2.0, slip_Nm=0.5)
    opening = np.array([[0.0, 0.03, -0.04, 0.01, 0.0, 0.0], [0.01, 0.0, 0.0, 0.0, -0.06, 0.08]])
    pads.slip(opening, np.eye(3))
    np.testing.assert_allclose(pads.slipped[0], [0.0, 0.018, -0.024, 0.0, 0.0, 0.0])  # 5 N, 2 are held
    np.testing.assert_allclose(pads.slipped[1], [0.0, 0.0, 0.0, 0.0, -0.03, 0.04])  # 1 N·m, half is held
    held = 100.0 * (opening - pads.slipped)[0, :3]
    assert np.linalg.norm(held) == pytest.approx(2.0)


def test_what_a_grasp_has_slipped_counts_from_where_it_was_closed() -> None:
    """One that was closed beside its place has slipped by nothing then, and opens no sooner for it."""
    pads, R = two_pads(slip_N=2.0, slip_Nm=0.5, open_m=0.011), pin.exp3(np.array([0.2, -0.4, 0.3]))
    beside = np.array([0.03, 0.0, 0.0, 0.0, 0.0, 0.2])
    pads.rest_at(0, beside, R)
    assert (pads.slip_m.tolist(), pads.slip_rad.tolist()) == ([0.0, 0.0], [0.0, 0.0])
    opening = np.stack([np.add(beside, [0.0, 0.03, 0.0, 0.0, 0.09, 0.0]), np.zeros(6)])
    assert pads.slip(opening, R) == ()
    np.testing.assert_allclose(pads.slip_m, [0.01, 0.0], atol=1e-15)
    np.testing.assert_allclose(pads.slip_rad, [0.04, 0.0], atol=1e-15)
    pads.turn(pin.exp3(np.array([0.5, 0.1, -0.2])) @ R)
    np.testing.assert_allclose(pads.slip_m, [0.01, 0.0], atol=1e-15)
    opening[0, 1] += 0.02
    assert pads.slip(opening, R) == (0,)


def test_what_has_slipped_turns_with_the_object() -> None:
    pads = two_pads(slip_N=2.0, slip_Nm=0.5)
    R = pin.exp3(np.array([0.2, -0.4, 0.3]))
    pads.slip(np.tile([0.0, 0.03, -0.04, 0.0, 0.06, 0.08], (2, 1)), R)
    before, turn = pads.slipped.copy(), pin.exp3(np.array([0.5, 0.1, -0.2]))
    pads.turn(turn @ R)
    assert float(np.abs(before).max(axis=1).min()) > 0.01
    np.testing.assert_allclose(pads.slipped[:, :3], before[:, :3] @ turn.T, atol=1e-15)
    np.testing.assert_allclose(pads.slipped[:, 3:], before[:, 3:] @ turn.T, atol=1e-15)


def test_springs_rest_where_they_are_told_to_and_are_carried_along_from_there() -> None:
    pads = two_pads()
    R, turn = pin.exp3(np.array([0.2, -0.4, 0.3])), pin.exp3(np.array([0.5, 0.1, -0.2]))
    opening = np.array([0.01, 0.02, -0.03, 0.1, -0.2, 0.3])
    pads.rest_at(1, opening, R)
    assert pads.slipped.tolist() == [[0.0] * 6, opening.tolist()]
    pads.turn(turn @ R)
    np.testing.assert_allclose(pads.slipped[1], [*turn @ opening[:3], *turn @ opening[3:]], atol=1e-15)
    assert not pads.slipped[0].any()


def test_pads_open_beyond_their_bound_once_and_each_by_itself() -> None:
    pads = two_pads(slip_N=2.0, slip_Nm=0.5, open_m=0.03)
    still = np.zeros((2, 6))
    assert pads.slip(still, np.eye(3)) == ()
    pads.slipped[0, :3] = [0.0, 0.0, 0.03]
    pads.slipped[1, 3:] = [1.0, 1.0, 1.0]  # a rotation opens nothing
    assert pads.slip(pads.slipped.copy(), np.eye(3)) == ()
    pads.slipped[0, 2] = 0.0301
    assert pads.slip(pads.slipped.copy(), np.eye(3)) == (0,)
    pads.open(0)
    assert pads.slip(pads.slipped.copy(), np.eye(3)) == ()


def test_energy_of_pads_is_that_of_closed_springs_beyond_what_has_slipped() -> None:
    pads = two_pads(slip_N=2.0)
    pads.slipped[:, 0] = 0.01
    opening = np.array([[0.03, 0.0, 0.0, 0.1, 0.0, 0.0], [0.5, 0.0, 0.0, 0.0, 0.0, 0.0]])
    pads.open(1)
    assert pads.energy(opening) == pytest.approx(0.5 * 100.0 * 0.02**2 + 0.5 * 10.0 * 0.1**2)


def test_slipped_pads_are_carried_along_by_the_object() -> None:
    plant, tau = pulled(GraspSpec(2e3, 20.0, damping_ratio=1.0, slip_N=4.0), 6.0)
    plant.advance(tau, 60)
    plant.push(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
    plant.advance(tau, 30)
    R, pads = plant.T_world_object.rotation, plant._pads
    plant.advance(tau, 1)
    assert float(np.abs(R - np.eye(3)).max()) > 0.01
    np.testing.assert_allclose(pads.slipped[0, :3], R @ pads._slipped_object[0, :3], atol=2e-5)
    assert float(np.linalg.norm(pads.slipped)) > 1e-3


def test_pads_without_an_arm_are_refused() -> None:
    with pytest.raises(PlantError, match="arms with pads"):
        SoftPlant(replace(planar_cell(), arms=(), grasp=GraspSpec(1e2, 1.0)))


def test_a_sliding_pad_pulls_with_its_bound() -> None:
    """Within one linearisation too.  Beyond the bound comes what the spring stretches in half a substep, K v h/2."""
    pads = GraspSpec(1e3, 1e3, damping_ratio=0.0, slip_N=4.0)
    plant, tau = pulled(pads, 6.0)
    plant.advance(tau, 21)
    m, h, K = plant.spec.object.mass_kg, plant.spec.substep_s, pads.stiffness_N_per_m
    before = plant.observe(tau)
    assert abs(before.grasp_wrench[0, 0]) == pytest.approx(4.0, rel=1e-6)  # it slides already
    v = float(before.v_object[0])
    for _ in range(8):
        v += h * (6.0 - 4.0 - 0.5 * K * h * v) / (m + 0.3 * h * h * K)
    plant.advance(tau, 8)
    seen = plant.observe(tau)
    assert seen.v_object[0] == pytest.approx(v, rel=1e-3)
    assert v > 1.1 * float(before.v_object[0])
    assert abs(seen.grasp_wrench[0, 0]) == pytest.approx(4.0, rel=1e-6)
