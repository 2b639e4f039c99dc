"""What the plant has against what the cell file believes: errors of calibration, of masses, of the servos, of time.

`realised` turns the specification of the cell as it is believed into that of the cell as it is; everything that moves
the plant (in one process, served, emulated servos) is built from its result.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace

import numpy as np
import pinocchio as pin

from drivers.interface import Vector
from sim_backend.physics.actuator import ActuatorSpec
from sim_backend.physics.composition import take_hold
from sim_backend.physics.friction import FrictionSpec
from sim_backend.physics.spec import ArmSpec, GraspSpec, PlantError, PlantSpec

Vec3 = tuple[float, float, float]
ZERO: Vec3 = (0.0, 0.0, 0.0)
STRIBECK_RAD_PER_S = 1.0  # of breakaway that nothing else is known of
_SCALED_FRICTION = frozenset({"coulomb_Nm", "breakaway_Nm", "load", "breakaway_load", "viscous_Nms_rad"})


@dataclass(frozen=True)
class ArmReality:
    """One arm as it is; joint values one per controlled joint, none: as believed."""

    base_m: Vec3 = ZERO  # world axes: where the base stands, less where it is believed
    base_rad: Vec3 = ZERO  # rotation vector, world axes, about the base's origin
    grasp_m: Vec3 = ZERO  # object axes: where the gripper holds the object, less where it is believed
    grasp_rad: Vec3 = ZERO  # rotation vector, object axes
    zeros_rad: tuple[float, ...] = ()  # reported less true joint angle
    masses: float = 1.0  # of the links, times what is believed
    link_masses: tuple[float, ...] = ()  # times that again, of what each joint carries up to the next
    friction: float = 1.0  # of the joints, times what is believed
    joint_friction: tuple[float, ...] = ()  # times that again, of each joint
    breakaway_Nm: tuple[float, ...] = ()  # above Coulomb friction at rest, whatever is believed
    stribeck_rad_per_s: float | None = None  # over which breakaway falls off; None: STRIBECK_RAD_PER_S of its own
    load_friction: tuple[float, ...] = ()  # per N·m of the motor, whatever is believed
    torque_constant: tuple[float, ...] = ()  # of the servos, times what is believed
    backlash_rad: tuple[float, ...] = ()  # of the gears, from one end of the gap to the other
    pads_N_per_m: float | None = None  # of its own grasp; None: as the others
    pads_Nm_per_rad: float | None = None
    skew_s: float = 0.0  # by which its clock, and so its trajectory, is ahead


@dataclass(frozen=True)
class Reality:
    """The cell as it is."""

    object: float = 1.0  # mass and inertia, times what is believed
    object_centre_m: Vec3 = ZERO  # object axes: its centre of mass, less its frame
    pads_N_per_m: float | None = None  # None: as the cell says
    pads_Nm_per_rad: float | None = None
    pads_damping_ratio: float | None = None
    delay_s: float | None = None  # of the loop
    delay_jitter_s: float = 0.0
    arms: Mapping[str, ArmReality] = field(default_factory=dict)


def realised(believed: PlantSpec, reality: Reality) -> PlantSpec:
    """The specification of the cell as it is; its arms hold the object where it is believed to be at the start.

    Raises PlantError for an arm that is not there, and GraspError for one that no longer reaches its grasp.
    """
    unknown = sorted(set(reality.arms) - set(believed.names))
    if unknown:
        raise PlantError(
            "reality", found=f"arm {unknown[0]}", expected=" or ".join(believed.names), remedy="name an arm of the cell"
        )
    body = believed.object
    body = replace(
        body,
        mass_kg=reality.object * body.mass_kg,
        inertia=reality.object * body.inertia,
        centre_m=body.centre_m + np.array(reality.object_centre_m),
    )
    arms = tuple(_arm(arm, reality.arms.get(arm.name, ArmReality()), reality) for arm in believed.arms)
    moved = tuple(
        take_hold(arm, body) if _is_moved(reality.arms.get(arm.name)) else arm for arm in arms
    )  # an arm without an error keeps its start pose to the bit
    grasp = _pads(believed.grasp, reality)
    if grasp is None and (own := [arm.name for arm in arms if any(arm.pads)]):
        raise PlantError(
            f"reality of arm {own[0]}: pads", found="grasps that are welded",
            expected="pads of the cell, of which this arm has others", remedy="give the cell's pads as well",
        )  # fmt: skip
    return replace(believed, arms=moved, object=body, grasp=grasp)


def _is_moved(arm: ArmReality | None) -> bool:
    return arm is not None and any(map(any, (arm.base_m, arm.base_rad, arm.grasp_m, arm.grasp_rad)))


def _require_fit(arm: ArmSpec, real: ArmReality) -> None:
    for key in (f.name for f in fields(real) if f.default == ()):
        if len(values := getattr(real, key)) not in (0, len(arm.controlled)):
            raise PlantError(
                f"reality of arm {arm.name}: {key}",
                found=f"{len(values)} values",
                expected=f"one per controlled joint, {len(arm.controlled)}",
                remedy="give as many, or leave it out",
            )


def _arm(arm: ArmSpec, real: ArmReality, reality: Reality) -> ArmSpec:
    _require_fit(arm, real)
    R_base, R_grasp = pin.exp3(np.array(real.base_rad)), pin.exp3(np.array(real.grasp_rad))
    believed_base, believed_grasp = arm.T_world_base, arm.T_object_ee
    return replace(
        arm,
        T_world_base=pin.SE3(R_base @ believed_base.rotation, believed_base.translation + np.array(real.base_m)),
        T_object_ee=pin.SE3(R_grasp @ believed_grasp.rotation, believed_grasp.translation + np.array(real.grasp_m)),
        actuator=_actuator(arm, real, reality),
        friction=_friction(arm, real),
        masses=real.masses * arm.masses * _each(real.link_masses),
        pads=(real.pads_N_per_m, real.pads_Nm_per_rad),
        skew_s=arm.skew_s + real.skew_s,
    )


def _actuator(arm: ArmSpec, real: ArmReality, reality: Reality) -> ActuatorSpec:
    spec = arm.actuator
    rubs = real.friction * _each(real.joint_friction)
    return replace(
        spec,
        zero_error_rad=spec.zero_error_rad + (np.array(real.zeros_rad) if real.zeros_rad else 0.0),
        torque_scale=spec.torque_scale * _each(real.torque_constant),
        backlash_rad=np.array(real.backlash_rad) if real.backlash_rad else spec.backlash_rad,
        coulomb_Nm=rubs * spec.coulomb_Nm,
        viscous_Nms_rad=rubs * spec.viscous_Nms_rad,
        delay_s=spec.delay_s if reality.delay_s is None else reality.delay_s,
        delay_jitter_s=reality.delay_jitter_s,
    )


def _each(factors: tuple[float, ...]) -> Vector | float:
    """One per controlled joint, or 1 of all."""
    return np.array(factors) if factors else 1.0


def _friction(arm: ArmSpec, real: ArmReality) -> FrictionSpec | None:
    """With presliding where its joints are believed to stick, or do.  Raises PlantError."""
    believed, speed = arm.friction, real.stribeck_rad_per_s
    falls = believed is not None and bool(np.any(believed.breakaway_Nm) or np.any(believed.breakaway_load))
    if speed is not None and not (real.breakaway_Nm or falls):
        raise PlantError(
            f"reality of arm {arm.name}: stribeck_rad_per_s", found=f"{speed:g} rad/s of no breakaway",
            expected="breakaway that falls off over it, here or in the arm file",
            remedy="give breakaway_Nm as well, or leave it out",
        )  # fmt: skip
    if arm.friction is None and not (real.breakaway_Nm or real.load_friction):
        return None
    spec, times = arm.friction or FrictionSpec.smooth(arm.actuator), real.friction * _each(real.joint_friction)
    scaled = FrictionSpec(
        **{f.name: (times if f.name in _SCALED_FRICTION else 1.0) * getattr(spec, f.name) for f in fields(spec)}
    )
    own: dict[str, Vector] = {}
    if real.breakaway_Nm:
        own["breakaway_Nm"] = np.array(real.breakaway_Nm)
        speed = STRIBECK_RAD_PER_S if speed is None else speed
    if speed is not None:
        own["stribeck_rad_s"] = np.full(len(arm.controlled), speed)
    if real.load_friction:
        own["load"] = np.array(real.load_friction)
    return replace(scaled, **own)


def _pads(believed: GraspSpec | None, reality: Reality) -> GraspSpec | None:
    """Pads of the cell with what is known better; welds become pads where both stiffnesses are given."""
    if reality.pads_N_per_m is None and reality.pads_Nm_per_rad is None and reality.pads_damping_ratio is None:
        return believed
    known = {
        "stiffness_N_per_m": reality.pads_N_per_m,
        "stiffness_Nm_per_rad": reality.pads_Nm_per_rad,
        "damping_ratio": reality.pads_damping_ratio,
    }
    given = {key: value for key, value in known.items() if value is not None}
    if believed is not None:
        return replace(believed, **given)
    if len(given.keys() & {"stiffness_N_per_m", "stiffness_Nm_per_rad"}) < 2:
        raise PlantError(
            "reality: pads",
            found=", ".join(given),
            expected="pads_N_per_m and pads_Nm_per_rad where the cell's grasps are welded",
            remedy="give both, or neither",
        )
    return GraspSpec(**given)
