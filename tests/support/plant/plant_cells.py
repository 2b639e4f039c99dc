"""Cells for the plant's tests: small arms of their own, not those that ship."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from drivers.interface import Vector
from sim_backend.physics.actuator import ActuatorSpec
from sim_backend.physics.composition import solve_grasp
from sim_backend.physics.spec import ArmSpec, ObjectSpec, PlantSpec


def _link(name: str, mass: float, com: str, inertia: tuple[float, float, float]) -> str:
    xx, yy, zz = inertia
    return (
        f'<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass}"/>'
        f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def _joint(name: str, parent: str, child: str, at: str, axis: str) -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/><origin xyz="{at}"/>'
        f'<axis xyz="{axis}"/><limit lower="-3" upper="3" effort="9" velocity="9"/></joint>'
    )


def _ee(parent: str, at: str) -> str:
    return (
        f'<link name="ee"/><joint name="ee" type="fixed"><parent link="{parent}"/><child link="ee"/>'
        f'<origin xyz="{at}"/></joint>'
    )


PLANAR_JOINTS = ("shoulder", "elbow", "wrist_angle")
PLANAR_URDF = "".join(
    [
        '<robot name="planar"><link name="base"/>',
        _joint("waist", "base", "turret", "0 0 0", "0 0 1"),
        _link("turret", 0.06, "0 0 -0.04", (2.6e-5, 2.6e-5, 2.7e-5)),
        _joint("shoulder", "turret", "upper", "0 0 0.125", "0 1 0"),
        _link("upper", 0.362, "0.00667 0 0.0834", (1.13e-3, 1.13e-3, 8.8e-5)),
        _joint("elbow", "upper", "fore", "0.04825 0 0.14203", "0 1 0"),
        _link("fore", 0.187, "0.091 0 0", (3.7e-5, 4.2e-4, 4.2e-4)),
        _joint("wrist_angle", "fore", "hand", "0.14203 0 0", "0 1 0"),
        _link("hand", 0.154, "0.06 0 0.005", (2.0e-5, 6.0e-5, 7.0e-5)),
        _ee("hand", "0.16036 0 0"),
        "</robot>",
    ]
)

SPATIAL_JOINTS = ("waist", "shoulder", "elbow", "forearm_roll", "wrist_angle", "wrist_rotate")
SPATIAL_URDF = "".join(
    [
        '<robot name="spatial"><link name="base"/>',
        _joint("waist", "base", "turret", "0 0 0.072", "0 0 1"),
        _link("turret", 0.48, "0 0 0.0066", (5.6e-4, 3.8e-4, 5.9e-4)),
        _joint("shoulder", "turret", "upper", "0 0 0.03865", "0 1 0"),
        _link("upper", 0.43, "0.0119 0 0.201", (2.0e-3, 1.9e-3, 2.5e-4)),
        _joint("elbow", "upper", "fore", "0.04975 0 0.25", "0 1 0"),
        _link("fore", 0.16, "0.105 0 0", (5.0e-5, 5.0e-4, 5.0e-4)),
        _joint("forearm_roll", "fore", "roll", "0.175 0 0", "1 0 0"),
        _link("roll", 0.12, "0.038 0 0", (4.0e-5, 9.0e-5, 8.0e-5)),
        _joint("wrist_angle", "roll", "wrist", "0.075 0 0", "0 1 0"),
        _link("wrist", 0.085, "0.042 0 0.0106", (3.1e-5, 2.8e-5, 3.2e-5)),
        _joint("wrist_rotate", "wrist", "hand", "0.065 0 0", "1 0 0"),
        _link("hand", 0.11, "0.04 0 0", (4.7e-5, 5.5e-5, 8.9e-5)),
        _ee("hand", "0.0936 0 0"),
        "</robot>",
    ]
)

X, Y, Z = np.eye(3)
GRAVITY = np.array([0.0, -9.81, 0.0])
BOX = ObjectSpec(
    mass_kg=0.062,
    inertia=np.diag([0.062 * (0.044**2 + 0.03**2), 0.062 * (0.135**2 + 0.03**2), 0.062 * (0.135**2 + 0.044**2)]) / 12,
    p_world=np.array([0.301, 0.123, 0.0]),
    quat_world=np.array([1.0, 0.0, 0.0, 0.0]),
)


def axes(x: Vector, y: Vector, z: Vector) -> Vector:
    """Rotation matrix with the given columns."""
    return np.array([x, y, z]).T


R_LEFT = axes(X, -Z, Y)  # base z up (world y), gripper along world x
R_RIGHT = axes(-X, Z, Y)


def planar_arm(name: str, servos: ActuatorSpec | None = None, rotor_inertia: float = 0.012) -> ArmSpec:
    """`left` or `right` arm of the paper's cell, on its grasp."""
    left = name == "left"
    R = R_LEFT if left else R_RIGHT
    arm = ArmSpec(
        name=name,
        urdf_xml=PLANAR_URDF,
        controlled=PLANAR_JOINTS,
        locked_rad={"waist": 0.0},
        T_world_base=pin.SE3(R, np.array([0.0 if left else 0.603, -0.125, 0.0])),
        ee_frame="ee",
        T_object_ee=pin.SE3(R, np.array([-0.04 if left else 0.04, 0.0, 0.0])),
        q_start=np.zeros(3),
        rotor_inertia=np.full(3, rotor_inertia),
        actuator=servos or ActuatorSpec.of(3),
    )
    return replace(arm, q_start=solve_grasp(arm, BOX, np.array([-0.3, 0.3, 0.0])))


def planar_cell(
    servos: ActuatorSpec | None = None, *, names: Sequence[str] = ("left", "right"), **settings: float
) -> PlantSpec:
    """The paper's cell, or one arm of it; `settings` go to PlantSpec."""
    return PlantSpec(tuple(planar_arm(n, servos) for n in names), BOX, GRAVITY, **settings)


def spatial_cell(count: int, servos: ActuatorSpec | None = None, **settings: float) -> PlantSpec:
    """`count` six-joint arms around the object, gravity along -z; `settings` go to PlantSpec."""
    body = replace(BOX, p_world=np.array([0.0, 0.0, 0.3]))
    arms = []
    for i in range(count):
        R = pin.utils.rotate("z", 2 * np.pi * i / count)
        arm = ArmSpec(
            name=f"arm{i}",
            urdf_xml=SPATIAL_URDF,
            controlled=SPATIAL_JOINTS,
            locked_rad={},
            T_world_base=pin.SE3(R, R @ np.array([-0.42, 0.02, 0.0])),
            ee_frame="ee",
            T_object_ee=pin.SE3(R, R @ np.array([-0.05, 0.0, 0.01])),
            q_start=np.zeros(6),
            rotor_inertia=np.linspace(0.012, 0.007, 6),
            actuator=servos or ActuatorSpec.of(6),
        )
        arms.append(replace(arm, q_start=solve_grasp(arm, body, np.array([0.0, -0.6, 0.4, 0.1, 0.3, 0.1]))))
    return PlantSpec(tuple(arms), body, np.array([0.0, 0.0, -9.81]), **settings)
