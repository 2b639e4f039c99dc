"""From the files of a cell to what makes one of its arms float: what is carried, walls, damping, watched bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agent.calm import brake_per_s
from agent.config import monitors
from agent.config.cell import Arm, Cell
from agent.config.schema.floating import Floating as Spec
from agent.control.floating import Floating
from agent.control.law import Offline
from agent.monitors.bounds import Bounds, Name
from drivers.interface import END_STOP_RAD, Vector

TOO_FAST = 2.5  # times the largest speed: it is pushed harder than it can resist, and stops
WATCHED = frozenset({
    Name.SPEED, Name.POSITION, Name.SATURATED, Name.RATE_LIMITED, Name.TEMPERATURE, Name.VOLTAGE, Name.SERVO_LOAD
})  # fmt: skip


def spec_of(cell: Cell, arm: Arm) -> Spec | None:
    """What the cell says of this arm's floating, or of its motion while others float; None for an arm that works."""
    spec = cell.file.floating
    return spec if spec is not None and spec.takes_part(arm.name) else None


def taking_part(cell: Cell) -> tuple[Arm, ...]:
    """The arms that float, and those that move while they do."""
    return tuple(arm for arm in cell.arms if spec_of(cell, arm) is not None)


def build(cell: Cell, arm: Arm, spec: Spec) -> Floating:
    """What the arm of a cell floats by."""
    model = cell.model(arm).model
    coulomb = np.array([servo.coulomb_Nm.value for servo in arm.servos])
    return Floating(
        low_rad=_fixed(model.lowerPositionLimit),
        high_rad=_fixed(model.upperPositionLimit),
        tau_max_Nm=_fixed(arm.tau_stall_Nm * cell.file.safety.tau_max_fraction_of_stall),
        friction_Nm=_fixed(spec.friction_share * coulomb),
        speed_max_rad_per_s=spec.speed_max_rad_per_s,
        drag_per_s=spec.drag_per_s,
        brake_per_s=brake_per_s(1.0 / cell.file.rate_hz),
    )


def carried(offline: Offline, spec: Spec) -> Offline:
    """What a floating arm knows of the object: nothing unless it holds it."""
    return offline if spec.holding else replace(offline, object_mass_kg=0.0, object_inertia=(0.0,) * 9)


def bounds(cell: Cell, arm: Arm, spec: Spec) -> Bounds:
    """Of the monitors that stop a floating arm; those of an object's motion are off.  Raises ConfigError.

    An arm that moves while others float has all of its own, and the bound of the speed.
    """
    model, usual = cell.model(arm).model, monitors.bounds(cell, arm)
    fastest = TOO_FAST * spec.speed_max_rad_per_s
    if spec.moves(arm.name):
        return replace(usual, speed_rad_per_s=tuple(min(own, fastest) for own in usual.speed_rad_per_s))
    low, high = model.lowerPositionLimit - END_STOP_RAD, model.upperPositionLimit + END_STOP_RAD
    return replace(
        usual,
        watched=usual.watched & WATCHED,
        speed_rad_per_s=(fastest,) * arm.n,
        position_rad=tuple(zip(low.tolist(), high.tolist(), strict=True)),
    )


def outside(cell: Cell, arm: Arm, q: Vector) -> list[tuple[str, float, float, float]]:
    """Joints at q (n,) that are beyond their limits: name, angle, limits, rad."""
    model = cell.model(arm).model
    rows = zip(arm.entry.controlled, q.tolist(), model.lowerPositionLimit, model.upperPositionLimit, strict=True)
    return [(n, x, float(a), float(b)) for n, x, a, b in rows if not a - END_STOP_RAD <= x <= b + END_STOP_RAD]


def _fixed(values: Vector) -> Vector:
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array
