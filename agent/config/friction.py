"""Friction of a joint as its arm file has it: the same figures for feed-forward, estimates and the simulated joint."""

from __future__ import annotations

from agent.config.schema.arm import Figure, ServoJoint
from agent.control.friction import JointFriction


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


def _value(figure: Figure | None, absent: float) -> float:
    return absent if figure is None else figure.value
