"""Friction of a joint as its arm file has it: the same figures for feed-forward, estimates and the simulated joint."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from agent.config.schema.arm import Figure, ServoJoint
from agent.config.schema.tolerance import Tolerance
from agent.control.friction import JointFriction
from drivers.interface import Vector


def joint_friction(servo: ServoJoint) -> JointFriction:
    """Parameters of the joint; those that its file does not have are those of no such friction."""
    return JointFriction(
        coulomb_Nm=servo.coulomb_Nm.value,
        viscous_Nm_s_per_rad=servo.viscous_Nm_s_per_rad.value,
        breakaway_Nm=_value(servo.breakaway_Nm, 0.0),
        stribeck_rad_per_s=_value(servo.stribeck_rad_per_s, 1.0),
        stribeck_exponent=_value(servo.stribeck_exponent, 1.0),
        load=_value(servo.load_friction, 0.0),
        breakaway_load=_value(servo.breakaway_load_friction, 0.0),
    )


def at_rest_Nm(servo: ServoJoint, held_Nm: float) -> float:
    """Largest friction of the joint at rest, N·m, while its motor gives so much."""
    return joint_friction(servo).bound(1.0, held_Nm, 0.0)


def all_at_rest_Nm(servos: Sequence[ServoJoint], held_Nm: Vector) -> Vector:
    """(n,) the same of these joints, while motors give held_Nm (n,)."""
    return np.array([at_rest_Nm(servo, tau) for servo, tau in zip(servos, held_Nm.tolist(), strict=True)])


def lifting_Nm(servo: ServoJoint, held_Nm: float) -> float:
    """The same of one joint while its motor gives so much and what overcomes the friction, which presses on it too."""
    return joint_friction(servo).bound(1.0, held_Nm, math.copysign(1.0, held_Nm))


def unfiled(tolerance: Tolerance, servos: Sequence[ServoJoint]) -> tuple[float, float]:
    """Breakaway, times Coulomb friction, and load friction that the cell states for an arm whose file has none."""
    joints = [joint_friction(servo) for servo in servos]
    breakaway = 0.0 if any(j.breakaway_Nm or j.breakaway_load for j in joints) else tolerance.breakaway
    return breakaway, 0.0 if any(j.load or j.breakaway_load for j in joints) else tolerance.load_friction


def unfiled_Nm(tolerance: Tolerance, servos: Sequence[ServoJoint], held_Nm: Vector) -> Vector:
    """(n,) the same at most, while motors give held_Nm (n,)."""
    breakaway, load = unfiled(tolerance, servos)
    coulomb_Nm = np.array([servo.coulomb_Nm.value for servo in servos])
    found: Vector = breakaway * coulomb_Nm + load * np.abs(held_Nm)
    return found


def _value(figure: Figure | None, absent: float) -> float:
    return absent if figure is None else figure.value
