"""What the unexpected wrench on an arm carries without a fault, from the cell's files: sizes that limits come from.

Which limit is made of which part, and how, is for `agent.config.noticing`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from agent.config import observer
from agent.config.cell import Arm, Cell, ConfigError, placement
from agent.config.friction import all_at_rest_Nm, unfiled_Nm
from agent.config.once import once_per_cell
from agent.config.statics import held_Nm
from agent.config.trajectory import sample_times
from agent.control import ik
from agent.control.errors import HALF_ANGLE
from agent.control.inverse import SingularJacobian, invert_jacobian
from agent.control.law import Offline
from agent.control.models import ArmModel, Kinematics, Matrix
from drivers.dynamixel.servo.counts import TICK_RAD, VELOCITY_UNIT_RAD_PER_S
from drivers.interface import Vector

PLACES: Final = 12  # along the motion, and more where these hide a part of it
UNKNOWN_LEAST: Final = 0.2  # of friction: where it sticks or turns round no figure of it helps
CALIBRATED_SHARE: Final = 0.2  # position gain of the observer in studies; a slower one doubles friction's jumps


class Size(NamedTuple):
    """Of a wrench: a quadratic sum over independent errors at their bounds."""

    force_N: float
    moment_Nm: float


class Usual(NamedTuple):
    """Parts of it, each the largest over arms and places of the motion."""

    friction: Size  # that the feed-forward may lack
    noise: Size  # steps of the encoders
    errors: Size  # change along the motion
    steps: Size  # of encoders and measured speeds, both at once
    turned_N: float  # all friction of all joints along gravity: so much a feed-forward that has turned round may bear


class _Arm(NamedTuple):
    """One arm, what it knows, and its law on the task rows."""

    cell: Cell
    arm: Arm
    model: ArmModel
    offline: Offline
    KH: Matrix  # (m, m) K H
    S: Matrix  # (6, m) wrench per error


class _Place(NamedTuple):
    """An arm at one place of the motion."""

    v: Vector  # (m,) of the motion
    k: Kinematics
    J_inv: Matrix  # (n, m)
    to_wrench: Matrix  # (6, n) J⁻ᵀ of joint torques


def down(cell: Cell) -> tuple[float, float, float]:
    """Direction of gravity, world axes; zero where there is none."""
    x, y, z = cell.gravity.tolist()
    size = math.hypot(x, y, z) or math.inf
    return (x / size, y / size, z / size)


@once_per_cell
def usual(cell: Cell) -> Usual:
    """Of this cell.  Raises ConfigError where an arm cannot be placed."""
    along = [(known, _places(known)) for known in (_known(cell, arm) for arm in cell.arms)]
    sizes = np.max([_sizes(known, places) for known, places in along], axis=0).tolist()
    friction, noise, errors, steps = (Size(*one) for one in sizes)
    turned_N = max(_turned_N(known, at) for known, places in along for at in places)
    return Usual(friction, noise, errors, steps, turned_N)


def _sizes(known: _Arm, places: Sequence[_Place]) -> Matrix:
    """(4, 2) force and moment of each `Size` of `Usual`, largest over the places."""
    errors = [_errors(known, at) for at in places]
    late = [known.S @ (known.cell.tolerance.skew_s * at.v) for at in places]
    changes = [np.column_stack([e - errors[0], x]) for e, x in zip(errors, late, strict=True)]
    unknown = [at.to_wrench * _unknown_Nm(known, at) for at in places]
    noise = [_noise(known, at) for at in places]
    of_each = [[_size(columns) for columns in one] for one in (unknown, noise, changes)]
    steps = np.add(of_each[1], [_size(_speeds(known, at)) for at in places])
    return np.array([np.max(one, axis=0) for one in (*of_each, steps)])


def _size(columns: Matrix) -> tuple[float, float]:
    """Quadratic sum of forces and of moments; columns (6, s)."""
    return float(np.linalg.norm(columns[:3])), float(np.linalg.norm(columns[3:]))


def _known(cell: Cell, arm: Arm) -> _Arm:
    model, offline = cell.model(arm), cell.offline(arm)
    P, gains, H = model.task_basis, offline.gains, np.array(HALF_ANGLE)
    KH = np.array([*gains.k_p, *gains.k_eps]) * H
    S = np.diag(np.array(gains.k_v) * KH + offline.load_share * H)
    return _Arm(cell, arm, model, offline, P @ np.diag(KH) @ P.T, P.T @ (P @ S @ P.T))


def _places(known: _Arm) -> list[_Place]:
    cell, arm, model = known.cell, known.arm, known.model
    trajectory, q, P = cell.trajectory(), np.array(arm.entry.q_near_rad), model.task_basis
    places = []
    for t in sample_times(cell.file, trajectory, PLACES)[:-1]:
        desired = trajectory.at(t)
        try:
            q = ik.solve(model, placement(desired.p, desired.quat), q)
            k = model.evaluate(q, np.zeros(model.n))
            J_inv, _ = invert_jacobian(k.J, k.B)
        except (ik.Unreachable, SingularJacobian) as error:
            raise ConfigError(
                f"thresholds of [safety.noticing], arm {arm.name} at t = {t:.2f} s",
                found=f"a pose that the arm cannot hold ({str(error) or 'singular'})",
                expected="poses along the motion to derive them at",
                remedy="see `coop check`, or give fast_N, fast_Nm, slow_N and slow_Nm",
            ) from error
        places.append(_Place(P @ np.array(desired.v), k, J_inv, P.T @ J_inv.T))
    return places


def _unknown_Nm(known: _Arm, at: _Place) -> Vector:
    """(n,) friction of each joint that the arm's feed-forward may lack."""
    stated, held = known.cell.tolerance, held_Nm(known.cell, known.arm, at.k)
    low, high = stated.friction
    share = high if known.offline.friction is None else max(high - 1.0, 1.0 - low, UNKNOWN_LEAST)
    servos = known.arm.servos
    found: Vector = share * all_at_rest_Nm(servos, held) + unfiled_Nm(stated, servos, held)
    return found


def _turned_N(known: _Arm, at: _Place) -> float:
    rubbing = at.to_wrench[:3] * all_at_rest_Nm(known.arm.servos, held_Nm(known.cell, known.arm, at.k))
    return float(np.abs(np.array(down(known.cell)) @ rubbing).sum())


def _noise(known: _Arm, at: _Place) -> Matrix:
    """(6, n) what half a step of each encoder leaves in the unexpected wrench."""
    seen, L = observer.build(known.cell.file), known.cell.file.safety.noticing.rate_per_s
    share = 1.0 if seen is None else max(CALIBRATED_SHARE, seen.position_gain)
    jump = at.J_inv @ known.KH @ at.k.J  # of dq_r, per angle
    found: Matrix = at.to_wrench @ (L * at.k.B @ jump) * (share * 0.5 * TICK_RAD)
    return found


def _speeds(known: _Arm, at: _Place) -> Matrix:
    """(6, n) what half a step of each measured speed leaves in the unexpected wrench."""
    seen, L = observer.build(known.cell.file), known.cell.file.safety.noticing.rate_per_s
    share = 1.0 if seen is None else seen.velocity_gain
    found: Matrix = at.to_wrench @ (L * at.k.B) * (share * 0.5 * VELOCITY_UNIT_RAD_PER_S)
    return found


def _errors(known: _Arm, at: _Place) -> Matrix:
    """(6, s) what constant errors make of the unexpected wrench here: a column each."""
    cell, arm, P, k = known.cell, known.arm, known.model.task_basis, at.k
    stated = cell.tolerance
    held = held_Nm(cell, arm, k)
    x, y, z = (np.array(k.p_object) - arm.T_world_base.translation).tolist()
    across = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])  # ω × reach
    R = np.reshape(k.R_world_object, (3, 3))
    shifts = np.column_stack([across * stated.base_rad, R * stated.grasp_m]) / math.sqrt(3.0)
    off = np.column_stack([P[:, :3] @ shifts, stated.zeros_of(arm.n) * k.J])
    torques = np.column_stack([stated.masses * k.g, stated.torque_constant * np.diag(held)])
    return np.column_stack([at.to_wrench @ torques, known.S @ off])
