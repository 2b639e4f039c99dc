"""The arm files are what their sources say: kinematics, masses, gravity torques, servo maps."""

import itertools
import tomllib
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

import configs
from drivers.dynamixel.servo.models import SERVOS

ARMS_DIR = Path(configs.__file__).parent / "arms"
URDFS = ("widowx_mk2", "wx200", "wx250", "wx250s")
ARMS = (*URDFS, "awx250s")
FIGURES = ("rotor_inertia_kg_m2", "coulomb_Nm", "viscous_Nm_s_per_rad", "torque_constant_Nm_per_A", "no_load_current_A")

FIVE_JOINTS = ("waist", "shoulder", "elbow", "wrist_angle", "wrist_rotate")
SIX_JOINTS = ("waist", "shoulder", "elbow", "forearm_roll", "wrist_angle", "wrist_rotate")

unit_interval = st.floats(0.0, 1.0)
five_fractions = st.lists(unit_interval, min_size=5, max_size=5)


def model_of(urdf: str) -> pin.Model:
    return pin.buildModelFromUrdf(str(ARMS_DIR / f"{urdf}.urdf"))


MODELS = {urdf: model_of(urdf) for urdf in URDFS}


def arm_file(arm: str) -> dict[str, Any]:
    return tomllib.loads((ARMS_DIR / f"{arm}.toml").read_text(encoding="utf-8"))


def every_joint() -> list[Any]:
    return [pytest.param(joint, id=f"{arm}-{joint['name']}") for arm in ARMS for joint in arm_file(arm)["joints"]]


def every_inertial_link() -> list[Any]:
    found = []
    for urdf in URDFS:
        for link in ET.parse(ARMS_DIR / f"{urdf}.urdf").getroot().iter("link"):
            if link.find("inertial") is not None:
                found.append(pytest.param(link, id=f"{urdf}-{link.get('name')}"))
    return found


def mass_and_tensor(link: ET.Element) -> tuple[float, np.ndarray]:
    mass = float(link.find("inertial/mass").get("value"))
    inertia = link.find("inertial/inertia")
    xx, xy, xz, yy, yz, zz = (float(inertia.get(k)) for k in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    return mass, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def placement(urdf: str, q: np.ndarray, frame: str) -> pin.SE3:
    model = MODELS[urdf]
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[model.getFrameId(frame)]


def gravity_torque(urdf: str, q: np.ndarray) -> dict[str, float]:
    """Torque that holds the arm still, N·m by joint."""
    model = MODELS[urdf]
    torque = pin.computeGeneralizedGravity(model, model.createData(), q)
    return dict(zip(list(model.names)[1:], torque, strict=True))


def pose(urdf: str, **angles: float) -> np.ndarray:
    model = MODELS[urdf]
    q = pin.neutral(model)
    for joint, angle in angles.items():
        q[model.joints[model.getJointId(joint)].idx_q] = angle
    return q


def stretched(urdf: str) -> np.ndarray:
    """Upper arm, forearm and gripper level."""
    return pose(urdf, shoulder=np.pi / 2, elbow=-np.pi / 2)


def within_limits(urdf: str, fractions: list[float]) -> np.ndarray:
    lower, upper = MODELS[urdf].lowerPositionLimit, MODELS[urdf].upperPositionLimit
    return lower + np.array(fractions) * (upper - lower)


# --- kinematics -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("urdf", URDFS)
def test_joints_have_the_common_names_in_kinematic_order(urdf: str) -> None:
    assert tuple(MODELS[urdf].names)[1:] == (SIX_JOINTS if urdf == "wx250s" else FIVE_JOINTS)


@pytest.mark.parametrize(
    ("urdf", "position"),
    [
        ("wx200", (0.408575, 0.0, 0.31065)),
        ("wx250", (0.458325, 0.0, 0.36065)),
        ("wx250s", (0.458325, 0.0, 0.36065)),
        ("widowx_mk2", (0.35064, 0.0, 0.26703)),
    ],
)
def test_home_pose_is_the_published_one(urdf: str, position: tuple[float, float, float]) -> None:
    ee = placement(urdf, pose(urdf), "ee")
    assert ee.translation == pytest.approx(position, abs=1e-12)
    assert ee.rotation == pytest.approx(np.eye(3), abs=1e-12)


def test_mark_two_gripper_rail_is_where_the_original_has_it() -> None:
    rail = placement("widowx_mk2", pose("widowx_mk2"), "gripper_rail_link")
    assert rail.translation == pytest.approx((0.30478, 0.0, 0.26703), abs=1e-12)


def original_mark_two_gripper_rail(q: np.ndarray) -> pin.SE3:
    """Kinematics as Robotnik publishes them: frames turn at the elbow so that z runs along the gripper."""
    turn = pin.utils.rpyToMatrix
    return (
        pin.SE3(turn(0.0, 0.0, q[0]), np.array([0.0, 0.0, 0.125]))
        * pin.SE3(turn(0.0, q[1], 0.0), np.zeros(3))
        * pin.SE3(turn(0.0, np.pi / 2, 0.0) @ turn(0.0, q[2], 0.0), np.array([0.04825, 0.0, 0.14203]))
        * pin.SE3(turn(0.0, q[3], 0.0), np.array([0.0, 0.0, 0.14203]))
        * pin.SE3(turn(0.0, 0.0, q[4]), np.array([0.0, 0.0, 0.0715]))
        * pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.043]))
    )


@given(five_fractions)
def test_mark_two_moves_as_the_original_with_x_in_place_of_z(fractions: list[float]) -> None:
    q = within_limits("widowx_mk2", fractions)
    ours, original = placement("widowx_mk2", q, "gripper_rail_link"), original_mark_two_gripper_rail(q)
    assert ours.translation == pytest.approx(original.translation, abs=1e-12)
    assert ours.rotation[:, 0] == pytest.approx(original.rotation[:, 2], abs=1e-12)
    assert ours.rotation[:, 1] == pytest.approx(original.rotation[:, 1], abs=1e-12)


@pytest.mark.parametrize("urdf", URDFS)
@given(fractions=st.lists(unit_interval, min_size=6, max_size=6))
def test_ee_x_axis_points_out_of_the_hand(urdf: str, fractions: list[float]) -> None:
    q = within_limits(urdf, fractions[: MODELS[urdf].nq])
    ee, gripper = placement(urdf, q, "ee"), placement(urdf, q, "gripper_link")
    out_of_hand = ee.translation - gripper.translation
    assert ee.rotation[:, 0] == pytest.approx(out_of_hand / np.linalg.norm(out_of_hand), abs=1e-12)


def test_mark_two_end_effector_is_the_authors_l3_from_the_wrist() -> None:
    q = pose("widowx_mk2", shoulder=0.3, elbow=0.4, wrist_angle=-0.2)
    reach = placement("widowx_mk2", q, "ee").translation - placement("widowx_mk2", q, "wrist_link").translation
    assert np.linalg.norm(reach) == pytest.approx(0.16036, abs=1e-12)


# --- masses and gravity -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("urdf", "moving_kg"), [("wx200", 1.291184), ("wx250", 1.438236), ("wx250s", 1.596143), ("widowx_mk2", 0.787)]
)
def test_moving_mass_is_that_of_the_source_without_its_dummies(urdf: str, moving_kg: float) -> None:
    assert sum(inertia.mass for inertia in list(MODELS[urdf].inertias)[1:]) == pytest.approx(moving_kg, abs=1e-6)


@pytest.mark.parametrize("link", every_inertial_link())
def test_inertia_is_physical(link: ET.Element) -> None:
    _, tensor = mass_and_tensor(link)
    small, middle, large = np.linalg.eigvalsh(tensor)
    assert small > 0.0
    assert small + middle >= large


@pytest.mark.parametrize("link", every_inertial_link())
def test_no_link_turns_heavier_than_its_size_allows(link: ET.Element) -> None:
    mass, tensor = mass_and_tensor(link)
    assert np.sqrt(np.trace(tensor) / (2.0 * mass)) < 0.12  # a dummy of 1 g and 1e-3 kg m^2 has 1.2 m


@pytest.mark.parametrize(
    ("urdf", "shoulder_home", "shoulder_stretched", "elbow", "wrist"),
    [
        ("wx200", 1.26, 2.39, 0.974, 0.188),
        ("wx250", 1.53, 3.30, 1.197, 0.188),
        ("wx250s", 1.87, 3.95, 1.458, 0.188),
        ("widowx_mk2", 0.734, 1.342, 0.538, 0.125),
    ],
)
def test_gravity_torques_are_those_of_the_fact_sheet(
    urdf: str, shoulder_home: float, shoulder_stretched: float, elbow: float, wrist: float
) -> None:
    home, level = gravity_torque(urdf, pose(urdf)), gravity_torque(urdf, stretched(urdf))
    assert -home["shoulder"] == pytest.approx(shoulder_home, abs=6e-3)
    assert -level["shoulder"] == pytest.approx(shoulder_stretched, abs=6e-3)
    for torque in (home, level):
        assert -torque["elbow"] == pytest.approx(elbow, abs=6e-4)
        assert -torque["wrist_angle"] == pytest.approx(wrist, abs=6e-4)


def authors_gravity_torque(q: np.ndarray) -> np.ndarray:
    """Shoulder, elbow, wrist of Mark II as the paper's authors modelled it; their angles are positive upward."""
    t2, t3, t4 = np.pi / 2 - q[1], -np.pi / 2 - q[2], -q[3]
    wrist = 0.138436 * np.cos(t2 + t3 + t4)
    elbow = wrist + 0.403364 * np.cos(t2 + t3)
    shoulder = elbow + 0.694745 * np.cos(t2) + 0.216491 * np.sin(t2)
    return -np.array([shoulder, elbow, wrist])


@pytest.mark.parametrize(
    ("q", "differences"),
    [(pose("widowx_mk2"), (-0.03, -0.01, -0.10)), (stretched("widowx_mk2"), (0.09, -0.01, -0.10))],
    ids=["home", "stretched"],
)
def test_mark_two_differs_from_the_authors_model_by_the_stated_amounts(
    q: np.ndarray, differences: tuple[float, float, float]
) -> None:
    torque = gravity_torque("widowx_mk2", q)
    ours = np.array([torque["shoulder"], torque["elbow"], torque["wrist_angle"]])
    assert ours / authors_gravity_torque(q) - 1.0 == pytest.approx(differences, abs=5e-3)


@given(five_fractions)
def test_mark_two_agrees_with_the_authors_model_everywhere(fractions: list[float]) -> None:
    q = within_limits("widowx_mk2", fractions)
    q[4] = 0.0  # their model has no wrist rotation
    torque = gravity_torque("widowx_mk2", q)
    ours = np.array([torque["shoulder"], torque["elbow"], torque["wrist_angle"]])
    assert (np.abs(ours - authors_gravity_torque(q)) < (0.15, 0.035, 0.026)).all()


# --- servo maps -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("arm", ARMS)
def test_servo_map_names_the_joints_of_its_urdf(arm: str) -> None:
    file = arm_file(arm)
    model = MODELS[file["urdf"].removesuffix(".urdf")]
    names = [joint["name"] for joint in file["joints"]]
    assert names == list(model.names)[1:]
    assert list(file["sleep_rad"]) == names
    assert model.existFrame(file["ee_frame"])
    assert file["model"] == arm


@pytest.mark.parametrize("arm", ARMS)
def test_servo_ids_are_unique_and_without_gaps(arm: str) -> None:
    file = arm_file(arm)
    ids = list(itertools.chain.from_iterable(joint["ids"] for joint in [*file["joints"], file["gripper"]]))
    assert ids == list(range(1, len(ids) + 1))


@pytest.mark.parametrize("arm", URDFS)
def test_urdf_limits_are_what_the_servos_can_do(arm: str) -> None:
    model = MODELS[arm]
    for index, joint in enumerate(arm_file(arm)["joints"]):
        servo = SERVOS[joint["servo"]]
        assert model.effortLimit[index] == pytest.approx(servo.stall_torque_Nm * len(joint["ids"]))
        assert model.velocityLimit[index] == pytest.approx(servo.no_load_rad_per_s, abs=1e-4)


def test_aloha_variant_asks_no_more_of_its_servos_than_they_have() -> None:
    effort = MODELS["wx250s"].effortLimit
    for index, joint in enumerate(arm_file("awx250s")["joints"]):
        assert effort[index] <= SERVOS[joint["servo"]].stall_torque_Nm * len(joint["ids"])


@pytest.mark.parametrize("arm", ARMS)
def test_tick_limits_are_the_urdf_limits(arm: str) -> None:
    file = arm_file(arm)
    model = MODELS[file["urdf"].removesuffix(".urdf")]
    for index, joint in enumerate(file["joints"]):
        tick_rad = SERVOS[joint["servo"]].tick_rad
        limits = (np.array(joint["position_limit_ticks"]) - joint["zero_tick"]) * tick_rad
        expected = (model.lowerPositionLimit[index], model.upperPositionLimit[index])
        assert limits == pytest.approx(expected, abs=1.5 * tick_rad)


@pytest.mark.parametrize("arm", ARMS)
def test_sleep_pose_is_within_limits(arm: str) -> None:
    file = arm_file(arm)
    model = MODELS[file["urdf"].removesuffix(".urdf")]
    sleep = np.array(list(file["sleep_rad"].values()))
    assert (sleep >= model.lowerPositionLimit).all()
    assert (sleep <= model.upperPositionLimit).all()


@pytest.mark.parametrize("joint", every_joint())
def test_a_shadow_servo_faces_its_master(joint: dict[str, Any]) -> None:
    assert len(joint["reverse"]) == len(joint["ids"])
    assert len(joint["ids"]) == 1 or joint["reverse"] == [False, True]


@pytest.mark.parametrize("joint", every_joint())
def test_every_figure_has_a_status_and_a_source(joint: dict[str, Any]) -> None:
    figures = {name: joint[name] for name in FIGURES if name in joint}
    assert {"rotor_inertia_kg_m2", "coulomb_Nm", "viscous_Nm_s_per_rad"} <= figures.keys()
    for name, figure in figures.items():
        assert figure["status"] in {"measured", "published", "estimated"}, name
        assert len(figure["source"]) > 10, name
        assert figure["value"] > 0.0, name


@pytest.mark.parametrize("joint", every_joint())
def test_torque_constant_is_given_exactly_where_current_is_sensed(joint: dict[str, Any]) -> None:
    servo = SERVOS[joint["servo"]]
    assert ("torque_constant_Nm_per_A" in joint) == servo.has_current_mode
    assert ("no_load_current_A" in joint) == servo.has_current_mode
    if servo.has_current_mode:
        assert joint["torque_constant_Nm_per_A"]["value"] == pytest.approx(servo.torque_constant_Nm_per_A, rel=1e-3)


@pytest.mark.parametrize("joint", every_joint())
def test_motor_time_constant_is_that_of_a_small_motor(joint: dict[str, Any]) -> None:
    damping = SERVOS[joint["servo"]].back_emf_damping_Nm_s_per_rad * len(joint["ids"])
    assert 0.005 < joint["rotor_inertia_kg_m2"]["value"] / damping < 0.050  # s; identified: 13 (MX-64) to 49 (XL330)


@pytest.mark.parametrize("joint", every_joint())
def test_friction_is_a_small_part_of_the_stall_torque(joint: dict[str, Any]) -> None:
    servo = SERVOS[joint["servo"]]
    at_full_speed = joint["coulomb_Nm"]["value"] + joint["viscous_Nm_s_per_rad"]["value"] * servo.no_load_rad_per_s
    assert at_full_speed < 0.1 * servo.stall_torque_Nm * len(joint["ids"])
