"""One pinocchio model of the whole cell: every arm, the object, the grasps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from drivers.interface import Vector
from sim_backend.physics.spec import ArmSpec, GraspError, ObjectSpec, PlantError, PlantSpec

GRASP_ITERATIONS = 100
GRASP_RESIDUAL = 1e-13
HOLD_WITHIN_M = 0.1  # from where it was meant to be held, an object is still held …
HOLD_WITHIN_RAD = 0.3  # … by a gripper that stands so askew


@dataclass(frozen=True, eq=False)
class Composition:
    """The closed chain.  q = [controlled joints, arm after arm; p_object (3); quaternion x y z w]."""

    model: pin.Model
    grasps: tuple[pin.RigidConstraintModel, ...]  # object side first, so forces are those on the object
    slices: tuple[slice, ...]  # of each arm's joints in q and v
    q_start: Vector  # (nq,)
    rotor_inertia: Vector  # (nv,)


def arm_model(arm: ArmSpec) -> pin.Model:
    """Model of one arm with only its controlled joints, in the order of `arm.controlled`.

    Raises PlantError for a URDF that cannot be read, unknown or unlocked joints, a wrong order, or no such frame.
    """
    try:
        full = pin.buildModelFromXML(arm.urdf_xml)
    except (ValueError, RuntimeError) as e:
        raise PlantError(
            f"arm {arm.name}: URDF", found=e, expected="a robot description", remedy="check it with check_urdf"
        ) from e
    moving = list(full.names)[1:]
    free = [j for j in moving if j not in arm.locked_rad]
    if free != list(arm.controlled):
        raise PlantError(
            f"arm {arm.name}: controlled joints",
            found=list(arm.controlled),
            expected=f"{free}: the joints that are not locked, from the base to the end effector",
            remedy=f"name each of {moving} either as controlled or as locked",
        )
    model = _lock(arm, full)
    if not any(f.name == arm.ee_frame for f in model.frames):
        raise PlantError(
            f"arm {arm.name}: end-effector frame",
            found=arm.ee_frame,
            expected=f"one of {[f.name for f in model.frames][1:]}",
            remedy="correct ee_frame or the URDF",
        )
    return model


def _lock(arm: ArmSpec, full: pin.Model) -> pin.Model:
    """Model without its locked joints, its links as heavy as they are.

    Raises PlantError on a joint that is not described by one angle.
    """
    q = pin.neutral(full)
    locked = []
    for joint in list(full.names)[1:]:
        number = full.getJointId(joint)
        if full.joints[number].nq != 1:
            raise PlantError(
                f"arm {arm.name}: joint {joint}",
                found=full.joints[number].shortname(),
                expected="a joint with one coordinate",
                remedy="make it `revolute` with limits in the URDF",
            )
        if joint in arm.locked_rad:
            q[full.joints[number].idx_q] = arm.locked_rad[joint]
            locked.append(number)
    model = pin.buildReducedModel(full, locked, q)
    for number, times in enumerate(arm.masses.tolist(), start=1):
        body = model.inertias[number]
        model.inertias[number] = pin.Inertia(times * body.mass, body.lever, times * body.inertia)
    return model


def frame_number(model: pin.Model, name: str) -> int:
    """Index of a frame; a link and the fixed joint that carries it may share a name, and then also the pose."""
    return max(i for i, f in enumerate(model.frames) if f.name == name)


def place_arms(spec: PlantSpec) -> tuple[pin.Model, list[tuple[str, pin.SE3]]]:
    """All arms in one model, and of each the name of its last joint with the end effector's pose in it.

    appendModel keeps neither armature nor gravity.  Raises PlantError as `arm_model`.
    """
    model = pin.Model()
    ends_of_arm = []
    for arm in spec.arms:
        single = arm_model(arm)
        ee = single.frames[frame_number(single, arm.ee_frame)]
        ends_of_arm.append((f"{arm.name}/{single.names[ee.parentJoint]}", pin.SE3(ee.placement)))
        for i in range(1, single.njoints):
            single.names[i] = f"{arm.name}/{single.names[i]}"
        for i in range(1, single.nframes):
            single.frames[i].name = f"{arm.name}/frame {i}"  # a joint's frame may be named like its link's: not here
        model = pin.appendModel(model, single, 0, arm.T_world_base)
    return model, ends_of_arm


def compose(spec: PlantSpec) -> Composition:
    """Build the closed chain of a cell; the arms are not yet checked to be on their grasps.

    Raises PlantError as `arm_model`.
    """
    model, ends_of_arm = place_arms(spec)
    object_joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "object")
    inertia = pin.Inertia(spec.object.mass_kg, np.array(spec.object.centre_m), np.array(spec.object.inertia))
    model.appendBodyToJoint(object_joint, inertia, pin.SE3.Identity())
    model.gravity = pin.Motion(np.array(spec.gravity), np.zeros(3))
    rotor_inertia = np.concatenate([*(arm.rotor_inertia for arm in spec.arms), np.zeros(6)])
    model.armature = rotor_inertia
    ends = np.cumsum([len(arm.controlled) for arm in spec.arms], dtype=int).tolist()
    return Composition(
        model,
        tuple(
            _grasp(model, object_joint, model.getJointId(joint), T_joint_ee, arm, spec)
            for arm, (joint, T_joint_ee) in zip(spec.arms, ends_of_arm, strict=True)
        ),
        tuple(slice(end - len(arm.controlled), end) for arm, end in zip(spec.arms, ends, strict=True)),
        np.concatenate([*(arm.q_start for arm in spec.arms), pin.SE3ToXYZQUAT(spec.object.T_world_object)]),
        rotor_inertia,
    )


def _grasp(
    model: pin.Model, object_joint: int, arm_joint: int, T_joint_ee: pin.SE3, arm: ArmSpec, spec: PlantSpec
) -> pin.RigidConstraintModel:
    grasp = pin.RigidConstraintModel(
        pin.ContactType.CONTACT_6D,
        model,
        object_joint,
        arm.T_object_ee,
        arm_joint,
        T_joint_ee,
        pin.ReferenceFrame.LOCAL,
    )
    grasp.m_baumgarte_parameters.Kp = spec.baumgarte_p_per_s2
    grasp.m_baumgarte_parameters.Kd = spec.baumgarte_d_per_s
    return grasp


def grasp_gap(arm: ArmSpec, model: pin.Model, body: ObjectSpec, q: Vector) -> tuple[float, float, Vector]:
    """Distance (m) and angle (rad) between the end effector and its grasp at q (n,), and their log6 (6,)."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    T_world_ee = arm.T_world_base * data.oMf[frame_number(model, arm.ee_frame)]
    T_ee_grasp = T_world_ee.actInv(body.T_world_object * arm.T_object_ee)
    angle = float(np.linalg.norm(pin.log3(T_ee_grasp.rotation)))
    return float(np.linalg.norm(T_ee_grasp.translation)), angle, np.array(pin.log6(T_ee_grasp).vector)


def check_start(spec: PlantSpec) -> None:
    """Refuse a cell whose arms do not hold the object at the start pose.  Raises GraspError naming the arm."""
    for arm in spec.arms:
        gap_m, gap_rad, _ = grasp_gap(arm, arm_model(arm), spec.object, arm.q_start)
        if not (gap_m <= spec.start_tolerance_m and gap_rad <= spec.start_tolerance_rad):
            raise GraspError(
                arm.name, gap_m, gap_rad, tolerance_m=spec.start_tolerance_m, tolerance_rad=spec.start_tolerance_rad
            )


def solve_grasp(arm: ArmSpec, body: ObjectSpec, q_guess: Vector) -> Vector:
    """Joint positions (n,) that put the end effector on its grasp, by Gauss-Newton from `q_guess` (n,).

    Raises GraspError when the grasp is out of reach from there.
    """
    model = arm_model(arm)
    q = _towards_grasp(arm, model, body, q_guess)
    gap_m, gap_rad, _ = grasp_gap(arm, model, body, q)
    if not max(gap_m, gap_rad) < 1e-9:
        raise GraspError(arm.name, gap_m, gap_rad, tolerance_m=1e-9, tolerance_rad=1e-9)
    return q


def _towards_grasp(arm: ArmSpec, model: pin.Model, body: ObjectSpec, q_guess: Vector) -> Vector:
    """Joint positions (n,) from which no small step brings the end effector nearer to its grasp."""
    data, frame = model.createData(), frame_number(model, arm.ee_frame)
    q = np.array(q_guess, dtype=np.float64)
    for _ in range(GRASP_ITERATIONS):
        gap_m, gap_rad, error = grasp_gap(arm, model, body, q)
        if max(gap_m, gap_rad) < GRASP_RESIDUAL:
            break
        J_ee_local = pin.computeFrameJacobian(model, data, q, frame, pin.ReferenceFrame.LOCAL)
        step = np.linalg.lstsq(J_ee_local, error, rcond=1e-8)[0]
        q += step
        if float(np.abs(step).max()) < GRASP_RESIDUAL:
            break
    return q


def take_hold(arm: ArmSpec, body: ObjectSpec) -> ArmSpec:
    """The arm with the grasp it has when it reaches for `T_object_ee` from `q_start` and closes its gripper there.

    What it cannot reach (a planar arm, out of its plane) is left in the grasp.  Raises GraspError where that is more
    than a slip of calibration.
    """
    model = arm_model(arm)
    q = _towards_grasp(arm, model, body, arm.q_start)
    gap_m, gap_rad, _ = grasp_gap(arm, model, body, q)
    if not (gap_m <= HOLD_WITHIN_M and gap_rad <= HOLD_WITHIN_RAD):
        raise GraspError(arm.name, gap_m, gap_rad, tolerance_m=HOLD_WITHIN_M, tolerance_rad=HOLD_WITHIN_RAD)
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    T_world_ee = arm.T_world_base * data.oMf[frame_number(model, arm.ee_frame)]
    return replace(arm, q_start=q, T_object_ee=body.T_world_object.inverse() * T_world_ee)
