"""Joint angles for a given object pose: Gauss–Newton from a given start; used before a run, never in it."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from agent.control.lapack import dgesv
from agent.control.models import ArmModel
from drivers.interface import Vector


class Unreachable(ArithmeticError):
    """No joint angles bring the grasped object to the wanted pose; says how near the search came."""

    def __init__(self, distance_m: float, angle_rad: float, out_of_task: bool) -> None:
        super().__init__(f"{distance_m * 1e3:.3g} mm and {angle_rad * 1e3:.3g} mrad short")
        self.distance_m = distance_m
        self.angle_rad = angle_rad
        self.out_of_task = out_of_task  # the rest lies outside the plane this arm can move in


def solve(model: ArmModel, T_world_object: pin.SE3, q_near: Vector, tolerance: float = 1e-11) -> Vector:
    """Joint angles (n,) with the object at T_world_object, the solution nearest to q_near (n,).

    Damped Gauss–Newton on the six-dimensional pose error (m and rad alike).  Raises Unreachable when 1e-8 is
    not reached.
    """
    q = np.array(q_near, dtype=np.float64)
    P, error = model.task_basis, np.zeros(6)
    one, p_wanted, R_wanted = np.eye(len(P)), T_world_object.translation, T_world_object.rotation
    for _ in range(200):
        T, J = model.pose_and_jacobian(q)
        error[:3] = p_wanted - T.translation
        error[3:] = pin.log3(R_wanted.dot(T.rotation.T))
        task_error = P.dot(error)
        size = math.sqrt(task_error.dot(task_error))
        if size < tolerance:
            break
        damping = min(1e-4, size * size) * one
        _, _, x, singular = dgesv(J.dot(J.T) + damping, task_error)
        if singular:  # a pose near the goal, where the damping is below rounding
            break
        dq = J.T.dot(x)
        q += dq * min(1.0, 0.3 / max(*map(abs, dq.tolist()), 1e-12))
    distance, angle = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
    if max(distance, angle) > 1e-8:
        raise Unreachable(distance, angle, out_of_task=size < 1e-8)
    return (q + np.pi) % (2.0 * np.pi) - np.pi
