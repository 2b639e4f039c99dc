"""The arm model by definition: derivatives by differences, frames by transforms, a plane by its rows; URDFs refused."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import pinocchio as pin
import pytest

from agent.control.models import ArmModel, ModelError
from drivers.interface import Vector
from tests.support.control.strategies import PLANE_JOINTS, SIX_JOINTS, urdf

H = 1e-6
GRAVITY = np.array([0.3, -0.2, -9.0])
GRASP = pin.SE3(pin.exp3(np.array([0.2, -0.1, 0.4])), np.array([0.01, 0.02, 0.03]))
BASE = pin.SE3(pin.exp3(np.array([0.7, -0.4, 1.1])), np.array([0.3, -0.2, 0.1]))
STATES = {
    3: (np.array([0.3, -0.5, 0.4]), np.array([0.7, -0.3, 0.9])),
    6: (np.array([0.2, 0.3, -0.5, 0.4, 0.6, -0.1]), np.array([0.7, -0.3, 0.9, 0.2, -0.6, 0.4])),
}
BOTH = pytest.mark.parametrize("n", [3, 6], ids=["planar", "six joints"])
MASSLESS = re.sub(r'mass value="[^"]*"', 'mass value="0"', re.sub(r'(i[xyz]{2})="[^"]*"', r'\1="0"', urdf("wx200")))


def arm(n: int = 3, base: pin.SE3 = BASE, xml: str | None = None, rotor: Sequence[float] | None = None) -> ArmModel:
    name, joints = ("wx200", PLANE_JOINTS) if n == 3 else ("wx250s", SIX_JOINTS)
    locked = {"waist": 0.3, "wrist_rotate": 0.0} if n == 3 else {}
    inertia = np.array(rotor or 0.01 * np.arange(1.0, n + 1.0))
    return ArmModel(xml or urdf(name), joints, locked, base, "ee", GRASP, inertia, GRAVITY)


def jacobian_by_differences(model: ArmModel, q: Vector) -> Vector:
    """(6, n): how the object's frame moves with each joint, world axes, linear first."""
    columns = []
    for step in H * np.eye(model.n):
        before, after = model.object_pose(q - step), model.object_pose(q + step)
        turned = pin.log3(after.rotation @ before.rotation.T)
        columns.append(np.concatenate([after.translation - before.translation, turned]) / (2.0 * H))
    return np.array(columns).T


def rate(before: Vector, after: Vector) -> Vector:
    difference: Vector = (after - before) / (2.0 * H)
    return difference


@BOTH
def test_velocities_are_derivatives_of_poses(n: int) -> None:
    model, (q, dq) = arm(n), STATES[n]
    k, J = model.evaluate(q, dq), jacobian_by_differences(model, q)
    assert k.J.shape == (n, n) == (model.task_dimension, model.n)
    assert np.allclose(k.Jt, J.T, atol=1e-8)
    assert np.allclose(k.J, model.task_basis @ J, atol=1e-8)
    assert np.allclose(k.v_object, J @ dq, atol=1e-8)
    before, after = (model.evaluate(q + sign * H * dq, dq) for sign in (-1.0, 1.0))
    assert np.allclose(k.dJ, rate(before.J, after.J), atol=1e-7)
    assert np.allclose(model.jacobian(q), k.J, atol=1e-14)


@BOTH
def test_dynamics_are_derivatives_of_energies(n: int) -> None:
    """g of the potential energy −m gᵀc, and Ḃ = C + Cᵀ, of the inertia that is the kinetic energy's."""
    model, (q, dq) = arm(n), STATES[n]
    k = model.evaluate(q, dq)
    plain = model.model.copy()
    plain.armature = np.zeros(n)
    data = plain.createData()

    def potential(at: Vector) -> float:
        return float(-pin.computeTotalMass(plain) * GRAVITY @ pin.centerOfMass(plain, data, at))

    weight = [(potential(q + step) - potential(q - step)) / (2.0 * H) for step in H * np.eye(n)]
    assert np.allclose(k.g, weight, atol=1e-7)
    before, after = (model.inertia(q + sign * H * dq) for sign in (-1.0, 1.0))
    assert np.allclose(k.C + k.C.T, rate(before, after), atol=1e-7)
    rotors = 0.5 * float(dq @ (0.01 * np.arange(1.0, n + 1.0) * dq))
    assert 0.5 * dq @ k.B @ dq == pytest.approx(pin.computeKineticEnergy(plain, data, q, dq) + rotors)


@BOTH
def test_the_object_is_where_the_grasp_has_it_and_the_base_carries_it_all(n: int) -> None:
    model, (q, dq) = arm(n), STATES[n]
    k, here = model.evaluate(q, dq), model.object_pose(q)
    by_pose, _ = model.pose_and_jacobian(q)
    assert np.allclose(by_pose.homogeneous, here.homogeneous, atol=1e-15)
    at_origin = arm(n, pin.SE3.Identity())
    assert np.allclose(here.homogeneous, (BASE * at_origin.object_pose(q)).homogeneous, atol=1e-12)
    w, x, y, z = k.quat_object
    assert np.allclose(pin.Quaternion(w, x, y, z).matrix(), here.rotation, atol=1e-12)
    assert np.allclose(np.reshape(k.R_world_object, (3, 3)), here.rotation, atol=1e-12)
    assert np.allclose(k.p_object, here.translation, atol=1e-15)
    T_world_ee = here * GRASP
    assert np.allclose(k.p_ee_object, here.translation - T_world_ee.translation, atol=1e-12)
    frames = {}
    for of, at in ((model, q), (at_origin, q)):
        pin.framesForwardKinematics(of.model, of.data, at)
        frames[of] = [of.data.oMf[i] for i in range(1, of.model.nframes)]
    for moved, still in zip(frames[model], frames[at_origin], strict=True):
        assert np.allclose(moved.homogeneous, (BASE * still).homogeneous, atol=1e-12)


@BOTH
def test_it_has_the_joints_it_was_given_and_a_model_without_weight(n: int) -> None:
    model = arm(n)
    assert (model.joints, model.n) == (PLANE_JOINTS if n == 3 else SIX_JOINTS, n)
    assert np.array_equal(model.weightless.gravity.vector, np.zeros(6))
    assert model.task_is_identity is (n == 6)


AXES = [
    (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0), (0.8, 0.0, -0.6), (-0.6, 0.8, 0.0), (0.0, 0.6, -0.8),
    *np.random.default_rng(5).normal(size=(6, 3)).tolist(),
]  # fmt: skip


@pytest.mark.parametrize("axis", AXES, ids=[" ".join(f"{x:.1f}" for x in axis) for axis in AXES])
def test_task_rows_are_two_directions_of_the_plane_and_the_turn_about_its_normal(axis: tuple[float, ...]) -> None:
    """Right-handed, the normal's largest part positive, and the first row nearest to an axis."""
    y = np.array([0.0, 1.0, 0.0])
    to_axis = pin.Quaternion.FromTwoVectors(y, np.array(axis)).matrix()
    model = arm(base=pin.SE3(to_axis @ pin.exp3(np.array([0.0, 0.0, -0.3])), np.zeros(3)))  # the waist is at 0.3
    P, normal = model.task_basis, model.plane_normal
    assert normal is not None
    assert abs(np.array(axis) @ normal) == pytest.approx(np.linalg.norm(axis), rel=1e-12)
    assert normal[np.argmax(np.abs(normal))] > 0.0
    u, w = P[0, :3], P[1, :3]
    assert np.allclose(P @ P.T, np.eye(3), atol=1e-12)
    assert np.allclose([P[0, 3:], P[1, 3:], P[2, :3]], 0.0, atol=1e-15)
    assert np.allclose(P[2, 3:], normal, atol=1e-15)
    assert np.allclose(np.cross(u, w), normal, atol=1e-12)
    least = int(np.argmin(np.abs(normal)))
    assert u[least] == pytest.approx(np.sqrt(1.0 - normal[least] ** 2), abs=1e-12)
    zeros = np.concatenate([P[P == 0.0], normal[normal == 0.0]])
    assert not np.signbit(zeros).any(), "equal cells print equal"


def tilted(by_rad: float) -> str:
    head, tail = urdf("wx200").split('<joint name="elbow"')
    axis = f'<axis xyz="{np.sin(by_rad)} {np.cos(by_rad)} 0"/>'
    return f'{head}<joint name="elbow"{tail.replace("""<axis xyz="0 1 0"/>""", axis, 1)}'


def test_axes_of_a_plane_are_parallel_to_a_thousandth() -> None:
    """1 − cos of the angle between them is at most 1e-6."""
    assert arm(xml=tilted(1.4e-3)).task_dimension == 3
    with pytest.raises(ModelError, match="2 of them parallel to the first"):
        arm(xml=tilted(1.43e-3))


@pytest.mark.parametrize(
    ("rotor", "runs"), [([1.1e-9] * 3, True), ([0.9e-9] * 3, False), ([1.0, 0.9e-9, 1.0], False), ([0.0] * 3, False)]
)
def test_an_arm_that_a_torque_of_nothing_would_accelerate_is_refused(rotor: list[float], runs: bool) -> None:
    if runs:
        assert arm(xml=MASSLESS, rotor=rotor).n == 3
    else:
        with pytest.raises(ModelError, match="inertia of the controlled joints: found a smallest eigenvalue of "):
            arm(xml=MASSLESS, rotor=rotor)


HEAVY_TIP = re.sub(
    r'(name="gripper_(?:bar_)?link">\s*<inertial>.*?mass value=")[^"]*', r"\g<1>1e308", urdf("wx200"), flags=re.DOTALL
)  # two links in one: their sum is no number
LOOSE = [
    re.sub(rf'(joint name="{joint}" type=)"revolute"', r'\1"continuous"', urdf("wx200")) for joint in ("waist", "elbow")
]


@pytest.mark.parametrize(
    ("xml", "said"),
    [
        (HEAVY_TIP, "inertia of the controlled joints: found a smallest eigenvalue of nan"),
        ("<robot", r"URDF: found .+, expected a robot description; check it with check_urdf"),
        (LOOSE[0], r"joints of the URDF: found waist \(.*\), expected joints with one angle"),
        (LOOSE[1], r"joints of the URDF: found elbow \(.*\), expected joints with one angle"),
        (
            '<robot name="r"><link name="ee"/></robot>',
            r"joint names: found .*, expected joints that move: the URDF has none of them; give the URDF",
        ),
    ],
    ids=["overflow", "no URDF", "first joint", "another joint", "no joint"],
)
def test_a_urdf_that_describes_no_arm_is_refused(xml: str, said: str) -> None:
    with pytest.raises(ModelError, match=said):
        arm(xml=xml)


def test_numbers_become_rows_in_order() -> None:
    room = arm().scratch
    a, b, c = ((1.0, 2.0, 3.0, 4.0, 5.0, 6.0), (7.0,) * 6, (8.0, 9.0, 0.0, 1.0, 2.0, 3.0))
    first, second = room.two(a, b)
    assert (tuple(first), tuple(second)) == (a, b)
    assert room.three(a, b, c).tolist() == [list(a), list(b), list(c)]
