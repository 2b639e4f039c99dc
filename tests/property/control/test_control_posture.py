"""The null-space posture of an arm with seven joints: invisible at the object, and it gets there."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
from hypothesis import given
from hypothesis import strategies as st

from agent.control import adaptive, known
from agent.control.errors import Gains
from agent.control.law import Offline
from agent.control.models import ArmModel
from agent.control.posture import Posture
from agent.control.quaternion import angle_between
from agent.control.trajectory import Desired
from drivers.interface import Vector
from tests.support.control.adaptive_cells import adaptation, nominal_of
from tests.support.control.strategies import RandomCell, cells, examples, urdf_on_rail

POSTURE = Posture((0.25, *(0.1,) * 6), 4.0, 3.0)


def on_a_rail(cell: RandomCell) -> tuple[ArmModel, Offline, Vector]:
    """The first arm of the cell on a seventh, prismatic joint; its offline data with the posture; its start."""
    six = cell.arms[0]
    xml = urdf_on_rail(six.name)
    rotor = np.array([2.0, *six.model.model.armature])
    model = ArmModel(
        xml, ("rail", *six.model.joints), {}, six.T_world_base, "ee", six.T_object_ee, rotor,
        six.model.model.gravity.linear,
    )  # fmt: skip
    return model, replace(six.offline, posture=POSTURE), np.array([0.0, *six.q])


@given(cells(planar=False), st.integers(0, 2**32 - 1))
@examples(30)
def test_posture_neither_pushes_nor_moves_the_object(cell: RandomCell, seed: int) -> None:
    model, offline, q = on_a_rail(cell)
    dq = np.random.default_rng(seed).normal(scale=0.5, size=7)
    with_posture = known.torque(model, offline, q, dq, cell.desired)
    without = known.torque(model, replace(offline, posture=None), q, dq, cell.desired)
    tau = with_posture.tau_posture
    assert tau is not None
    assert np.abs(tau).max() > 1e-6
    k = with_posture.kinematics
    scale = max(1.0, np.abs(np.array(without.wrench_cmd)).max())
    assert np.abs(np.array(with_posture.wrench_cmd) - np.array(without.wrench_cmd)).max() < 1e-9 * scale
    leak = k.J @ np.linalg.solve(k.B, tau)
    assert np.abs(leak).max() < 1e-9 * max(1.0, np.abs(np.linalg.solve(k.B, tau)).max())
    np.testing.assert_allclose(with_posture.tau_cmd, without.tau_cmd + tau, atol=1e-12)


@given(cells(planar=False), st.integers(0, 2**32 - 1))
@examples(30)
def test_the_adaptive_law_keeps_the_same_posture(cell: RandomCell, seed: int) -> None:
    model, offline, q = on_a_rail(cell)
    dq = np.random.default_rng(seed).normal(scale=0.5, size=7)
    truth = nominal_of(replace(cell.arms[0], model=model, offline=offline))
    by_law = known.torque(model, offline, q, dq, cell.desired)
    found, _ = adaptive.torque(model, offline, adaptation(truth), truth, q, dq, cell.desired)
    assert found.tau_posture is not None
    np.testing.assert_allclose(found.tau_posture, by_law.tau_posture, atol=1e-12)
    np.testing.assert_allclose(found.tau_cmd, by_law.tau_cmd, rtol=1e-9, atol=1e-9)


def test_seven_joints_hold_the_object_while_the_posture_settles() -> None:
    """Closed loop of one arm alone: the rail moves to its place, the object stays where it is."""
    xml = urdf_on_rail("wx250s")
    joints = ("rail", "waist", "shoulder", "elbow", "forearm_roll", "wrist_angle", "wrist_rotate")
    grasp = pin.SE3(np.eye(3), np.array([-0.05, 0.0, 0.0]))
    gravity = np.array([0.0, 0.0, -9.81])
    rotor = np.array([0.5, *(0.02,) * 6])
    model = ArmModel(xml, joints, {}, pin.SE3.Identity(), "ee", grasp, rotor, gravity)
    q, dq, h = np.array([0.0, 0.1, -0.3, 0.5, 0.2, 0.6, 0.1]), np.zeros(7), 1e-3
    gains = Gains((20.0,) * 3, (20.0,) * 3, (20.0,) * 3, (20.0,) * 3, (5.0,) * 6)
    wanted = along_the_null_space(model, q)
    posture = Posture(tuple(wanted.tolist()), 30.0, 10.0)
    offline = Offline(gains, 1.0, 1e-9, (1e-9, 0, 0, 0, 1e-9, 0, 0, 0, 1e-9), (0.0, 0.0, -9.81), posture=posture)
    start, begin = model.evaluate(q, dq), q.copy()
    desired = Desired(start.p_object, start.quat_object, (0.0,) * 6, (0.0,) * 6)
    pull = [float(np.linalg.norm(known.torque(model, offline, q, dq, desired).tau_posture))]  # type: ignore[arg-type]
    for _ in range(8000):
        terms = known.torque(model, offline, q, dq, desired)
        k = terms.kinematics
        dq = dq + h * np.linalg.solve(k.B, terms.tau_cmd - k.C @ dq - k.g)
        q = q + h * dq
    end = known.torque(model, offline, q, np.zeros(7), desired)
    pull.append(float(np.linalg.norm(end.tau_posture)))  # type: ignore[arg-type]
    assert math.dist(end.kinematics.p_object, start.p_object) < 1e-3
    assert angle_between(end.kinematics.quat_object, start.quat_object) < 5e-3
    assert np.linalg.norm(wanted - begin) > 0.1
    assert np.linalg.norm(q - wanted) < 0.1 * np.linalg.norm(wanted - begin)
    assert pull[1] < 0.1 * pull[0]
    assert np.abs(dq).max() < 0.02


def along_the_null_space(model: ArmModel, q: Vector) -> Vector:
    """Another posture (7,) with the object at the same place."""
    T = model.object_pose(q)
    for _ in range(100):
        J = model.jacobian(q)
        _, _, Vt = np.linalg.svd(J)
        q = q + 0.002 * Vt[-1] * np.sign(Vt[-1][0])
        error = np.concatenate([T.translation - model.object_pose(q).translation, np.zeros(3)])
        error[3:] = pin.log3(T.rotation @ model.object_pose(q).rotation.T)
        q = q + np.linalg.pinv(model.jacobian(q)) @ error
    return q
