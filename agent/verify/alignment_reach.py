"""Whether arms that align themselves can follow their shifts up to the limits: reach and nearness to singular poses."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np
import pinocchio as pin

from agent.config.cell import Cell
from agent.config.schema.driver import DriverKind
from agent.control import ik, joint_hold
from agent.control.models import ArmModel
from agent.verify.finding import Finding, Verdict, judged
from drivers.interface import Vector

HALVINGS = 6  # to the limit that holds


def alignment_reach(
    cell: Cell, models: Sequence[ArmModel], along: Sequence[Sequence[Vector]], instants: Sequence[float]
) -> list[Finding]:
    """One finding per following arm; along[k][i]: joint angles (n,) of arm i at instants[k], s."""
    spec = cell.file.controller.alignment
    if not spec.enabled or len(cell.arms) < 2:
        return []
    findings = []
    for i, (arm, model) in enumerate(zip(cell.arms, models, strict=True)):
        if i == cell.anchor:
            continue
        lost = next((t for q, t in zip(along, instants, strict=True) if not _follows(cell, model, q[i], 1.0)), None)
        own = [q[i] for q in along]
        findings.append(
            judged(
                "limits of the alignment", arm.name,
                "within reach" if lost is None else f"out of reach at t = {lost:.3g} s",
                f"{spec.max_m * 1e3:g} mm and {spec.max_rad * 1e3:g} mrad in every direction", holds=lost is None,
                remedy="" if lost is None else set_to(cell, partial(_follows_all, cell, model, own)),
                otherwise=Verdict.REFUSED if cell.file.driver is DriverKind.DYNAMIXEL else Verdict.WARNING,
            )
        )  # fmt: skip
    return findings


def set_to(cell: Cell, holds: Callable[[float], bool]) -> str:
    """Remedy that names both limits, as much of them as `holds`."""
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    spec = cell.file.controller.alignment
    return f"set max_m = {_less(low * spec.max_m)} and max_rad = {_less(low * spec.max_rad)}"


def _less(value: float) -> str:
    """Two digits of it, never more than it."""
    digit = 10.0 ** (math.floor(math.log10(value)) - 1) if value > 0.0 else 1.0
    return f"{math.floor(value / digit) * digit:.2g}"


def _follows_all(cell: Cell, model: ArmModel, along: Sequence[Vector], part: float) -> bool:
    return all(_follows(cell, model, q, part) for q in along)


def _follows(cell: Cell, model: ArmModel, q: Vector, part: float) -> bool:
    """Whether the arm at q (n,) reaches the object shifted by this part of the limits, in every direction."""
    here = model.object_pose(q)
    lower, upper = model.model.lowerPositionLimit, model.model.upperPositionLimit
    for shift in shifts(cell, model, part):
        moved = pin.SE3(pin.exp3(shift[3:]) @ here.rotation, here.translation + shift[:3])
        try:
            reached = ik.solve(model, moved, q)
        except ik.Unreachable:
            return False
        if (reached < lower).any() or (reached > upper).any():
            return False
        if joint_hold.sigma_min(model, reached) < cell.file.safety.sigma_min:
            return False
    return True


def shifts(cell: Cell, model: ArmModel, part: float) -> Iterator[Vector]:
    """Shifts (6,) along and about every task row, either way."""
    spec = cell.file.controller.alignment
    for row, sign in itertools.product(model.task_basis, (-1.0, 1.0)):
        size = spec.max_m if np.linalg.norm(row[:3]) > 0.5 else spec.max_rad
        yield sign * part * size * row
