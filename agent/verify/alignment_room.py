"""How near arms that align themselves come to anything, up to the limits of their shifts.

Asked of themselves, each other, object and table, at places along the motion, with one arm at a time shifted by `max_m`
or `max_rad` in every direction of its task.  The object is where the anchor has it; a gripper is not compared with it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final, NamedTuple

import pinocchio as pin

from agent.config.cell import Cell, placement
from agent.config.schema.driver import DriverKind
from agent.control import ik
from agent.control.models import ArmModel
from agent.verify.alignment_reach import set_to, shifts
from agent.verify.collision.scene import Scene
from agent.verify.finding import Finding, Verdict, judged
from drivers.interface import Vector

PLACES: Final = 6  # along the motion


class _Near(NamedTuple):
    """What an arm comes nearest to."""

    distance_m: float
    pair: str
    t_s: float


def alignment_room(
    cell: Cell,
    models: Sequence[ArmModel],
    along: Sequence[Sequence[Vector]],
    instants: Sequence[float],
    scene: Scene | None = None,
) -> list[Finding]:
    """One finding per following arm; along[k][i]: joint angles (n,) of arm i at instants[k], s."""
    spec = cell.file.controller.alignment
    if not spec.enabled or len(cell.arms) < 2:
        return []
    scene = scene or Scene(cell, models)
    every = max(1, math.ceil(len(instants) / PLACES))
    places = list(zip(along, instants, strict=True))[::every]
    return [
        _judged(cell, arm.name, partial(_nearest, cell, scene, models[i], i, places))
        for i, arm in enumerate(cell.arms)
        if i != cell.anchor
    ]


def _nearest(
    cell: Cell, scene: Scene, model: ArmModel, i: int, places: Sequence[tuple[Sequence[Vector], float]], part: float
) -> _Near | None:
    """What arm i comes nearest to at this part of its limits; None where nothing can be near it."""
    motion = cell.trajectory()
    pairs = [*scene.itself(i), *scene.with_object(i), *scene.with_table(i)]
    for j in range(len(cell.arms)):
        pairs += scene.between(*sorted((i, j))) if j != i else []
    if not pairs:
        return None
    poses, objects, times = [], [], []
    for q, t in places:
        desired = motion.at(t)
        for moved in _shifted(cell, model, q[i], part):
            poses.append([*q[:i], moved, *q[i + 1 :]])
            objects.append(placement(desired.p, desired.quat))
            times.append(t)
    if not poses:
        return None
    found = scene.way(poses, objects).least(pairs)
    if found is None:
        return None
    return _Near(found.distance_m, ", ".join(scene.shapes[n].label for n in found.pair), times[found.place])


def _shifted(cell: Cell, model: ArmModel, q: Vector, part: float) -> list[Vector]:
    """Joint angles (n,) at every limit that is within reach; those beyond are told by agent.verify.alignment_reach."""
    here, found = model.object_pose(q), []
    for shift in shifts(cell, model, part):
        moved = pin.SE3(pin.exp3(shift[3:]) @ here.rotation, here.translation + shift[:3])
        try:
            found.append(ik.solve(model, moved, q))
        except ik.Unreachable:
            continue
    return found


def _judged(cell: Cell, name: str, nearest: Callable[[float], _Near | None]) -> Finding:
    """nearest: of a part of the limits."""
    what, near = "distances up to the limits of the alignment", nearest(1.0)
    if near is None:
        return Finding(what, name, "nothing is near", "")
    distance = near.distance_m
    size = f"overlap by {-distance * 1e3:.1f} mm" if distance < 0.0 else f"{distance * 1e3:.1f} mm"
    return judged(
        what, name, f"{size} ({near.pair}, t = {near.t_s:.2f} s)", "no contact", holds=distance > 0.0,
        remedy="" if distance > 0.0 else f"{_room(cell, nearest)}, or make room",
        otherwise=Verdict.REFUSED if cell.file.driver is DriverKind.DYNAMIXEL else Verdict.WARNING,
    )  # fmt: skip


def _room(cell: Cell, nearest: Callable[[float], _Near | None]) -> str:
    """How much of the limits there is room for."""

    def is_clear(part: float) -> bool:
        near = nearest(part)
        return near is None or near.distance_m > 0.0

    if not is_clear(0.0):
        return "take the arm away from what it touches without any shift"
    return set_to(cell, is_clear)
