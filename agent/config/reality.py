"""The reality of a simulated cell: as its file gives it, or drawn from a seed within the cell's tolerance."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any, Final

import numpy as np

from agent.config.cell import Arm, Cell
from agent.config.friction import unfiled
from agent.config.schema.reality import STIFFNESSES, ArmReality, Reality
from agent.config.schema.tolerance import Tolerance
from agent.control.quaternion import Vec3
from drivers.interface import Vector

STRIBECK_RAD_PER_S: Final = (0.1, 1.5)  # 1.1 and 1.5 are published of the MX-64; less is assumed


def reality_of(cell: Cell) -> Reality | None:
    """What the plant of this cell has against what its file says, value by value; None where the file says nothing."""
    given = cell.file.simulation.reality
    if given is None or given.seed is None:
        return given
    drawn = draw(cell.file.tolerance, given.seed, cell)
    arms = {name: arm.model_copy(update=_given(given.arms.get(name))) for name, arm in drawn.arms.items()}
    real = drawn.model_copy(update=_given(given) | {"seed": None, "arms": arms})
    return _jittering_within(real, real.delay_jitter_s)


def _given(values: ArmReality | Reality | None) -> dict[str, Any]:
    """What stands in the file."""
    return {} if values is None else {key: getattr(values, key) for key in values.model_fields_set}


def draw(tolerance: Tolerance, seed: int, cell: Cell) -> Reality:
    """One reality within the tolerance, the same for the same seed.

    Directions are uniform, and so are sizes up to the tolerance and factors within theirs; stiffness is uniform in its
    logarithm.  Arms that move in a plane stay in it.  A key that changes its range changes no other value drawn.
    """
    rng = np.random.default_rng(seed)
    normal = cell.model(cell.arms[0]).plane_normal
    arms = {arm.name: _arm(tolerance, rng, arm, normal, cell.T_world_object_start.rotation) for arm in cell.arms}
    believed_s = cell.file.simulated_delay_s
    # of a stream of their own: what a seed drew before there were these keys stays as it was
    more = np.random.default_rng([seed, 1])
    jitter_s = more.uniform(0.0, tolerance.delay_jitter_s)
    if tolerance.backlash_rad > 0.0:
        arms = {name: _worn(tolerance, more, arm) for name, arm in arms.items()}
    if cell.file.simulation.effects.friction:
        sticking = np.random.default_rng([seed, 2])
        arms = {arm.name: _sticking(tolerance, sticking, arm, arms[arm.name]) for arm in cell.arms}
    if not tolerance.joints_alike:
        each = np.random.default_rng([seed, 4])
        arms = {name: _joint_by_joint(tolerance, each, arm) for name, arm in arms.items()}
    if not tolerance.pads_alike:
        unlike = np.random.default_rng([seed, 3])
        arms = {name: _on_own_pads(tolerance, unlike, arm) for name, arm in arms.items()}
    drawn = Reality(
        object=rng.uniform(1.0 - tolerance.object, 1.0 + tolerance.object),
        object_centre_m=_offset(rng, tolerance.object_centre_m, normal, cell.T_world_object_start.rotation.T),
        pads_N_per_m=_log_uniform(rng, *tolerance.pads_N_per_m),
        pads_Nm_per_rad=_log_uniform(rng, *tolerance.pads_Nm_per_rad),
        pads_damping_ratio=tolerance.pads_damping_ratio,
        delay_s=believed_s * rng.uniform(*tolerance.delay),
        arms=arms,
    )
    return _jittering_within(drawn, jitter_s)


def drawn_arms(tolerance: Tolerance, seeds: Iterable[int], cell: Cell) -> Iterator[list[ArmReality]]:
    """Where `draw` of each seed has bases and grasps, and the zeros of the joints, arm by arm; much sooner."""
    normal, R = cell.model(cell.arms[0]).plane_normal, cell.T_world_object_start.rotation
    for seed in seeds:
        rng = np.random.default_rng(seed)
        yield [_arm(tolerance, rng, arm, normal, R) for arm in cell.arms]


def _jittering_within(real: Reality, jitter_s: float) -> Reality:
    """The same with this jitter, or as much of it as its delay has."""
    return real.model_copy(update={"delay_jitter_s": min(jitter_s, real.delay_s or 0.0)})


def _worn(tolerance: Tolerance, rng: np.random.Generator, arm: ArmReality) -> ArmReality:
    gaps_rad = rng.uniform(0.0, tolerance.backlash_rad, len(arm.zeros_rad))
    return arm.model_copy(update={"backlash_rad": tuple(gaps_rad.tolist())})


def _joint_by_joint(tolerance: Tolerance, rng: np.random.Generator, arm: ArmReality) -> ArmReality:
    joints = len(arm.zeros_rad)
    friction = rng.uniform(*tolerance.friction, joints)
    masses = rng.uniform(1.0 - tolerance.masses, 1.0 + tolerance.masses, joints)
    factors = {"joint_friction": tuple(friction.tolist()), "link_masses": tuple(masses.tolist())}
    return arm.model_copy(update={"friction": 1.0, "masses": 1.0, **factors})


def _on_own_pads(tolerance: Tolerance, rng: np.random.Generator, arm: ArmReality) -> ArmReality:
    pads = {key: _log_uniform(rng, *getattr(tolerance, key)) for key in STIFFNESSES}
    return arm.model_copy(update=pads)


def _sticking(tolerance: Tolerance, rng: np.random.Generator, arm: Arm, real: ArmReality) -> ArmReality:
    """With the friction that the cell states and the arm's file does not have."""
    breakaway, load = unfiled(tolerance, arm.servos)
    coulomb_Nm = np.array([servo.coulomb_Nm.value for servo in arm.servos])
    breakaway_Nm, loads = rng.uniform(0.0, breakaway, arm.n) * coulomb_Nm, rng.uniform(0.0, load, arm.n)
    drawn = {"breakaway_Nm": tuple(breakaway_Nm.tolist()), "stribeck_rad_per_s": _log_uniform(rng, *STRIBECK_RAD_PER_S)}
    update: dict[str, Any] = drawn if breakaway > 0.0 else {}
    if load > 0.0:
        update["load_friction"] = tuple(loads.tolist())
    return real.model_copy(update=update)


def _arm(
    tolerance: Tolerance, rng: np.random.Generator, arm: Arm, normal: Vector | None, R_world_object: Vector
) -> ArmReality:
    zeros_rad = tolerance.zeros_of(arm.n)
    share = tolerance.torque_constant
    return ArmReality(
        base_m=_offset(rng, tolerance.base_m, normal),
        base_rad=_turn(rng, tolerance.base_rad, normal),
        grasp_m=_offset(rng, tolerance.grasp_m, normal, R_world_object.T),
        grasp_rad=_turn(rng, tolerance.grasp_rad, normal, R_world_object.T),
        zeros_rad=tuple(rng.uniform(-zeros_rad, zeros_rad, arm.n).tolist()),
        masses=rng.uniform(1.0 - tolerance.masses, 1.0 + tolerance.masses),
        friction=rng.uniform(*tolerance.friction),
        torque_constant=tuple(rng.uniform(1.0 - share, 1.0 + share, arm.n).tolist()),
        skew_s=rng.uniform(0.0, tolerance.skew_s),
    )


def _offset(rng: np.random.Generator, most: float, normal: Vector | None, R: Vector | None = None) -> Vec3:
    """A displacement of size up to `most`, in the plane where there is one; R: from world axes to those asked for."""
    v = rng.normal(size=3)
    return _sized(rng, most, v if normal is None else v - normal * float(normal @ v), R)


def _turn(rng: np.random.Generator, most: float, normal: Vector | None, R: Vector | None = None) -> Vec3:
    """A rotation vector of size up to `most`, about the plane's normal where there is one."""
    v = rng.normal(size=3)
    return _sized(rng, most, v if normal is None else normal * float(normal @ v), R)


def _sized(rng: np.random.Generator, most: float, v: Vector, R: Vector | None) -> Vec3:
    v = v * (rng.uniform(0.0, most) / float(np.linalg.norm(v)))
    x, y, z = (v if R is None else R @ v).tolist()
    return x, y, z


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return min(max(math.exp(rng.uniform(math.log(low), math.log(high))), low), high)
