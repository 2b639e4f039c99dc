"""Random cells and states for property tests: valid closed chains of the shipped arms.

A cell is drawn from a few structural choices and one seed.  Every arm gets random joint angles and a random
grasp, and its base is put where the object poses of all arms coincide.  Planar cells lie in a random plane.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pinocchio as pin
from hypothesis import settings
from hypothesis import strategies as st

import configs
from agent.control import internal_force
from agent.control.errors import Gains
from agent.control.friction import Friction, JointFriction
from agent.control.inverse import SingularJacobian, invert_jacobian
from agent.control.law import Offline
from agent.control.models import ArmModel
from agent.control.quaternion import Quat, Vec3, from_axis_angle, multiply
from agent.control.trajectory import Desired
from drivers.interface import Vector

PLANAR_ARMS = ("widowx_mk2", "wx200", "wx250", "wx250s")
SIX_JOINT_ARM = "wx250s"
SIX_JOINTS = ("waist", "shoulder", "elbow", "forearm_roll", "wrist_angle", "wrist_rotate")
PLANE_JOINTS = ("shoulder", "elbow", "wrist_angle")
SIGMA_MIN = 0.08  # of the Mark II's poses a quarter are so far from singular, 1 in 2000 above 0.1


def examples(count: int) -> settings:
    """Hypothesis settings of the loaded profile (tests/conftest.py) with so many examples in `make long`.

    A quarter in `make test`: what is wrong with a law shows in the first.
    """
    whole = settings().max_examples > settings.get_profile("repeatable").max_examples
    return settings(max_examples=count if whole else max(8, count // 4))


@dataclass(frozen=True)
class Holder:
    """One arm that holds the object, in a state that agrees with the other arms of its cell."""

    model: ArmModel
    offline: Offline
    name: str  # of the shipped arm
    T_world_base: pin.SE3
    T_object_ee: pin.SE3
    q: Vector
    dq: Vector


@dataclass(frozen=True)
class RandomCell:
    """A closed chain at one instant."""

    arms: tuple[Holder, ...]
    P: Vector  # (m, 6) task basis, that of the first arm
    T_world_object: pin.SE3
    v_object: Vector  # (6,) in the task space
    desired: Desired

    @property
    def grasps(self) -> list[Vec3]:
        """p^O_{E/O} of every arm."""
        return [tuple(a.T_object_ee.translation.tolist()) for a in self.arms]


def cells(planar: bool | None = None, *, scalar_gains: bool = False) -> st.SearchStrategy[RandomCell]:
    """Random cells of two to four arms; planar: None draws both kinds."""
    kinds = st.booleans() if planar is None else st.just(planar)
    return st.builds(
        make_cell,
        seed=st.integers(0, 2**32 - 1),
        planar=kinds,
        arm_count=st.integers(2, 4),
        scalar_gains=st.just(scalar_gains),
    )


def random_unit(rng: np.random.Generator) -> Vector:
    """(3,) direction."""
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def random_pose(rng: np.random.Generator, reach_m: float) -> pin.SE3:
    """Any attitude, position within a cube."""
    return pin.SE3(pin.Quaternion(random_unit_quaternion(rng)), rng.uniform(-reach_m, reach_m, 3))


def random_unit_quaternion(rng: np.random.Generator) -> Vector:
    """(4,) in pinocchio's order (x, y, z, w)."""
    v = rng.normal(size=4)
    return v / np.linalg.norm(v)


def random_inertia(rng: np.random.Generator) -> Vector:
    """(3, 3) tensor of some rigid body of a few hundred cm²·kg, arbitrary principal axes."""
    a, b, c = rng.uniform(1e-4, 3e-3, 3)
    R = pin.Quaternion(random_unit_quaternion(rng)).matrix()
    return R @ np.diag([b + c, a + c, a + b]) @ R.T


@cache
def urdf(name: str) -> str:
    """Text of a shipped URDF."""
    return (configs.ARMS_DIR / f"{name}.urdf").read_text()


RAIL = """<link name="floor"/><joint name="rail" type="prismatic"><parent link="floor"/><child link="base_link"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="10" velocity="1"/></joint>"""


def urdf_on_rail(name: str) -> str:
    """Text of a shipped URDF with a joint `rail` below its base."""
    return urdf(name).replace('<link name="base_link"', RAIL + '<link name="base_link"', 1)


def controlled_joints(planar: bool) -> tuple[str, ...]:
    """Joints of a planar or of a six-dimensional arm."""
    return PLANE_JOINTS if planar else SIX_JOINTS


def locked_joints(name: str, controlled: tuple[str, ...]) -> dict[str, float]:
    """The other joints of that arm, at zero."""
    names = list(pin.buildModelFromXML(urdf(name)).names)[1:]
    return {j: 0.0 for j in names if j not in controlled}


def arm_model(
    name: str, planar: bool, T_world_base: pin.SE3, T_object_ee: pin.SE3, rotor: Vector, gravity: Vector
) -> ArmModel:
    """A shipped arm as the controller models it."""
    controlled = controlled_joints(planar)
    return ArmModel(
        urdf(name), controlled, _locked(name, planar), T_world_base, "ee", T_object_ee, rotor, gravity
    )  # fmt: skip


@cache
def _locked(name: str, planar: bool) -> dict[str, float]:
    return locked_joints(name, controlled_joints(planar))


@cache
def _at_origin(name: str, planar: bool) -> ArmModel:
    n = len(controlled_joints(planar))
    return arm_model(name, planar, pin.SE3.Identity(), pin.SE3.Identity(), np.zeros(n), np.zeros(3))


def random_joints(rng: np.random.Generator, model: ArmModel, sigma_min: float = SIGMA_MIN) -> Vector:
    """(n,) joint angles within the limits and away from singular poses."""
    lower, upper = model.model.lowerPositionLimit, model.model.upperPositionLimit
    width = upper - lower
    while True:
        q = lower + width * rng.random(model.n)  # `uniform` looks through arrays of bounds each time
        if _smallest_above(model.jacobian(q), sigma_min):
            return q


def _smallest_above(J: Vector, bound: float) -> bool:
    """Whether the smallest singular value of a square J is above a bound; by its inverse where that tells.

    1 / ‖J⁻¹‖_F ≤ σ ≤ √n / ‖J⁻¹‖_F
    """
    try:
        least = invert_jacobian(J, J)[1]
    except SingularJacobian:
        return False
    if least > bound or least * math.sqrt(len(J)) <= bound:
        return least > bound
    return bool(np.linalg.svd(J, compute_uv=False)[-1] > bound)


def make_cell(
    seed: int, planar: bool, arm_count: int, scalar_gains: bool = False, sigma_min: float = SIGMA_MIN
) -> RandomCell:
    """The cell of that seed; sigma_min keeps the end-effector Jacobians away from singularity."""
    rng = np.random.default_rng(seed)
    T_world_object = random_pose(rng, 1.0)
    normal_object = random_unit(rng)
    gravity = 9.81 * random_unit(rng)
    shares = rng.dirichlet(np.ones(arm_count))
    inertia, mass = random_inertia(rng), rng.uniform(0.02, 0.5)
    k_p, k_eps = _gain_triples(rng, planar or scalar_gains)
    arms = []
    for c in shares:
        name = str(rng.choice(PLANAR_ARMS)) if planar else SIX_JOINT_ARM
        reference = _at_origin(name, planar)
        q = random_joints(rng, reference, sigma_min)
        T_base_ee = reference.object_pose(q)
        T_object_ee = pin.SE3(_grasp_attitude(rng, reference, T_base_ee, normal_object), rng.uniform(-0.1, 0.1, 3))
        T_world_base = T_world_object * T_object_ee * T_base_ee.inverse()
        model = arm_model(name, planar, T_world_base, T_object_ee, rng.uniform(0.002, 0.05, reference.n), gravity)
        k_v = rng.uniform(1.0, 20.0, 1 if planar or scalar_gains else 6)
        offline = Offline(
            gains=Gains(k_p, k_eps, k_p, k_eps, tuple(np.broadcast_to(k_v, 6).tolist())),
            load_share=float(c),
            object_mass_kg=float(mass),
            object_inertia=tuple(inertia.ravel().tolist()),
            gravity=tuple(gravity.tolist()),
        )
        arms.append(Holder(model, offline, name, T_world_base, T_object_ee, q, np.zeros(reference.n)))
    P = arms[0].model.task_basis
    v_object = P.T @ rng.normal(scale=0.5, size=len(P))
    moving = tuple(replace(a, dq=joint_velocity(a, v_object)) for a in arms)
    return RandomCell(moving, P, T_world_object, v_object, _desired(rng, T_world_object, P))


def with_internal_wrenches(cell: RandomCell, seed: int) -> RandomCell:
    """The same cell whose agents also regulate a random internal force."""
    desired = np.random.default_rng(seed).normal(scale=3.0, size=(len(cell.arms), 6)).tolist()
    arms = tuple(
        replace(a, offline=replace(a.offline, internal_wrench=internal_force.agent_wrench(i, cell.grasps, desired)))
        for i, a in enumerate(cell.arms)
    )
    return replace(cell, arms=arms)


def random_friction(rng: np.random.Generator) -> JointFriction:
    """Friction of some servo, with every part of it."""
    low, high = (0.0, 0.0, 0.0, 0.1, 0.5, 0.0, 0.0), (0.1, 0.05, 0.1, 2.0, 2.0, 0.2, 0.4)
    return JointFriction(*rng.uniform(low, high).tolist())


def with_friction(arm: Holder, rng: np.random.Generator) -> Holder:
    """The same arm with friction feed-forward."""
    n = arm.model.n
    friction = Friction(tuple(random_friction(rng) for _ in range(n)), 0.05)
    return replace(arm, offline=replace(arm.offline, friction=friction))


def joint_velocity(arm: Holder, v_object: Vector) -> Vector:
    """(n,) joint velocity of this arm when the object moves with v_object (6,)."""
    return np.linalg.solve(arm.model.jacobian(arm.q), arm.model.task_basis @ v_object)


def _gain_triples(rng: np.random.Generator, scalar: bool) -> tuple[tuple[float, ...], tuple[float, ...]]:
    size = 1 if scalar else 3
    k_p, k_eps = rng.uniform(1.0, 150.0, size), rng.uniform(1.0, 100.0, size)
    return tuple(np.broadcast_to(k_p, 3).tolist()), tuple(np.broadcast_to(k_eps, 3).tolist())


def _grasp_attitude(rng: np.random.Generator, reference: ArmModel, T_base_ee: pin.SE3, normal_object: Vector) -> Vector:
    """R_object_ee: any in six dimensions; in a plane, the arm's joint axes along ± the common normal."""
    if reference.plane_normal is None:
        return pin.Quaternion(random_unit_quaternion(rng)).matrix()
    normal_ee = T_base_ee.rotation.T @ reference.plane_normal
    side = rng.choice([-1.0, 1.0])
    turn = pin.AngleAxis(rng.uniform(-np.pi, np.pi), normal_object).matrix()
    return turn @ pin.Quaternion.FromTwoVectors(normal_ee, side * normal_object).matrix()


def _desired(rng: np.random.Generator, T: pin.SE3, P: Vector) -> Desired:
    """A desired motion within the task space, its attitude up to 2.6 rad away, either sign of the quaternion."""
    m = len(P)
    p = T.translation + (P.T @ rng.normal(scale=0.1, size=m))[:3]
    axis = P[2, 3:] if m == 3 else random_unit(rng)
    turn = from_axis_angle(tuple(axis.tolist()), float(rng.uniform(-2.6, 2.6)))
    quat: Quat = multiply(turn, quaternion_of(T))
    if rng.random() < 0.5:
        quat = tuple(-x for x in quat)
    v, a = P.T @ rng.normal(scale=0.4, size=m), P.T @ rng.normal(scale=1.0, size=m)
    return Desired(tuple(p.tolist()), quat, tuple(v.tolist()), tuple(a.tolist()))


def quaternion_of(T: pin.SE3) -> Quat:
    """Scalar-first attitude of a placement."""
    x, y, z, w = pin.Quaternion(T.rotation).coeffs().tolist()
    return (w, x, y, z)


def quaternion_step(quat: Quat, w: Vector) -> Quat:
    """Attitude after turning by the rotation vector w (3,), world axes."""
    angle = float(np.linalg.norm(w))
    if angle == 0.0:
        return quat
    return multiply(from_axis_angle(tuple((w / angle).tolist()), angle), quat)
