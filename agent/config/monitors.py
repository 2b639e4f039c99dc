"""The bounds of an arm's monitors, from the cell file and the arm's files alone; docs/monitors.md has them in words.

How far the wrench W of agent.monitors.gravity may be from zero follows from the cell's `[tolerance]`, by component:

    limit = max over arms of MARGIN √(Σ columns²),   columns = J⁻ᵀ (masses g), J⁻ᵀ e_j torque_constant τ_j,
                                                               J⁻ᵀ e_j friction F_j, J⁻ᵀ (object c Jᵀ w)

with τ = g + Jᵀ (c w + f_int) what the arm holds and F_j all that may hold a joint at rest: Coulomb friction, breakaway,
and what grows with the load.  The poses are those of the start.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

from agent.config.cell import Arm, Cell, ConfigError, placement
from agent.config.friction import lifting_Nm, unfiled_Nm
from agent.config.schema.controller import ControllerKind
from agent.config.schema.session import Session
from agent.config.session import rest_joints
from agent.config.statics import carried_Nm, held_Nm
from agent.config.trajectory import sample_times, waypoint_times
from agent.control import ik
from agent.control.inverse import pseudo_inverse
from agent.control.models import ArmModel, Kinematics, Matrix
from agent.monitors.bounds import Bounds, Name
from drivers.interface import Vector

MARGIN: Final = 1.4
SPEED_TIMES: Final = 2.0  # the motion's own
FASTEST: Final = 0.85  # of no-load speed, whatever the motion asks for
ADAPTIVE_TIMES: Final = 1.9  # arms that learn at rest share the weight as it happens
FLOORS: Final = (0.3, 0.3, 0.3, 0.03, 0.03, 0.03)
FRICTION_TIMES: Final = 3.0  # of the file's friction at rest: feedback beyond it moves any joint that is free
STEPS: Final = 99  # along the motion
NAMED_MAX: Final = 1000  # of the motion's own instants, for a box that takes no joints
AHEAD_MAX_RAD: Final = 0.1  # from which the next of them is looked for


class _Start(NamedTuple):
    """An arm with the object at its start."""

    model: ArmModel
    k: Kinematics


class _Shared(NamedTuple):
    """What the bounds of all arms of a cell are made from."""

    starts: Mapping[str, _Start]  # by arm
    workspace_m: tuple[tuple[float, float], ...]
    gravity: Vector  # (6,) N, N·m


def bounds(cell: Cell, arm: Arm) -> Bounds:
    """Of one arm.  Raises ConfigError where an arm of the cell cannot reach the object at its start."""
    return _bounds(cell, arm, _shared(cell))


def bounds_of_all(cell: Cell) -> list[Bounds]:
    """Of every arm, in order.  Raises ConfigError as `bounds` does."""
    shared = _shared(cell)
    return [_bounds(cell, arm, shared) for arm in cell.arms]


def _shared(cell: Cell) -> _Shared:
    spec, starts = cell.file.safety.monitors, {arm.name: _start(cell, arm) for arm in cell.arms}
    workspace_m = spec.workspace_m or _around_motion(cell, spec.workspace_margin_m)
    return _Shared(starts, workspace_m, spec.gravity_times * _gravity(cell, starts))


def _bounds(cell: Cell, arm: Arm, shared: _Shared) -> Bounds:
    spec, file = cell.file.safety.monitors, cell.file
    no_load = np.array([m.no_load_rad_per_s for m in arm.servo_models])
    model, k = shared.starts[arm.name]
    held = held_Nm(cell, arm, k)
    at_rest = _friction(arm, held) + unfiled_Nm(cell.tolerance, arm.servos, held)
    low = model.model.lowerPositionLimit + spec.position_margin_rad
    high = model.model.upperPositionLimit - spec.position_margin_rad
    x, y, z = (-file.object.mass_kg * cell.gravity).tolist()
    return Bounds(
        joints=tuple(arm.entry.controlled),
        period_s=1.0 / file.rate_hz,
        watched=frozenset(Name) - frozenset(spec.off),
        speed_rad_per_s=tuple(_speeds(cell, arm, model, no_load).tolist()),
        speed_alone_rad_per_s=tuple(_speeds_alone(cell, no_load).tolist()),
        power_W=tuple((spec.power_share * 0.25 * arm.tau_stall_Nm * no_load).tolist()),
        position_rad=tuple(zip(low.tolist(), high.tolist(), strict=True)),
        position_alone_rad=_alone(cell, arm, low, high),
        workspace_m=shared.workspace_m,
        start_m=file.safety.start_error_max_m,
        start_rad=file.safety.start_error_max_rad,
        limited_share=spec.limited_share,
        frozen_rad=spec.frozen_rad,
        frozen_Nm=tuple((FRICTION_TIMES * at_rest).tolist()),
        load_share=spec.load_share,
        stall_Nm=tuple(arm.tau_stall_Nm.tolist()),
        load_time_s=spec.load_time_s,
        load_share_of_weight=arm.entry.load_share,
        object_weight_N=(x, y, z),
        gravity=tuple(shared.gravity.tolist()),
        temperature_margin_C=spec.temperature_margin_C,
        voltage_margin_V=spec.voltage_margin_V,
    )


def _alone(cell: Cell, arm: Arm, low: Vector, high: Vector) -> tuple[tuple[float, float], ...]:
    """Wide enough for the rest of an arm that has a session."""
    if cell.file.session is not None:
        rest, beside = rest_joints(arm), cell.file.session.off_max_rad
        low, high = np.minimum(low, rest - beside), np.maximum(high, rest + beside)
    return tuple(zip(low.tolist(), high.tolist(), strict=True))


def _around_motion(cell: Cell, margin_m: float) -> tuple[tuple[float, float], ...]:
    trajectory = cell.trajectory()
    named, _ = waypoint_times(cell.file, min(trajectory.period_s, cell.file.duration_s), NAMED_MAX)
    times = [*sample_times(cell.file, trajectory, STEPS), *named]
    places = np.array([cell.file.object.p_start_m, *(trajectory.at(t).p for t in times)])
    low, high = places.min(axis=0) - margin_m, places.max(axis=0) + margin_m
    return tuple(zip(low.tolist(), high.tolist(), strict=True))


def _speeds(cell: Cell, arm: Arm, model: ArmModel, no_load: Vector) -> Vector:
    """(n,) rad/s: a share of what the servos can, and what the motion asks for twice over."""
    spec = cell.file.safety.monitors
    asked = SPEED_TIMES * speeds_of_motion(cell, arm, model)
    found: Vector = np.minimum(spec.speed_share * no_load + asked, max(FASTEST, spec.speed_share) * no_load)
    return found


def _speeds_alone(cell: Cell, no_load: Vector) -> Vector:
    """(n,) rad/s: a share of what the servos can, and what the session asks for."""
    share, asked = cell.file.safety.monitors.speed_share, (cell.file.session or Session()).speed_max_rad_per_s
    found: Vector = np.minimum(share * no_load + asked, max(FASTEST, share) * no_load)
    return found


def speeds_of_motion(cell: Cell, arm: Arm, model: ArmModel) -> Vector:
    """(n,) rad/s: the largest along the desired motion; as far as the arm can follow it."""
    trajectory, P = cell.trajectory(), model.task_basis
    q, dq, fastest = np.array(arm.entry.q_near_rad), np.zeros(model.n), np.zeros(model.n)
    times = sample_times(cell.file, trajectory, STEPS)
    before = times[0]
    for t in times:
        desired, ahead = trajectory.at(t), dq * (t - before)
        if np.abs(ahead).max() > AHEAD_MAX_RAD:  # beside a singular pose it leads to other solutions
            ahead = np.zeros(model.n)
        try:
            q = ik.solve(model, placement(desired.p, desired.quat), q + ahead)
        except ik.Unreachable:  # `coop check` refuses the cell for it
            break
        dq, before = pseudo_inverse(model.jacobian(q)) @ (P @ np.array(desired.v)), t
        fastest = np.maximum(fastest, np.abs(dq))
    return fastest


def _gravity(cell: Cell, starts: Mapping[str, _Start]) -> Vector:
    """(6,) N, N·m, before `gravity_times`: the same for every arm of the cell."""
    sizes = [np.linalg.norm(_errors_at_rest(cell, arm, starts[arm.name]), axis=1) for arm in cell.arms]
    adaptive = cell.file.controller.kind is ControllerKind.ADAPTIVE
    found: Vector = np.maximum(FLOORS, MARGIN * (ADAPTIVE_TIMES if adaptive else 1.0) * np.max(sizes, axis=0))
    return found


def _errors_at_rest(cell: Cell, arm: Arm, start: _Start) -> Matrix:
    """(6, s) what errors within the tolerance make of W at the start: a column each."""
    (model, k), stated = start, cell.tolerance
    carried = carried_Nm(cell, arm, k)
    held = held_Nm(cell, arm, k)
    torques = [
        (stated.masses * k.g)[:, None],
        np.diag(stated.torque_constant * held),
        np.diag(stated.friction[1] * _friction(arm, held) + unfiled_Nm(stated, arm.servos, held)),
        (stated.object * carried)[:, None],
    ]
    found: Matrix = model.task_basis.T @ np.linalg.pinv(k.J).T @ np.column_stack(torques)
    return found


def _friction(arm: Arm, held_Nm: Vector) -> Vector:
    """(n,) N·m that friction may be at rest where so much is to be held."""
    return np.array([lifting_Nm(servo, tau) for servo, tau in zip(arm.servos, held_Nm.tolist(), strict=True)])


def _start(cell: Cell, arm: Arm) -> _Start:
    model = cell.model(arm)
    try:
        q = ik.solve(model, cell.T_world_object_start, np.array(arm.entry.q_near_rad))
    except ik.Unreachable as error:
        raise ConfigError(
            f"bounds of [safety.monitors], arm {arm.name}",
            found=f"a start pose out of reach ({error})", expected="a pose that the arm holds",
            remedy="see `coop check`",
        ) from error  # fmt: skip
    return _Start(model, model.evaluate(q, np.zeros(model.n)))
