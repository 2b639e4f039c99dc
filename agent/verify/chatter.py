"""How much the torques of an arm shake because servos report velocities in steps: what one hears."""

from __future__ import annotations

import math

import numpy as np

from agent.control.law import Offline
from agent.control.models import ArmModel, Matrix
from drivers.dynamixel.servo.table import VELOCITY_UNIT_RAD_PER_S
from drivers.interface import Vector


def velocity_chatter(model: ArmModel, offline: Offline, q: Vector) -> float:
    """Largest rms torque, N·m, of a joint from velocities that are rounded to the servos' grid, with the arm at q (n,).

    A velocity off by δ changes the torque by ((B J⁻¹ + c Jᵀ M_O) K' H + Jᵀ k_v) J δ; δ is uniform over one step.
    """
    gains, P = offline.gains, model.task_basis
    J, B, R = model.jacobian(q), model.inertia(q), model.object_pose(q).rotation
    K_rate = P @ np.diag([*gains.k_p_rate, *(0.5 * k for k in gains.k_eps_rate)]) @ P.T
    M_object = np.zeros((6, 6))
    M_object[:3, :3] = offline.object_mass_kg * np.eye(3)
    M_object[3:, 3:] = R @ np.reshape(offline.object_inertia, (3, 3)) @ R.T
    inertia = B @ np.linalg.pinv(J) + offline.load_share * J.T @ P @ M_object @ P.T
    feedback: Matrix = (inertia @ K_rate + J.T @ P @ np.diag(gains.k_v) @ P.T) @ J
    return float(np.linalg.norm(feedback, axis=1).max() * VELOCITY_UNIT_RAD_PER_S / math.sqrt(12.0))
