"""Cells that cannot be, each refused with what was found, what is allowed and what to do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from drivers.interface import Vector
from sim_backend.physics.actuator import ActuatorSpec
from sim_backend.physics.composition import solve_grasp
from sim_backend.physics.plant import Plant
from sim_backend.physics.spec import GraspError, ObjectSpec, PlantError, PlantSpec, pose, substep_of
from tests.support.plant.plant_cells import BOX, GRAVITY, PLANAR_URDF, planar_arm, planar_cell


def test_arm_that_is_not_on_its_grasp_is_refused_by_name_and_distance() -> None:
    right = planar_arm("right")
    T = pin.SE3(right.T_world_base.rotation, right.T_world_base.translation + np.array([1e-3, 0, 0]))
    with pytest.raises(GraspError, match=r"arm right: .*1 mm and .*at most 0.01 mm") as caught:
        Plant(PlantSpec((planar_arm("left"), replace(right, T_world_base=T)), BOX, GRAVITY))
    assert caught.value.arm == "right"
    assert caught.value.gap_m == pytest.approx(1e-3, rel=1e-6)
    assert caught.value.gap_rad < 1e-9


def test_arm_that_is_turned_on_its_grasp_is_refused() -> None:
    arm = planar_arm("left")
    bent = replace(arm, q_start=arm.q_start + np.array([0.0, 0.0, 2e-3]))
    with pytest.raises(GraspError, match="2 mrad apart"):
        Plant(PlantSpec((bent,), BOX, GRAVITY))


def test_grasp_out_of_reach_has_no_start_pose() -> None:
    far = replace(BOX, p_world=np.array([0.301, 0.9, 0.0]))
    with pytest.raises(GraspError, match="arm left: the end effector is not on its grasp"):
        solve_grasp(planar_arm("left"), far, np.array([-0.3, 0.3, 0.0]))


def test_solved_start_pose_is_exact() -> None:
    start = Plant(planar_cell()).observe(np.zeros(6))
    assert start.contact_error_m.max() < 1e-12
    assert start.contact_error_rad.max() < 1e-12


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"urdf_xml": "<robot"}, "arm left: URDF"),
        ({"controlled": ("shoulder", "elbow", "wrist_rotate")}, "arm left: controlled joints.*'wrist_angle'"),
        ({"controlled": ("elbow", "shoulder", "wrist_angle")}, "from the base to the end effector"),
        ({"locked_rad": {}}, "either as controlled or as locked"),
        ({"ee_frame": "gripper"}, "arm left: end-effector frame: found gripper"),
        ({"urdf_xml": PLANAR_URDF.replace("revolute", "continuous")}, "a joint with one coordinate"),
    ],
)
def test_arm_that_its_urdf_does_not_describe_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(PlantError, match=message):
        Plant(PlantSpec((replace(planar_arm("left"), **change),), BOX, GRAVITY))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q_start": np.zeros(2)}, "q_start.*3 finite numbers"),
        ({"q_start": np.array([0, np.nan, 0])}, "q_start.*3 finite numbers"),
        ({"rotor_inertia": np.array([0.01, -0.01, 0.01])}, "rotor_inertia.*no negative"),
        ({"actuator": ActuatorSpec.of(6)}, "actuator.*6 joints"),
    ],
)
def test_arm_with_the_wrong_numbers_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(PlantError, match=message):
        replace(planar_arm("left"), **change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gravity": np.array([0.0, np.nan, 0.0])}, "gravity"),
        ({"substep_s": 0.0}, "substep_s"),
        ({"substep_s": 8e-3}, "baumgarte_d_per_s.*at most 0.5"),
        ({"arms": (planar_arm("left"), planar_arm("left"))}, "different names"),
    ],
)
def test_cell_that_makes_no_sense_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(PlantError, match=message):
        replace(planar_cell(), **change)


@pytest.mark.parametrize(
    ("mass", "inertia"), [(0.0, np.eye(3)), (1.0, -np.eye(3)), (1.0, np.eye(2)), (1.0, np.triu(np.ones((3, 3))))]
)
def test_object_that_cannot_be_is_refused(mass: float, inertia: Vector) -> None:
    with pytest.raises(PlantError, match="mass > 0 and a symmetric positive definite inertia"):
        ObjectSpec(mass, inertia, np.zeros(3), np.array([1.0, 0, 0, 0]))


def test_quaternion_must_be_unit() -> None:
    with pytest.raises(PlantError, match=r"quaternion: found norm 1\.1"):
        pose(np.zeros(3), [1.1, 0, 0, 0])


@pytest.mark.parametrize("rate_hz", [120.0, 200.0, 333.0, 500.0, 2000.0])
def test_substep_divides_the_period_and_is_short_enough(rate_hz: float) -> None:
    h = substep_of(1 / rate_hz)
    assert 0 < h <= 1e-3
    assert abs(1 / rate_hz / h - round(1 / rate_hz / h)) < 1e-9
    assert substep_of(0.005) == 1e-3
