"""Adaptive agents for property tests: random estimates, wide bounds, and a model that is what an estimate says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from agent.control.adaptation import ARM_PARAMETERS_PER_JOINT, Adaptation, Estimate
from agent.control.friction import LOAD_MAX, JointFriction
from agent.control.models import ArmModel
from agent.control.regressor import BODY_PARAMETERS, arm_parameters, object_parameters
from drivers.interface import Vector
from tests.support.control.strategies import Holder, arm_model, random_pose

WIDE = 1e6


def nominal_of(arm: Holder, friction: Sequence[JointFriction] = ()) -> Estimate:
    """The true parameters of the arm, with joints of this friction or of none, and of the object it holds."""
    n = arm.model.n
    rows = [(j.viscous_Nm_s_per_rad, j.coulomb_Nm, j.breakaway_Nm, j.load, j.breakaway_load) for j in friction]
    joints = [arm.model.model.armature, np.array(rows or np.zeros((n, 5))).T.ravel()]
    inertia = np.array(arm.offline.object_inertia).reshape(3, 3)
    return Estimate(
        np.concatenate([arm_parameters(arm.model), *joints]), object_parameters(arm.offline.object_mass_kg, inertia)
    )


def adaptation(
    nominal: Estimate,
    *,
    start: float = 1.0,
    gamma: float = 1e-3,
    gamma_object: float = 1.0,
    friction: bool = False,
    physical: bool = False,
    lower: float = -WIDE,
    upper: float = WIDE,
    sticking: Sequence[JointFriction] = (),
) -> Adaptation:
    """Adaptation from start times the nominal parameters; without friction columns those stay at zero."""
    columns, n = np.ones_like(nominal.arm), len(nominal.arm) // ARM_PARAMETERS_PER_JOINT
    if not friction:
        columns[-5 * n :] = 0.0
    upper_arm = np.full_like(nominal.arm, upper)
    if sticking:
        upper_arm[-2 * n :] = LOAD_MAX / 2
    return Adaptation(
        start=Estimate(start * nominal.arm, start * nominal.object),
        nominal=nominal,
        lower=Estimate(np.full_like(nominal.arm, lower), np.full_like(nominal.object, lower)),
        upper=Estimate(upper_arm, np.full_like(nominal.object, upper)),
        gain=Estimate(gamma * columns, np.full_like(nominal.object, gamma_object)),
        smooth_rad_per_s=0.05,
        friction=friction,
        physical=physical,
        period_s=0.005,
        sticking=tuple(sticking),
    )


def random_estimate(rng: np.random.Generator, nominal: Estimate) -> Estimate:
    """Another physical arm and object: masses, sizes and centres of mass of its own."""
    n = len(nominal.arm) // ARM_PARAMETERS_PER_JOINT
    bodies = [random_body(rng, 0.3) for _ in range(n)]
    return Estimate(
        np.concatenate([*bodies, rng.uniform(0.002, 0.05, n), rng.uniform(0.0, 0.1, 5 * n)]), random_body(rng, 0.2)
    )


def random_body(rng: np.random.Generator, scale_kg: float) -> Vector:
    """(10,) parameters of some rigid body within a decimetre of its frame."""
    placed = random_pose(rng, 0.1)
    mass, size = rng.uniform(0.1, 1.0) * scale_kg, rng.uniform(0.02, 0.2, 3)
    return placed.act(pin.Inertia.FromBox(mass, *size)).toDynamicParameters()


def model_of(arm: Holder, estimate: Estimate) -> ArmModel:
    """The arm whose true parameters are the estimate."""
    n = arm.model.n
    gravity = np.array(arm.offline.gravity)
    split = BODY_PARAMETERS * n
    model = arm_model(
        arm.name, arm.model.plane_normal is not None, arm.T_world_base, arm.T_object_ee, np.zeros(n), gravity
    )  # fmt: skip
    for j, body in enumerate(estimate.arm[:split].reshape(n, BODY_PARAMETERS), start=1):
        model.model.inertias[j] = pin.Inertia.FromDynamicParameters(body)
    model.model.armature = estimate.arm[split : split + n].copy()
    model.data = model.model.createData()
    return model


def holder_of(arm: Holder, estimate: Estimate) -> Holder:
    """The same arm and grasp with the estimate as the truth; the object's centre of mass must be its frame's origin."""
    m, ixx, ixy, iyy, ixz, iyz, izz = estimate.object[[0, 4, 5, 6, 7, 8, 9]].tolist()
    offline = replace(
        arm.offline, object_mass_kg=m, object_inertia=(ixx, ixy, ixz, ixy, iyy, iyz, ixz, iyz, izz), adaptation=None
    )
    return replace(arm, model=model_of(arm, estimate), offline=offline)
