"""What the arm model refuses, and what it keeps of its inputs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pinocchio as pin
import pytest

from agent.control.models import ArmModel, ModelError
from tests.support.control.strategies import PLANE_JOINTS, SIX_JOINTS, urdf

REST = {"waist": 0.0, "wrist_rotate": 0.0}


def build(
    controlled: Sequence[str] = PLANE_JOINTS,
    locked: dict[str, float] | None = None,
    ee_frame: str = "ee",
    T_world_base: pin.SE3 | None = None,
    name: str = "wx200",
) -> ArmModel:
    n = len(controlled)
    return ArmModel(
        urdf(name),
        controlled,
        REST if locked is None else locked,
        T_world_base or pin.SE3.Identity(),
        ee_frame,
        pin.SE3(np.eye(3), np.array([0.01, 0.02, 0.03])),
        np.arange(1.0, n + 1.0) * 0.01,
        np.array([0.0, 0.0, -9.81]),
    )


REFUSALS: list[tuple[Callable[[], ArmModel], str]] = [
    (lambda: build(ee_frame="hand"), r"end-effector frame: found 'hand', expected one of .*'ee'"),
    (
        lambda: build(["shoulder", "elbow", "knee"]),
        r"joint names: found knee, expected names among waist, shoulder, .*; correct the cell$",
    ),
    (lambda: build(locked={**REST, "knee": 0.0}), r"joint names: found knee"),
    (lambda: build(locked={"waist": 0.0}), r"neither controlled nor locked: found wrist_rotate"),
    (lambda: build(["elbow", "shoulder", "wrist_angle"]), r"order of controlled joints: .* from base to tip"),
    (
        lambda: build(["waist", "shoulder", "elbow"], {"wrist_angle": 0.0, "wrist_rotate": 0.0}),
        r"controlled joints: found 3 joints, 1 of them parallel to the first",
    ),
    (
        lambda: build(["shoulder", "elbow"], {**REST, "wrist_angle": 0.0}),
        r"controlled joints: found 2 joints, 2 of them parallel",
    ),
    (lambda: build(["waist", "shoulder", "elbow", "wrist_angle", "wrist_rotate"], {}), r"found 5 joints"),
]


@pytest.mark.parametrize(("make", "text"), REFUSALS)
def test_what_cannot_be_controlled_is_refused_with_the_reason(make: Callable[[], ArmModel], text: str) -> None:
    with pytest.raises(ModelError, match=text):
        make()


def test_reflected_inertia_is_on_the_diagonal_of_the_joint_inertia() -> None:
    model = build()
    bare = build()
    bare.model.armature = np.zeros(3)
    q = np.array([0.1, 0.2, 0.3])
    assert np.allclose(model.inertia(q) - bare.inertia(q), np.diag([0.01, 0.02, 0.03]), atol=1e-15)


def test_a_planar_arm_has_three_task_rows_and_a_six_joint_arm_six() -> None:
    planar, six = build(), build(SIX_JOINTS, {}, name="wx250s")
    assert (planar.task_dimension, six.task_dimension) == (3, 6)
    assert planar.plane_normal is not None
    assert six.plane_normal is None
    assert np.array_equal(six.task_basis, np.eye(6))


def test_two_arms_that_face_each_other_have_the_same_task_rows() -> None:
    """The normal has no sign: an arm turned by half a turn sees the same plane."""
    half_turn = pin.SE3(pin.AngleAxis(np.pi, np.array([0.0, 0.0, 1.0])).matrix(), np.array([0.6, 0.0, 0.0]))
    here, there = build(), build(T_world_base=half_turn)
    assert np.allclose(here.task_basis, there.task_basis, atol=1e-15)


def test_locked_joints_stand_at_their_angle() -> None:
    """A waist locked at a quarter turn turns the plane of motion by a quarter turn."""
    ahead, aside = build(), build(locked={"waist": np.pi / 2, "wrist_rotate": 0.0})
    R = pin.AngleAxis(np.pi / 2, np.array([0.0, 0.0, 1.0])).matrix()
    q = np.array([0.3, -0.2, 0.4])
    assert np.allclose(aside.object_pose(q).translation, R @ ahead.object_pose(q).translation, atol=1e-12)


def test_kinematics_are_copies_of_the_scratch_memory() -> None:
    model = build()
    k = model.evaluate(np.array([0.1, 0.2, 0.3]), np.ones(3))
    kept = [a.copy() for a in (k.J, k.dJ, k.B, k.C, k.g)]
    model.evaluate(np.array([-0.5, 0.9, 0.1]), -np.ones(3))
    assert all(np.array_equal(a, b) for a, b in zip((k.J, k.dJ, k.B, k.C, k.g), kept, strict=True))


@pytest.mark.parametrize("locked", [REST, {}])
def test_arms_of_one_description_share_nothing_that_changes(locked: dict[str, float]) -> None:
    controlled = PLANE_JOINTS if locked else SIX_JOINTS
    name = "wx200" if locked else "wx250s"
    moved = build(controlled, locked, T_world_base=pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0])), name=name)
    moved.model.armature = np.zeros(moved.n)
    moved.model.lowerPositionLimit = np.zeros(moved.n)
    here, q = build(controlled, locked, name=name), np.zeros(moved.n)
    assert (here.model.armature > 0.0).all()
    assert (here.model.lowerPositionLimit < 0.0).all()
    away = moved.object_pose(q).translation - here.object_pose(q).translation
    np.testing.assert_allclose(away, [1.0, 0.0, 0.0], atol=1e-12)
