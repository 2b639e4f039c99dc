"""Laws of mechanics that hold for the closed chain in any state, under any torque."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.interface import Vector
from sim_backend.physics.actuator import ActuatorSpec
from sim_backend.physics.plant import Plant
from sim_backend.physics.snapshot import Observation
from sim_backend.physics.spec import PlantSpec
from tests.support.plant.plant_cells import planar_cell, spatial_cell

PLANAR = {n: planar_cell(names=("left", "right")[:n]) for n in (1, 2)}
SPATIAL = {n: spatial_cell(n) for n in (1, 2, 3, 4)}
cells = st.sampled_from([*PLANAR.values(), *SPATIAL.values()])
seeds = st.integers(0, 2**32 - 1)


def random_torques(spec: PlantSpec, seed: int, count: int, scale: float = 0.4) -> Vector:
    joints = sum(len(a.controlled) for a in spec.arms)
    torques: Vector = np.random.default_rng(seed).normal(scale=scale, size=(count, joints))
    return torques


def angular_momentum(spec: PlantSpec, seen: Observation) -> Vector:
    w, x, y, z = seen.quat_object
    R = pin.Quaternion(w, x, y, z).matrix()
    L: Vector = R @ spec.object.inertia @ R.T @ seen.v_object[3:]
    return L


def net_wrench(spec: PlantSpec, seen: Observation) -> Vector:
    """Force and moment about the centre of mass (6,) of all grasps, world axes."""
    w, x, y, z = seen.quat_object
    R = pin.Quaternion(w, x, y, z).matrix()
    total = np.zeros(6)
    for arm, wrench in zip(spec.arms, seen.grasp_wrench, strict=True):
        p_object_ee = R @ arm.T_object_ee.translation
        total += np.concatenate([wrench[:3], wrench[3:] + np.cross(p_object_ee, wrench[:3])])
    return total


@settings(max_examples=30, deadline=None)
@given(cells, seeds)
def test_newton_and_euler_hold_for_the_object_under_the_grasp_wrenches(spec: PlantSpec, seed: int) -> None:
    spec = replace(spec, substep_s=1e-4)
    plant = Plant(spec)
    torques = random_torques(spec, seed, 3)
    for tau in torques:
        plant.advance(tau, 200)
    before, dt = plant.observe(tau), 2 * spec.substep_s
    plant.advance(tau, 1)
    middle = plant.observe(tau)
    plant.advance(tau, 1)
    after = plant.observe(tau)
    m_acceleration = spec.object.mass_kg * (after.v_object[:3] - before.v_object[:3]) / dt
    moment = (angular_momentum(spec, after) - angular_momentum(spec, before)) / dt
    net = net_wrench(spec, middle)
    size = 1.0 + np.abs(middle.grasp_wrench).max()
    np.testing.assert_allclose(m_acceleration - spec.object.mass_kg * spec.gravity, net[:3], atol=1e-3 * size)
    np.testing.assert_allclose(moment, net[3:], atol=1e-3 * size)


@settings(max_examples=20, deadline=None)
@given(cells, seeds)
def test_moving_the_whole_cell_changes_nothing_but_the_axes(spec: PlantSpec, seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = pin.SE3(pin.Quaternion(*(q := rng.normal(size=4)) / np.linalg.norm(q)).matrix(), rng.normal(size=3))
    T_object = T * spec.object.T_world_object
    x, y, z, w = pin.Quaternion(T_object.rotation).coeffs()
    moved_spec = replace(
        spec,
        arms=tuple(replace(a, T_world_base=T * a.T_world_base) for a in spec.arms),
        object=replace(spec.object, p_world=T_object.translation, quat_world=np.array([w, x, y, z])),
        gravity=T.rotation @ spec.gravity,
    )
    plant, moved = Plant(spec), Plant(moved_spec)
    for tau in random_torques(spec, seed, 5):
        plant.advance(tau, 10)
        moved.advance(tau, 10)
    np.testing.assert_allclose(moved.q, plant.q, atol=1e-8)
    np.testing.assert_allclose(moved.dq, plant.dq, atol=1e-7)
    here, there = plant.observe(tau), moved.observe(tau)
    rotated = np.concatenate([here.grasp_wrench[:, :3] @ T.rotation.T, here.grasp_wrench[:, 3:] @ T.rotation.T], axis=1)
    np.testing.assert_allclose(there.grasp_wrench, rotated, atol=1e-6)
    np.testing.assert_allclose(there.p_object, T.act(here.p_object), atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(st.sampled_from(list(SPATIAL.values())[1:]), seeds)
def test_order_of_the_arms_does_not_matter(spec: PlantSpec, seed: int) -> None:
    order = np.random.default_rng(seed).permutation(len(spec.arms))
    plant, other = Plant(spec), Plant(replace(spec, arms=tuple(spec.arms[i] for i in order)))
    for tau in random_torques(spec, seed, 5):
        plant.advance(tau, 10)
        other.advance(np.concatenate([tau[plant.slices[i]] for i in order]), 10)
    np.testing.assert_allclose(other.q, np.concatenate([plant.q[plant.slices[i]] for i in order]), atol=1e-8)


@settings(max_examples=20, deadline=None)
@given(cells, seeds)
def test_work_of_the_motors_is_the_energy_of_the_cell(spec: PlantSpec, seed: int) -> None:
    plant = Plant(replace(spec, substep_s=2.5e-4))
    start, work = plant.observe(np.zeros(plant.joint_count)).energy, 0.0
    for tau in random_torques(spec, seed, 8):
        for _ in range(20):
            before = plant.q
            plant.advance(tau, 1)
            work += float(tau @ (plant.q - before))
    gained = plant.observe(tau).energy - start
    assert gained == pytest.approx(work, abs=1e-5 + 1e-3 * abs(work))


@settings(max_examples=20, deadline=None)
@given(cells, seeds, st.floats(0.0, 0.3), st.floats(0.0, 0.3), st.floats(1e-3, 1e-1))
def test_work_of_motors_and_friction_is_the_energy_of_the_cell(
    spec: PlantSpec, seed: int, coulomb: float, viscous: float, scale: float
) -> None:
    arms = tuple(
        replace(
            a,
            actuator=ActuatorSpec.of(
                len(a.controlled), coulomb_Nm=coulomb, viscous_Nms_rad=viscous, coulomb_speed_rad_s=scale
            ),
        )
        for a in spec.arms
    )
    plant = Plant(replace(spec, arms=arms, substep_s=1e-4))
    start, work = plant.observe(np.zeros(plant.joint_count)).energy, 0.0
    for tau in random_torques(spec, seed, 4):
        friction = plant.observe(tau).tau_friction
        for _ in range(50):
            q, before = plant.q, friction
            plant.advance(tau, 1)
            friction = plant.observe(tau).tau_friction
            work += float((tau + 0.5 * (before + friction)) @ (plant.q - q))
    gained = plant.observe(tau).energy - start
    assert gained == pytest.approx(work, abs=1e-4 + 1e-2 * abs(work))


@settings(max_examples=20, deadline=None)
@given(st.sampled_from(list(PLANAR.values())), seeds)
def test_planar_cell_stays_in_its_plane_and_so_do_its_wrenches(spec: PlantSpec, seed: int) -> None:
    plant = Plant(spec)
    for tau in random_torques(spec, seed, 10):
        plant.advance(tau, 10)
    seen = plant.observe(tau)
    assert abs(seen.p_object[2]) < 1e-10
    np.testing.assert_allclose(seen.v_object[[2, 3, 4]], 0.0, atol=1e-8)
    np.testing.assert_allclose(seen.grasp_wrench[:, 2:5], 0.0, atol=1e-8)
