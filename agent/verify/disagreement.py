"""Internal wrench that the stated tolerance of a cell makes the arms exert on each other; statics of the rigid cell.

Arm i sees the object off by δ_i: the base off and turned, the grasp off and turned, J times the joints' zeros, the
trajectory's speed times the skew of the starts.  Its law pulls with the stiffness S_i = (k_v K + c_i + V̂_i K) H
(agent.verify.criterion.loop), and the object settles at x, so that e_i = δ_i + x is the error that arm i sees:

    x = −(Σ S)⁻¹ Σ S δ,     F_i = −S_i e_i + J⁻ᵀ Δτ_i,     w_i = F_i − S_i (Σ S)⁻¹ Σ F

is the wrench beyond its share of the load; with two equal arms and Δτ = 0 it is ½ S δ.  Δτ_i: error of the torque
constants times the torque that holds arm and share, error of the arm's weight, and what friction of joints at rest,
breakaway and load in it, is beside that of the feed-forward.  Arms that align themselves give way to the anchor: of
their pose errors the dead zone is left, of what lies between an arm and the anchor what is beyond the largest shift; of
what an error makes along the way beside what it made at its begin, and beyond the dead zone, also the part β / (α + β)
by which the shift goes back (agent.control.alignment).

What is given is the quadratic sum over all errors, each at its stated bound, a vector's direction at random.  Soft pads
make less of it, and so does time: 95 % of realities of the shipped cells have up to 0.48 of it in the mean of a run.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.config.cell import Arm, Cell
from agent.config.friction import all_at_rest_Nm, unfiled_Nm
from agent.control.models import ArmModel, Matrix
from agent.verify.criterion.bodies import Pose
from agent.verify.criterion.loop import laws
from drivers.interface import Vector

MEAN_SHARE = 0.5  # of the quadratic sum, what the mean of a run may be
_FORCE, _MOMENT = slice(0, 3), slice(3, 6)


@dataclass(frozen=True, slots=True)
class Disagreement:
    """Size of the internal wrench of an arm at the object's centre, at the place where its force is largest."""

    force_N: float
    moment_Nm: float


@dataclass(frozen=True, eq=False)
class _Errors:
    """One arm's independent errors, each at its bound: a column each."""

    off: Matrix  # (m, s) δ
    came: Matrix  # (m, s) of it, what it was not at the begin of the way
    wrench: Matrix  # (m, t) J⁻ᵀ Δτ


def disagreement(
    cell: Cell,
    models: Sequence[ArmModel],
    poses: Sequence[Pose],
    along: Sequence[Sequence[Vector]],
    instants: Sequence[float],
) -> tuple[Disagreement, ...]:
    """Of every arm, largest over all places; along[k][i]: joint angles (n,) of arm i at instants[k], s.

    The first place is the begin, where arms have found together.
    """
    motion = cell.trajectory()
    at_begin = zip(cell.arms, models, along[0], strict=True)
    begun = [seen_off(cell, *of_arm, poses[0].P, np.zeros(len(poses[0].P))) for of_arm in at_begin]
    each = [_at(cell, models, at, q, motion.at(t).v, begun) for at, q, t in zip(poses, along, instants, strict=True)]
    return tuple(max(of_arm, key=lambda d: d.force_N) for of_arm in zip(*each, strict=True))


def seen_off(cell: Cell, arm: Arm, model: ArmModel, q: Vector, P: Matrix, v: Vector) -> Matrix:
    """δ (m, s) of an arm at q (n,), a column for each independent error at its bound; v (m,): twist of the motion."""
    stated, k = cell.tolerance, model.evaluate(q, np.zeros(model.n))
    reach = np.array(k.p_object) - arm.T_world_base.translation
    off = [
        _shift(P, stated.base_m), _turn(P, stated.base_rad, reach),
        _shift(P, stated.grasp_m), _turn(P, stated.grasp_rad, np.array(k.p_ee_object)),
        stated.zeros_of(arm.n) * (P @ model.task_basis.T @ k.J), stated.skew_s * v[:, None],
    ]  # fmt: skip
    found: Matrix = np.concatenate(off, axis=1)
    return found


def _at(
    cell: Cell,
    models: Sequence[ArmModel],
    at: Pose,
    q: Sequence[Vector],
    twist: Sequence[float],
    begun: Sequence[Matrix],
) -> list[Disagreement]:
    P, v = at.P, at.P @ np.array(twist)
    S = laws(at, [cell.offline(arm).gains for arm in cell.arms]).S
    of_arms = zip(cell.arms, models, q, begun, strict=True)
    errors = [_errors(cell, arm, model, q_i, P, v, b) for arm, model, q_i, b in of_arms]
    follows = _followers(cell)
    stiff = np.array([np.zeros_like(S_i) if f else S_i for S_i, f in zip(S, follows, strict=True)])
    given = [_wrenches(cell, P, S_i, e, follows=f) for S_i, e, f in zip(S, errors, follows, strict=True)]
    w = _internal(stiff, given)
    if any(follows):
        beyond = _beyond(cell, P, errors)
        w = np.concatenate([w, _internal(S, [-S_i @ (beyond * e.off) for S_i, e in zip(S, errors, strict=True)])], -1)
    world = P.T @ w
    return [Disagreement(float(np.linalg.norm(x[_FORCE])), float(np.linalg.norm(x[_MOMENT]))) for x in world]


def _followers(cell: Cell) -> list[bool]:
    spec = cell.file.controller.alignment
    if not spec.enabled or spec.track_per_s == 0.0:
        return [False] * len(cell.arms)
    return [i != cell.anchor for i in range(len(cell.arms))]


def _internal(stiff: Matrix, given: Sequence[Matrix]) -> Matrix:
    """(N, m, columns of all arms): wrenches beyond the shares when one column is all that acts."""
    ends = np.cumsum([0, *(g.shape[1] for g in given)])
    F = np.zeros((*stiff.shape[:2], ends[-1]))
    for i, g in enumerate(given):
        F[i, :, ends[i] : ends[i + 1]] = g
    found: Matrix = F - stiff @ np.linalg.inv(stiff.sum(axis=0)) @ F.sum(axis=0)
    return found


def _beyond(cell: Cell, P: Matrix, errors: Sequence[_Errors]) -> Matrix:
    """(m, 1): the part of the errors that the largest shift leaves, of the arm that is farthest from the anchor."""
    spec, linear = cell.file.controller.alignment, _linear(P)
    sizes = [np.linalg.norm(e.off, axis=1) for e in errors]
    apart = np.hypot(sizes[cell.anchor], np.max([s for i, s in enumerate(sizes) if i != cell.anchor], axis=0))
    part = np.zeros(len(P))
    for rows, most in ((linear, spec.max_m), (~linear, spec.max_rad)):
        size = float(np.linalg.norm(apart[rows]))
        part[rows] = max(0.0, 1.0 - most / size) if size > 0.0 else 0.0
    return part[:, None]


def _linear(P: Matrix) -> NDArray[np.bool_]:
    """(m,) which task rows are displacements; the others are turns."""
    found: NDArray[np.bool_] = np.linalg.norm(P[:, _FORCE], axis=1) > 0.5
    return found


def _wrenches(cell: Cell, P: Matrix, S: Matrix, errors: _Errors, *, follows: bool) -> Matrix:
    """What the arm's errors make it exert while nothing moves: a column each."""
    off, spec = errors.off, cell.file.controller.alignment
    if follows:
        # no more of an error is left than the dead zone, in any direction, and of what came since what goes back
        linear = _linear(P)
        zone = np.where(
            linear, spec.dead_zone_m / math.sqrt(linear.sum()), spec.dead_zone_rad / math.sqrt((~linear).sum())
        )
        back = spec.return_per_s / (spec.track_per_s + spec.return_per_s)
        zone += back * np.maximum(np.linalg.norm(errors.came, axis=1) - zone, 0.0)
        off = np.diag(np.minimum(np.linalg.norm(off, axis=1), zone))
    return np.concatenate([-S @ off, errors.wrench], axis=1)


def _errors(cell: Cell, arm: Arm, model: ArmModel, q: Vector, P: Matrix, v: Vector, begun: Matrix) -> _Errors:
    stated, offline, k = cell.tolerance, cell.offline(arm), model.evaluate(q, np.zeros(model.n))
    J = P @ model.task_basis.T @ k.J
    B_inv = np.linalg.inv(k.B)
    J_inv = B_inv @ J.T @ np.linalg.inv(J @ B_inv @ J.T)
    weight = P @ np.concatenate([-cell.file.object.mass_kg * cell.gravity, np.zeros(3)])
    held = k.g + J.T @ (offline.load_share * weight)
    low, high = stated.friction
    unknown = max(high - 1.0, 1.0 - low) if offline.friction is not None else high
    friction = unknown * all_at_rest_Nm(arm.servos, held) + unfiled_Nm(stated, arm.servos, held)
    torques = [stated.torque_constant * np.diag(held), stated.masses * k.g[:, None], np.diag(friction)]
    off = seen_off(cell, arm, model, q, P, v)
    return _Errors(off, off - begun, J_inv.T @ np.concatenate(torques, axis=1))


def _shift(P: Matrix, bound: float) -> Matrix:
    """(m, 3): a shift of this size, in any direction that the task rows have."""
    linear = P[:, _FORCE]
    return linear * bound / math.sqrt(np.linalg.matrix_rank(linear))


def _turn(P: Matrix, bound: float, lever: Vector) -> Matrix:
    """(m, 3): a turn of this size, about any axis that the task rows have; lever: from its centre to the object."""
    angular = P[:, _MOMENT]
    rows = angular.T @ angular
    x, y, z = lever
    across = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])  # ω × lever
    twists = np.concatenate([across @ rows, rows])
    found: Matrix = P @ twists * bound / math.sqrt(np.linalg.matrix_rank(angular))
    return found
