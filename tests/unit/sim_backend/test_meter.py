"""The torques of the grasps, against an arm on its own that is given them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_backend.physics.actuator import ActuatorSpec
from sim_backend.physics.build import build_plant
from sim_backend.physics.friction import FrictionSpec
from sim_backend.physics.lone import LoneArm
from sim_backend.physics.spec import GraspSpec, PlantSpec
from tests.support.plant.plant_cells import planar_cell, spatial_cell
from tests.unit.sim_backend.test_plant import holding_torque

SERVOS = {n: ActuatorSpec.of(n, coulomb_Nm=0.05, viscous_Nms_rad=0.03) for n in (3, 6)}


def sticking() -> PlantSpec:
    spec = planar_cell(SERVOS[3])
    rows = np.array([0.05, 0.02, 0.1, 2.0, 0.0, 0.0, 0.03])[:, None] * np.ones(3)
    return replace(spec, arms=tuple(replace(arm, friction=FrictionSpec(*rows)) for arm in spec.arms))


@pytest.mark.parametrize(
    ("spec", "pads", "within_rad"),
    [
        (planar_cell(SERVOS[3]), None, 1e-12),
        (spatial_cell(3, SERVOS[6]), None, 1e-12),
        (sticking(), None, 1e-9),
        (planar_cell(SERVOS[3]), GraspSpec(3e3, 20.0), 2e-3),  # the soft plant's own linearisations
    ],
    ids=["planar", "spatial", "sticking", "soft"],
)
def test_an_arm_on_its_own_with_its_grasps_torque_moves_as_in_the_cell(
    spec: PlantSpec, pads: GraspSpec | None, within_rad: float
) -> None:
    spec = replace(spec, grasp=pads)
    plant, lone, n = build_plant(spec), LoneArm(spec, 1), len(spec.arms[1].controlled)
    plant.meter_grasps()
    tau, _ = holding_torque(spec)
    own = plant.slices[1]
    for k in range(200):
        wanted = tau + 0.3 * np.sin(0.02 * k + np.arange(len(tau)))
        plant.advance(wanted, 1)
        lone.advance(wanted[own] + plant.grasp_torque()[own])
    moved = np.abs(lone.q - spec.arms[1].q_start).max()
    assert moved > 0.01
    assert np.abs(lone.q - plant.q[own]).max() < within_rad
    assert n == len(lone.q)


def test_the_torque_is_the_mean_since_it_was_asked_for_and_metering_changes_nothing() -> None:
    spec = planar_cell(SERVOS[3])
    tau, _ = holding_torque(spec)
    one, other, plain = build_plant(spec), build_plant(spec), build_plant(spec)
    one.meter_grasps()
    other.meter_grasps()
    assert not one.grasp_torque().any()
    each = []
    for _ in range(5):
        one.advance(0.9 * tau, 1)
        each.append(one.grasp_torque())
    other.advance(0.9 * tau, 5)
    plain.advance(0.9 * tau, 5)
    np.testing.assert_allclose(other.grasp_torque(), np.mean(each, axis=0), atol=1e-12)
    np.testing.assert_array_equal(other.q, plain.q)
    assert not plain.grasp_torque().any()
    other.rest(5)
    assert not other.grasp_torque().any()


@pytest.mark.parametrize("pads", [None, GraspSpec(3e3, 20.0)], ids=["welds", "pads"])
def test_grasps_that_are_not_metered_give_zeros_and_metering_them_twice_forgets_nothing(pads: GraspSpec | None) -> None:
    spec = replace(planar_cell(SERVOS[3]), grasp=pads)
    once, twice = build_plant(spec), build_plant(spec)
    assert once.grasp_torque().tolist() == [0.0] * 6
    for plant in (once, twice):
        plant.meter_grasps()
        plant.advance(np.full(6, 0.1), 20)
    twice.meter_grasps()
    for plant in (once, twice):
        plant.advance(np.full(6, -0.3), 20)
    given = once.grasp_torque()
    assert np.abs(given).max() > 1e-3
    assert np.array_equal(twice.grasp_torque(), given)


def test_an_opened_grasp_pulls_at_nothing() -> None:
    spec = planar_cell(SERVOS[3])
    plant = build_plant(spec)
    plant.meter_grasps()
    plant.release("left")
    plant.advance(np.zeros(6), 5)
    torque = plant.grasp_torque()
    assert np.abs(torque[plant.slices[0]]).max() < 1e-9
    assert np.abs(torque[plant.slices[1]]).max() > 1e-3


def test_what_touches_an_arm_pushes_its_end_effector_along() -> None:
    spec = spatial_cell(2, SERVOS[6])
    tau, _ = holding_torque(spec)
    lone, free = LoneArm(spec, 0), LoneArm(spec, 0)
    force = np.array([0.0, 3.0, 0.0, 0.0, 0.0, 0.0])
    lone.touch(force)
    start = lone.end_effector().translation.copy()
    for _ in range(50):
        lone.advance(tau[:6])
        free.advance(tau[:6])
    pushed = lone.end_effector().translation - free.end_effector().translation
    assert pushed[1] > 1e-3
    assert pushed[1] > np.abs(pushed[[0, 2]]).max()
    lone.touch(np.zeros(6))
    assert lone._wrench is None
    assert np.linalg.norm(start - spec.arms[0].T_world_base.translation) > 0.0
