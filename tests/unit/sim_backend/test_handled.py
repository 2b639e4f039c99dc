"""What hands and a support do to a cell: it is let go anywhere, and its grasps close where they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from drivers.interface import Vector
from sim_backend.physics.actuator import ActuatorSpec
from sim_backend.physics.handled import HandledPlant
from sim_backend.physics.spec import GraspSpec
from tests.support.plant.kinematics import end_effector
from tests.support.plant.plant_cells import planar_cell

K_N_PER_M, K_NM_PER_RAD = 3e3, 20.0
ZERO = np.zeros(6)


def cell(backlash_rad: float = 0.0, damping_ratio: float = 1.0) -> HandledPlant:
    """Two planar arms that fell together for a while."""
    spec = planar_cell(ActuatorSpec.of(3, viscous_Nms_rad=0.1, backlash_rad=backlash_rad))
    plant = HandledPlant(replace(spec, grasp=GraspSpec(K_N_PER_M, K_NM_PER_RAD, damping_ratio=damping_ratio)))
    plant.advance(ZERO, 40)
    assert np.abs(plant.dq).max() > 0.05
    return plant


def put_aside(plant: HandledPlant, away: Vector) -> tuple[Vector, pin.SE3]:
    """Arms at their start and the object so far (m) from it and turned, all at rest."""
    q = np.concatenate([arm.q_start for arm in plant.spec.arms])
    turned = pin.SE3(pin.exp3(np.array([0.0, 0.02, 0.0])), away)
    T = pin.SE3(plant.spec.object.T_world_object) * turned
    plant.let_go(q, T)
    return q, T


@pytest.mark.parametrize("backlash_rad", [0.0, 5e-3])
def test_what_is_let_go_stands_where_it_is_told_with_its_grasps_open(backlash_rad: float) -> None:
    plant = cell(backlash_rad)
    q, T = put_aside(plant, np.array([0.01, 0.0, -0.02]))
    seen = plant.observe(ZERO)
    assert np.array_equal(plant.q, q)
    assert not plant.dq.any()
    np.testing.assert_allclose(plant.T_world_object.homogeneous, T.homogeneous, atol=1e-12)
    np.testing.assert_allclose(seen.p_object, T.translation, atol=1e-12)
    assert not seen.v_object.any()
    assert np.isnan(seen.contact_error_m).all()
    assert not seen.grasp_wrench.any()
    if plant._gears is not None:
        assert not plant._gears.speed.any()
    plant.advance(ZERO, 20)
    np.testing.assert_allclose(plant.object_twist[:3], 0.02 * plant.spec.gravity, atol=1e-9)
    assert not plant.object_twist[3:].any()


def test_a_grasp_that_closes_where_it_is_is_not_stretched_and_pulls_back_to_there() -> None:
    plant = cell()
    put_aside(plant, np.array([2e-3, 0.0, -3e-3]))
    plant.take_hold(0)
    seen = plant.observe(ZERO)
    np.testing.assert_allclose(seen.grasp_wrench, np.zeros((2, 6)), atol=1e-9)
    assert np.isnan(seen.contact_error_m).tolist() == [False, True]
    for part in plant.slices:
        plant.servos.set_viscous(part, 1e6)
    plant.advance(ZERO, 3000)
    hangs = plant.observe(ZERO)
    weight = -plant.spec.object.mass_kg * plant.spec.gravity
    np.testing.assert_allclose(hangs.grasp_wrench[0, :3], weight, atol=1e-5)
    assert np.linalg.norm(hangs.p_object - seen.p_object) >= 0.99 * np.linalg.norm(weight) / K_N_PER_M


def test_a_grasp_closes_on_what_has_moved_since_the_last_look() -> None:
    plant = cell(damping_ratio=1e-6)  # pads that brake no speed
    put_aside(plant, np.zeros(3))
    plant.advance(ZERO, 7)  # the object falls, within one linearisation
    fallen_m = 0.5 * float(np.linalg.norm(plant.spec.gravity)) * 7e-3**2
    plant.take_hold(1)
    assert np.abs(plant.observe(ZERO).grasp_wrench[1, :3]).max() < 0.01 * K_N_PER_M * fallen_m


def test_its_end_effectors_are_where_its_joints_say_while_it_moves() -> None:
    plant = cell()
    plant.advance(ZERO, 13)
    for i, own in enumerate(plant.slices):
        pose = plant.end_effector(i)
        expected, _ = end_effector(plant.spec, i, plant.q[own])
        np.testing.assert_allclose(pose.homogeneous, expected.homogeneous, atol=1e-12)
