"""One arm on its own: its time, its brake, what touches it, and where its end effector is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_backend.physics.actuator import ActuatorSpec
from sim_backend.physics.friction import FrictionSpec
from sim_backend.physics.lone import LoneArm
from sim_backend.physics.spec import PlantError, PlantSpec
from tests.support.plant.kinematics import end_effector
from tests.support.plant.plant_cells import planar_cell, spatial_cell

ONE = np.ones(3)
DRY = FrictionSpec(0.06 * ONE, 0.0 * ONE, ONE, ONE, 0.5 * ONE, 0.0 * ONE, 0.02 * ONE)


def planar(friction: FrictionSpec | None = None) -> PlantSpec:
    spec = planar_cell(ActuatorSpec.of(3, viscous_Nms_rad=0.02))
    arms = tuple(replace(arm, friction=friction) for arm in spec.arms)
    return replace(spec, arms=arms, gravity=np.zeros(3))


@pytest.mark.parametrize("spec", [planar(), spatial_cell(2)], ids=["planar", "spatial"])
def test_what_touches_it_pushes_where_the_end_effector_is_now(spec: PlantSpec) -> None:
    n = len(spec.arms[1].controlled)
    touched, told = LoneArm(spec, 1), LoneArm(spec, 1)
    wrench = np.array([2.0, -1.0, 1.5, 0.05, 0.1, -0.05])
    touched.touch(wrench)
    zero, begin = np.zeros(n), touched.q.copy()
    for _ in range(150):
        touched.advance(zero)
        told.advance(end_effector(spec, 1, told.q + 0.5 * told.substep_s * told.dq)[1].T @ wrench)
    assert np.abs(touched.q - begin).max() > 0.1, "far enough for the Jacobian to be another one"
    np.testing.assert_allclose(touched.q, told.q, atol=1e-10)
    pose, expected = touched.end_effector(), end_effector(spec, 1, touched.q)[0]
    np.testing.assert_allclose(pose.homogeneous, expected.homogeneous, atol=1e-12)
    touched.touch(np.zeros(6))
    touched.advance(zero)
    told.advance(zero)
    np.testing.assert_allclose(touched.dq, told.dq, atol=1e-9, err_msg="zeros end it")


@pytest.mark.parametrize("friction", [None, DRY], ids=["smooth", "dry"])
def test_a_seized_arm_stands_in_every_joint(friction: FrictionSpec | None) -> None:
    free, seized = LoneArm(planar(friction), 0), LoneArm(planar(friction), 0)
    seized.brake(1e4)
    for joint in range(3):
        tau = 0.5 * (np.arange(3) == joint)
        for _ in range(20):
            free.advance(tau)
            seized.advance(tau)
        assert np.abs(free.dq).max() > 0.05
        assert np.abs(seized.dq).max() < 1e-3


@pytest.mark.parametrize(("load", "moves"), [(0.5, False), (0.0, True)])
def test_its_joints_rub_the_more_the_more_their_motors_give(load: float, moves: bool) -> None:
    arm = LoneArm(planar(replace(DRY, load=load * ONE)), 0)
    begin = arm.q.copy()
    for _ in range(400):
        arm.advance(np.array([0.0, 0.0, 0.1]))  # 0.06 N·m, and half of 0.1
    assert bool(np.abs(arm.q - begin).max() > 0.01) is moves


def pushed_for_ever(arm: LoneArm) -> None:
    for _ in range(50):
        arm.advance(np.full(3, 1e300))


def test_its_time_passes_in_motion_and_on_a_support_and_a_motion_without_end_names_it() -> None:
    arm = LoneArm(planar(), 1)
    assert arm.t == 0.0
    arm.advance(np.zeros(3))
    arm.rest()
    arm.rest()
    assert arm.t == pytest.approx(3.0 * arm.substep_s)
    with pytest.raises(PlantError, match="the motion of arm right on its own"), np.errstate(all="ignore"):
        pushed_for_ever(arm)
