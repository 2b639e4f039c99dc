"""From `[controller.adaptive]` of a cell to the offline data of one agent's adaptive law."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agent.config.friction import joint_friction
from agent.config.schema.adaptive import Adaptive, ArmBounds, Bounds, GainFactors, Start
from agent.config.schema.arm import ServoJoint
from agent.config.schema.controller import Controller
from agent.config.schema.world import Object
from agent.control.adaptation import Adaptation, Estimate
from agent.control.friction import LOAD_MAX, JointFriction
from agent.control.models import ArmModel, Matrix
from agent.control.regressor import BODY_PARAMETERS, arm_parameters, object_parameters
from drivers.interface import Refusal, Vector

_MOMENTS = [4, 6, 9]  # Ixx, Iyy, Izz of a body's ten
_BODY_NAMES = ("mass", "h_x", "h_y", "h_z", "I_xx", "I_xy", "I_yy", "I_xz", "I_yz", "I_zz")
_JOINT_NAMES = ("rotor inertia", "viscous friction", "Coulomb friction", "breakaway", "load friction", "breakaway load")


class AdaptationError(Refusal):
    """Start and bounds of the adaptive law do not fit together."""


def build(
    controller: Controller, model: ArmModel, servos: Sequence[ServoJoint], obj: Object, arm: str, period_s: float
) -> Adaptation:
    """Adaptation data of the arm called `arm`.  Raises AdaptationError when the bounds exclude the start."""
    spec = controller.adaptive
    n = model.n
    on = _joint_columns(spec, n)
    joints = _joint_parameters(controller, servos)
    nominal = Estimate(
        np.concatenate([arm_parameters(model), joints]),
        object_parameters(obj.mass_kg, np.array(obj.inertia_kg_m2.matrix())),
    )
    gain = Estimate(
        spec.gamma * np.concatenate([np.tile(_body_factors(spec.factor), n), _joint_factors(spec, n)]),
        spec.gamma_object * _body_factors(spec.factor_object),
    )
    scale = 0.0 if spec.start is Start.ZERO else spec.start_scale
    estimated = np.concatenate([np.ones(BODY_PARAMETERS * n), on]) > 0.0
    start = Estimate(np.where(estimated, scale * nominal.arm, nominal.arm), scale * nominal.object)
    lower, upper = _box(spec, nominal, n)
    _refuse_start_outside(f"arm of {arm}", start.arm, lower.arm, upper.arm, model.joints)
    _refuse_start_outside(f"object of {arm}", start.object, lower.object, upper.object, ())
    return Adaptation(
        start=start,
        nominal=nominal,
        lower=lower,
        upper=upper,
        gain=gain,
        smooth_rad_per_s=controller.friction_smooth_rad_per_s,
        friction=bool(np.any(_friction_on(controller))),
        physical=spec.physical,
        period_s=period_s,
        sticking=_sticking(controller, servos),
        leak_per_s=spec.leak_per_s,
    )


def _joint_columns(spec: Adaptive, n: int) -> Vector:
    """(6 n,) whether each joint parameter is estimated."""
    return np.repeat([spec.rotor_inertia, spec.viscous, spec.coulomb, spec.breakaway, spec.load, spec.load], n)


def _friction_on(controller: Controller) -> tuple[bool, ...]:
    """Whether each friction is in the law: estimated or compensated."""
    spec, known = controller.adaptive, controller.friction_feedforward
    return tuple(known or on for on in (spec.viscous, spec.coulomb, spec.breakaway, spec.load, spec.load))


def _sticking(controller: Controller, servos: Sequence[ServoJoint]) -> tuple[JointFriction, ...]:
    joints = tuple(joint_friction(servo) for servo in servos)
    return joints if any(_friction_on(controller)[2:]) and any(j.sticks for j in joints) else ()


def _joint_factors(spec: Adaptive, n: int) -> Vector:
    f = spec.factor
    return np.repeat([f.rotor_inertia, f.viscous, f.coulomb, f.breakaway, f.load, f.load], n) * _joint_columns(spec, n)


def _body_factors(f: GainFactors) -> Vector:
    return np.repeat([f.mass, f.first_moment, f.inertia], [1, 3, 6])


def _joint_parameters(controller: Controller, servos: Sequence[ServoJoint]) -> Vector:
    """(6 n,) configured; a friction that is neither estimated nor compensated is zero in the law."""
    joints = [joint_friction(servo) for servo in servos]
    friction = [(j.viscous_Nm_s_per_rad, j.coulomb_Nm, j.breakaway_Nm, j.load, j.breakaway_load) for j in joints]
    rotor = [s.rotor_inertia_kg_m2.value for s in servos]
    return np.concatenate([rotor, (np.array(friction) * _friction_on(controller)).T.ravel()])


def _box(spec: Adaptive, nominal: Estimate, n: int) -> tuple[Estimate, Estimate]:
    split = BODY_PARAMETERS * n
    bodies_low, bodies_high = _body_bounds(nominal.arm[:split], spec.bounds)
    object_low, object_high = _body_bounds(nominal.object, spec.bounds_object)
    joints_low, joints_high = _joint_bounds(nominal.arm[split:], spec, n)
    return (
        Estimate(np.concatenate([bodies_low, joints_low]), object_low),
        Estimate(np.concatenate([bodies_high, joints_high]), object_high),
    )


def _body_bounds(parameters: Vector, spec: Bounds) -> tuple[Vector, Vector]:
    """Box (10 b,) around bodies: how far their mass may change, and their centre of mass move with it."""
    bodies: Matrix = parameters.reshape(-1, BODY_PARAMETERS)
    mass = bodies[:, 0]
    heaviest = spec.relative_max * mass if spec.mass_max_kg is None else np.full_like(mass, spec.mass_max_kg)
    reach = np.linalg.norm(bodies[:, 1:4], axis=1) / np.where(mass > 0.0, mass, 1.0)
    # no principal moment of a body exceeds half the trace of its inertia
    moment = spec.relative_max * 0.5 * bodies[:, _MOMENTS].sum(axis=1) + heaviest * spec.slack_m * (
        2.0 * reach + spec.slack_m
    )
    high = np.empty_like(bodies)
    high[:, 0] = heaviest
    high[:, 1:4] = (heaviest * (reach + spec.slack_m))[:, None]
    high[:, 4:] = moment[:, None]
    low = -high
    low[:, 0] = spec.relative_min * mass
    low[:, _MOMENTS] = 0.0
    return low.ravel(), high.ravel()


def _joint_bounds(parameters: Vector, spec: Adaptive, n: int) -> tuple[Vector, Vector]:
    """Box (6 n,) of the joint parameters; those that are not estimated may only be what they are."""
    b: ArmBounds = spec.bounds
    limits = (b.rotor_inertia_max_kg_m2, b.viscous_max_Nm_s_per_rad, b.coulomb_max_Nm)
    high = b.relative_max * parameters
    for k, limit in enumerate(limits):
        if limit is not None:
            high[k * n : (k + 1) * n] = limit
    load, load_high = parameters[-2 * n :].reshape(2, n), high[-2 * n :].reshape(2, n)  # a view
    np.minimum(load_high, load + 0.5 * (LOAD_MAX - load.sum(axis=0)), out=load_high)
    on = _joint_columns(spec, n)
    return np.where(on, b.relative_min * parameters, parameters), np.where(on, high, parameters)


def _refuse_start_outside(what: str, start: Vector, low: Vector, high: Vector, joints: Sequence[str]) -> None:
    outside = np.flatnonzero((start < low) | (start > high))
    if not len(outside):
        return
    k, n = int(outside[0]), len(joints)
    if k < BODY_PARAMETERS * n or not joints:
        name = _BODY_NAMES[k % BODY_PARAMETERS] + (f" of the link behind {joints[k // BODY_PARAMETERS]}" if n else "")
    else:
        block, joint = divmod(k - BODY_PARAMETERS * n, n)
        name = f"{_JOINT_NAMES[block]} of {joints[joint]}"
    raise AdaptationError(
        f"start of the adaptive law, {what}, {name}",
        found=f"{start[k]:.4g}",
        expected=f"within its bounds {low[k]:.4g} to {high[k]:.4g}",
        remedy="widen controller.adaptive.bounds (bounds_object), or change start or start_scale",
    )
