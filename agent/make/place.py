"""Where an arm stands and how it bends: grasps from faces, joint angles from several starts, judged along the motion.

Judged is what the arm lacks most: size of the smallest singular value, torque that holds arm and share of the object,
and distance to joint limits, each relative to what is comfortable.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pinocchio as pin

from agent.config.cell import Arm, Cell, placement
from agent.control import ik
from agent.control.models import ArmModel
from agent.make.wish import DOWN_SPATIAL_DEG, FACES, ArmWish
from drivers.interface import Vector

SIGMA: Final = 0.06  # a smallest singular value that is comfortable
TORQUE: Final = 0.3  # part of the torque bound that is left where it is
LIMIT_RAD: Final = 0.35
STARTS: Final = [np.array(q) for q in itertools.product((-0.9, 0.0), (-0.4, 0.9), (-0.6, 0.5, 1.2))]  # in the plane
RADII_M: Final = tuple(np.arange(0.16, 0.50, 0.04).round(3).tolist())
HEIGHTS_M: Final = (0.15, 0.2, 0.25, 0.3)


@dataclass(frozen=True, slots=True)
class Bend:
    """Joint angles at the start, and what the arm lacks most along the motion: 1 comfortable, below 0 not possible."""

    q: Vector
    comfort: float
    lacks: str


def grasp(wish: ArmWish, size_m: Sequence[float], spatial: bool) -> pin.SE3:
    """Pose of the end effector in the object's frame."""
    if wish.pose is not None:
        quat = np.array(wish.pose[3:])
        return placement(wish.pose[:3], quat / np.linalg.norm(quat))
    n = np.array(FACES[wish.face])
    down = math.radians(wish.down_deg if wish.down_deg is not None else DOWN_SPATIAL_DEG if spatial else 0.0)
    x = -math.cos(down) * n - math.sin(down) * np.array([0.0, 0.0, 1.0])
    y = np.cross([0.0, 0.0, 1.0], -n)
    half = 0.5 * float(np.abs(n) @ np.array(size_m))
    p = n * (half - min(wish.inset_m, 0.5 * half))
    return pin.SE3(np.column_stack([x, y, np.cross(x, y)]), p)


def base(T_object_ee: pin.SE3, face: str, radius_m: float) -> tuple[float, float, float, float]:
    """x, y, z and yaw in degrees of a base on the table that faces the grasp from so far away."""
    n = np.array(FACES[face])
    x, y, _ = (T_object_ee.translation + n * radius_m).tolist()
    return round(x, 4) + 0.0, round(y, 4) + 0.0, 0.0, math.degrees(math.atan2(-n[1], -n[0]))


def starts(model: ArmModel) -> Iterator[Vector]:
    """Joint angles to begin a search from: shoulder, elbow and wrist bent in several ways, the others at zero."""
    across = _across(model)
    for bent in STARTS:
        q = np.zeros(model.n)
        q[across] = bent[: len(across)]
        yield q


def _across(model: ArmModel) -> list[int]:
    """Joints whose axes at zero are those of most others: shoulder, elbow, wrist."""
    pin.computeJointJacobians(model.model, model.data, np.zeros(model.n))
    frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    axes = [pin.getJointJacobian(model.model, model.data, j, frame)[3:, j - 1] for j in range(1, model.n + 1)]
    parallel = [[k for k, b in enumerate(axes) if abs(float(a @ b)) > 0.99] for a in axes]
    return max(parallel, key=len)[:3]


def bends(cell: Cell, arm: Arm, poses: Sequence[pin.SE3]) -> list[Bend]:
    """Ways for an arm to hold the object at all these poses, the most comfortable first; empty where it cannot."""
    model, found = cell.model(arm), list[Bend]()
    for start in starts(model):
        try:
            q = ik.solve(model, poses[0], start)
        except ik.Unreachable:
            continue
        if all(float(np.abs(q - other.q).max()) > 1e-3 for other in found):
            found.append(_judged(cell, arm, model, poses, q))
    return sorted((bend for bend in found if bend.comfort > 0.0), key=lambda bend: -bend.comfort) or found[:1]


def _judged(cell: Cell, arm: Arm, model: ArmModel, poses: Sequence[pin.SE3], q_start: Vector) -> Bend:
    least, lacks, q = math.inf, "", q_start
    weight = -cell.file.object.mass_kg * arm.entry.load_share * np.concatenate([cell.gravity, np.zeros(3)])
    tau_max = arm.tau_stall_Nm * cell.file.safety.tau_max_fraction_of_stall
    lower, upper = model.model.lowerPositionLimit, model.model.upperPositionLimit
    for T in poses:
        try:
            q = ik.solve(model, T, q)
        except ik.Unreachable:
            return Bend(q_start, -1.0, "the grasp is out of reach along the motion")
        k = model.evaluate(q, np.zeros(model.n))
        load = np.abs(k.g + k.Jt @ weight) / tau_max
        sigma = float(np.linalg.svd(k.J, compute_uv=False)[-1])
        room = np.minimum(q - lower, upper - q)
        tight, heavy = int(room.argmin()), int(load.argmax())
        joints = arm.entry.controlled
        for comfort, what in (
            ((sigma - cell.file.safety.sigma_min) / SIGMA, "near a singular pose"),
            (
                (1.0 - float(load[heavy])) / TORQUE,
                f"{joints[heavy]} needs {float(load[heavy]):.0%} of its torque bound",
            ),
            (float(room[tight]) / LIMIT_RAD, f"{joints[tight]} is at its limit"),
        ):
            if comfort < least:
                least, lacks = comfort, what
    return Bend(q_start, min(least, 1.0) + 0.0, lacks)
