"""Regressors of arm and object: torque and wrench as matrices times dynamic parameters; pure, owns no state.

Parameters of a rigid body are ten numbers in pinocchio's order: mass m, first moment h = m c (3), and the
inertia Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the origin of the body's frame.
"""

from __future__ import annotations

import struct

import numpy as np
import pinocchio as pin

from agent.control.models import ArmModel, Matrix
from agent.control.quaternion import Vec3
from drivers.interface import Vector

BODY_PARAMETERS = 10
_SIXTY = struct.Struct("60d")

_NO_ACCELERATION = np.zeros(7)  # of as many joints as an arm may have


def joint_regressor(model: ArmModel, q: Vector, dq: Vector, dq_ref: Vector, ddq_ref: Vector) -> Matrix:
    """Y_q (n, 10 n) with Y_q θ = B ddq_ref + C(q, dq) dq_ref + g, reflected rotor inertia not included.

    pinocchio's regressor Y(q, v, a) has one velocity.  For its Christoffel matrix C(q, a) b = C(q, b) a, hence

        Y_q = Y(q, (dq + dq_ref)/2, ddq_ref) − Y₀(q, (dq − dq_ref)/2, 0) ,   Y₀: without gravity.

    q, dq, dq_ref, ddq_ref: (n,).  Uses the model's scratch memory; the result is the caller's.
    """
    data = model.data
    middle = 0.5 * (dq + dq_ref)
    Y: Matrix = pin.computeJointTorqueRegressor(model.model, data, q, middle, ddq_ref)
    Y -= pin.computeJointTorqueRegressor(model.weightless, data, q, dq - middle, _NO_ACCELERATION[: model.n])
    return Y  # eq: parameter linearity , first line, in the joints


def arm_parameters(model: ArmModel) -> Vector:
    """(10 n,) inertial parameters the model believes in, locked links lumped into the body that carries them."""
    return np.concatenate([model.model.inertias[j].toDynamicParameters() for j in range(1, model.n + 1)])


def object_parameters(mass_kg: float, inertia: Matrix) -> Vector:
    """(10,) parameters of a body whose centre of mass is its frame's origin; inertia (3, 3) kg·m²."""
    parameters: Vector = pin.Inertia(mass_kg, np.zeros(3), np.asarray(inertia)).toDynamicParameters()
    return parameters


def object_regressor(v: Vec3, w: Vec3, v_ref: Vec3, w_ref: Vec3, a_ref: Vec3, dw_ref: Vec3) -> Matrix:
    """Y_O (6, 10) with Y_O θ_O = M_O v̇_r + C_O v_r + g_O about the origin of the object's frame.

    All arguments in the object's axes: true twist (v, w), reference twist, and its derivative less gravity
    (a_ref = v̇_r,lin − g).  The centre of mass may lie anywhere: with first moment h and inertia I,

        force   m a_r + dw_r × h + w × (w_r × h)
        moment  h × a_r + I dw_r + w × (I w_r) + w × (h × v_r) + (h × v) × w_r ,

    the factorisation for which Ṁ_O − 2 C_O is skew-symmetric; with h = 0 it is the paper's object dynamics.
    """
    vx, vy, vz = v
    wx, wy, wz = w
    rx, ry, rz = v_ref
    sx, sy, sz = w_ref
    ax, ay, az = a_ref
    bx, by, bz = dw_ref
    ws = wx * sx + wy * sy + wz * sz
    wr = wx * rx + wy * ry + wz * rz
    sv = sx * vx + sy * vy + sz * vz
    # S(w) S(w_r) = w_r wᵀ − (w·w_r) E,  −S(w) S(v_r) + S(w_r) S(v) = (w·v_r) E − v_r wᵀ + v w_rᵀ − (w_r·v) E
    turn = wr - sv
    return _matrix(  # eq: parameter linearity , second line
        (
            # m, hx, hy, hz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz
            ax, sx * wx - ws, sx * wy - bz, sx * wz + by, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
            ay, sy * wx + bz, sy * wy - ws, sy * wz - bx, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
            az, sz * wx - by, sz * wy + bx, sz * wz - ws, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
            0.0, turn - rx * wx + vx * sx, az - rx * wy + vx * sy, -ay - rx * wz + vx * sz,
            bx, by - wz * sx, -wz * sy, bz + wy * sx, wy * sy - wz * sz, wy * sz,
            0.0, -az - ry * wx + vy * sx, turn - ry * wy + vy * sy, ax - ry * wz + vy * sz,
            wz * sx, bx + wz * sy, by, wz * sz - wx * sx, bz - wx * sy, -wx * sz,
            0.0, ay - rz * wx + vz * sx, -ax - rz * wy + vz * sy, turn - rz * wz + vz * sz,
            -wy * sx, wx * sx - wy * sy, wx * sy, bx - wy * sz, by + wx * sz, bz,
        )
    )  # fmt: skip


def _matrix(numbers: tuple[float, ...]) -> Matrix:
    """Matrix (6, 10), read-only; numpy takes packed numbers in half the time that it needs for a tuple of them."""
    return np.frombuffer(_SIXTY.pack(*numbers)).reshape(6, BODY_PARAMETERS)
