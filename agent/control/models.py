"""Rigid-body model of one arm (pinocchio) with the object's frame attached; owns scratch memory, never any state.

The object is rigidly grasped, so its frame is a frame of the arm.  With J the Jacobian of that frame,
J = J_O⁻¹ J_E, the paper's J_O never appears in the running law: J⁻¹ v_r is its J_E⁻¹ J_O v_r, and Jᵀ f is
its J_Eᵀ J_O⁻ᵀ f.  The tests hold the printed form against this one.

Planar arms (three parallel joint axes) use the same code: the task space is then the plane's two directions
and the rotation about its normal, by an orthonormal basis P (3, 6); with six joints P is the identity.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from agent.control.quaternion import Mat3, Quat, Vec3, rotate, to_matrix
from drivers.interface import Refusal, Vector

Matrix = NDArray[np.float64]
SMALLEST_INERTIA_KG_M2 = 1e-9
Twist = tuple[float, float, float, float, float, float]
_WORLD_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
_PACK_TWO = struct.Struct("=12d").pack_into
_PACK_THREE = struct.Struct("=18d").pack_into


class ModelError(Refusal):
    """The described arm cannot be controlled in this cell."""


# what every tick calls: looking all of it up in pinocchio's module takes 1 % of one
_coriolis, _inertia, _gravity = pin.computeCoriolisMatrix, pin.crba, pin.computeGeneralizedGravity
_jacobian, _jacobian_rate = pin.getFrameJacobian, pin.getFrameJacobianTimeVariation
_placement, _numbers = pin.updateFramePlacement, pin.SE3ToXYZQUATtuple


class Kinematics(NamedTuple):
    """Everything one tick needs from the model at (q, dq).  World axes, linear first; own memory."""

    p_object: Vec3
    quat_object: Quat
    R_world_object: Mat3
    v_object: Twist
    J: Matrix  # (m, n) task-space Jacobian of the object frame
    dJ: Matrix  # (m, n) its time derivative
    J6: Matrix  # (6, n) Jacobian of the object frame, in all directions
    B: Matrix  # (n, n) joint-space inertia with reflected rotor inertia
    C: Matrix  # (n, n) Christoffel-consistent Coriolis matrix
    g: Vector  # (n,)
    p_ee_object: Vec3  # p_O − p_E

    @property
    def Jt(self) -> Matrix:
        """(n, 6) joint torques of a wrench about the object's centre."""
        return self.J6.T


class Scratch:
    """Room in which tuples of numbers become arrays: written over by the next call, and quicker than a new one."""

    def __init__(self) -> None:
        twists = np.zeros((2, 6))
        self._rows, self._wrenches = (twists[0], twists[1]), np.zeros((3, 6))
        self._two, self._three = twists.data, self._wrenches.data

    def two(self, first: Twist, second: Twist) -> tuple[Vector, Vector]:
        """Both as arrays (6,)."""
        _PACK_TWO(self._two, 0, *first, *second)
        return self._rows

    def three(self, first: Twist, second: Twist, third: Twist) -> Matrix:
        """All as rows of one array (3, 6)."""
        _PACK_THREE(self._three, 0, *first, *second, *third)
        return self._wrenches


class ArmModel:
    """One arm in the world frame: controlled joints free, all others locked.

    urdf_xml: text of the arm's URDF; controlled: joint names in the order used everywhere; locked_rad: angles
    of the other joints; T_world_base, T_object_ee: placements; rotor_inertia: (n,) kg·m² reflected to the
    joint; gravity: (3,) m/s², world axes.

    Raises ModelError for a broken URDF, unknown joints or frames, and for a controlled set that is neither planar nor
    at least six joints.  Whether it is far enough from singular poses is for the check along the trajectory to say.
    """

    def __init__(
        self,
        urdf_xml: str,
        controlled: Sequence[str],
        locked_rad: Mapping[str, float],
        T_world_base: pin.SE3,
        ee_frame: str,
        T_object_ee: pin.SE3,
        rotor_inertia: Vector,
        gravity: Vector,
    ) -> None:
        self.model = _reduced_model(urdf_xml, controlled, locked_rad, T_world_base)
        self.model.gravity = pin.Motion(np.asarray(gravity, dtype=np.float64), np.zeros(3))
        self.model.armature = np.asarray(rotor_inertia, dtype=np.float64)
        self.weightless = pin.Model(self.model)  # for regressors, which know no inertia either
        self.weightless.gravity = pin.Motion.Zero()
        self.joints = tuple(controlled)
        self.n = self.model.nv
        if not self.model.existFrame(ee_frame, pin.FrameType.BODY):
            raise ModelError(
                "end-effector frame",
                found=repr(ee_frame),
                expected=f"one of {sorted(f.name for f in self.model.frames if f.type == pin.FrameType.BODY)}",
                remedy="name a link of the arm's URDF",
            )
        self.ee_id = self.model.getFrameId(ee_frame, pin.FrameType.BODY)
        ee = self.model.frames[self.ee_id]
        self.object_id = self.model.addFrame(
            pin.Frame(
                "grasped_object",
                ee.parentJoint,
                self.ee_id,
                ee.placement * T_object_ee.inverse(),  # eq:coupled_kinematics for the object
                pin.FrameType.OP_FRAME,
            )
        )
        self.data = self.model.createData()
        self.scratch = Scratch()
        _refuse_unphysical(self.model, self.data)
        self.plane_normal, self.task_basis = _task_space(self.model, self.data)
        self._p_ee_object: Vec3 = tuple((-T_object_ee.translation).tolist())  # object axes
        self.task_is_identity = self.plane_normal is None

    @property
    def task_dimension(self) -> int:
        """3 for a planar arm, 6 otherwise."""
        return int(self.task_basis.shape[0])

    def evaluate(self, q: Vector, dq: Vector) -> Kinematics:
        """Kinematics and dynamics terms at (q, dq), both (n,), as copies."""
        model, data, frame = self.model, self.data, self.object_id
        C = _coriolis(model, data, q, dq).copy()  # leaves the Jacobians of all joints and their rates
        T_world_object = _placement(model, data, frame)
        J6 = _jacobian(model, data, frame, _WORLD_AXES)
        dJ6 = _jacobian_rate(model, data, frame, _WORLD_AXES)
        v_object = tuple(J6.dot(dq).tolist())  # eq:J_o_i for v_O
        x, y, z, qx, qy, qz, qw = _numbers(T_world_object)
        quat = (qw, qx, qy, qz)
        R = to_matrix(quat)
        p_ee_object = rotate(R, self._p_ee_object)
        B = _inertia(model, data, q).copy()
        g = _gravity(model, data, q).copy()
        if self.task_is_identity:
            J, dJ = J6, dJ6
        else:
            J, dJ = self.task_basis.dot(J6), self.task_basis.dot(dJ6)
        return Kinematics((x, y, z), quat, R, v_object, J, dJ, J6, B, C, g, p_ee_object)

    def object_pose(self, q: Vector) -> pin.SE3:
        """Pose of the object frame in the world when this arm is at q (n,)."""
        pin.framesForwardKinematics(self.model, self.data, q)
        return pin.SE3(self.data.oMf[self.object_id])

    def jacobian(self, q: Vector) -> Matrix:
        """Task-space Jacobian of the object frame (m, n) at q."""
        return self.pose_and_jacobian(q)[1]

    def pose_and_jacobian(self, q: Vector) -> tuple[pin.SE3, Matrix]:
        """Both at q, for less than each of them; the pose stands until the model is asked again."""
        pin.computeJointJacobians(self.model, self.data, q)
        T_world_object = pin.updateFramePlacement(self.model, self.data, self.object_id)
        J6 = pin.getFrameJacobian(self.model, self.data, self.object_id, _WORLD_AXES)
        J: Matrix = self.task_basis.dot(J6)
        return T_world_object, J

    def inertia(self, q: Vector) -> Matrix:
        """Joint-space inertia (n, n) with reflected rotor inertia."""
        B: Matrix = pin.crba(self.model, self.data, q).copy()
        return B


@functools.lru_cache(maxsize=8)  # arms of one kind, and one arm again and again
def _parsed(urdf_xml: str) -> pin.Model:
    """Model of the whole URDF, which nobody changes.

    Raises ModelError for a text that is none, or with joints of more than one angle.
    """
    try:
        full = pin.buildModelFromXML(urdf_xml)
    except (ValueError, RuntimeError) as error:
        found = " ".join(str(error).split())
        raise ModelError(
            "URDF", found=found, expected="a robot description", remedy="check it with check_urdf"
        ) from error
    joints = list(zip(full.names, full.joints, strict=True))[1:]
    wide = [f"{name} ({joint.shortname()})" for name, joint in joints if joint.nq != 1]
    if wide:
        raise ModelError(
            "joints of the URDF",
            found=", ".join(wide),
            expected="joints with one angle and limits",
            remedy="make them `revolute` with limits",
        )
    return full


def _refuse_unphysical(model: pin.Model, data: pin.Data) -> None:
    """Raise ModelError for an arm that some joint accelerations would cost no torque."""
    q = pin.neutral(model)
    finite = all(np.isfinite(link.toDynamicParameters()).all() for link in model.inertias)
    smallest = float(np.linalg.eigvalsh(pin.crba(model, data, q))[0]) if finite else np.nan
    if not SMALLEST_INERTIA_KG_M2 < smallest < np.inf:
        raise ModelError(
            "inertia of the controlled joints",
            found=f"a smallest eigenvalue of {smallest:.3g} kg·m²",
            expected=f"more than {SMALLEST_INERTIA_KG_M2:g}",
            remedy="correct masses and inertias of the URDF, or give rotor_inertia_kg_m2 in the arm file",
        )


def _reduced_model(
    urdf_xml: str, controlled: Sequence[str], locked_rad: Mapping[str, float], T_world_base: pin.SE3
) -> pin.Model:
    full = _parsed(urdf_xml)
    names = [name for name in full.names if name != "universe"]
    unknown = [j for j in (*controlled, *locked_rad) if j not in names]
    if unknown:
        raise ModelError(
            "joint names",
            found=", ".join(unknown),
            expected=f"names among {', '.join(names)}" if names else "joints that move: the URDF has none of them",
            remedy="correct the cell" if names else "give the URDF its joints, or name that of this arm",
        )
    rest = [j for j in names if j not in controlled]
    missing = [j for j in rest if j not in locked_rad]
    if missing:
        raise ModelError(
            "joints that are neither controlled nor locked",
            found=", ".join(missing),
            expected="an angle for every joint that is not controlled",
            remedy="add them to locked_rad",
        )
    q = pin.neutral(full)
    for joint in rest:
        q[full.joints[full.getJointId(joint)].idx_q] = locked_rad[joint]
    model = pin.buildReducedModel(full, [full.getJointId(j) for j in rest], q)
    order = [name for name in model.names if name != "universe"]
    if order != list(controlled):
        raise ModelError(
            "order of controlled joints", found=list(controlled), expected=order, remedy="list them from base to tip"
        )
    for j in range(1, model.njoints):
        if model.parents[j] == 0:
            model.jointPlacements[j] = T_world_base * model.jointPlacements[j]
    for frame in model.frames:
        if frame.parentJoint == 0:
            frame.placement = T_world_base * frame.placement
    return model


def _task_space(model: pin.Model, data: pin.Data) -> tuple[Vector | None, Matrix]:
    """Plane normal (3,) or None, and the orthonormal task basis P (m, 6) of the controlled joints."""
    pin.computeJointJacobians(model, data, pin.neutral(model))
    axes = np.stack([pin.getJointJacobian(model, data, j, _WORLD_AXES)[3:, j - 1] for j in range(1, model.njoints)])
    if model.nv >= 6:
        return None, np.eye(6)
    normal = axes[0]
    parallel = np.abs(np.abs(axes.dot(normal)) - 1.0) < 1e-6
    if model.nv != 3 or not parallel.all():
        raise ModelError(
            "controlled joints",
            found=f"{model.nv} joints, {int(parallel.sum())} of them parallel to the first",
            expected="three joints with parallel axes (planar) or at least six",
            remedy="choose the controlled joints so that the task rows are square and full rank",
        )
    normal = np.where(np.abs(normal) < 1e-9, 0.0, normal)
    if normal[np.argmax(np.abs(normal))] < 0.0:
        normal = 0.0 - normal
    first = np.eye(3)[int(np.argmin(np.abs(normal)))]
    u = first - normal * normal.dot(first)
    u /= np.linalg.norm(u)
    w = np.array(
        [normal[1] * u[2] - normal[2] * u[1], normal[2] * u[0] - normal[0] * u[2], normal[0] * u[1] - normal[1] * u[0]]
    )
    basis = np.zeros((3, 6))
    basis[0, :3], basis[1, :3], basis[2, 3:] = u, w, normal
    return normal, basis + 0.0  # which turns -0.0 into 0.0, so that equal cells print equal
