"""How near solid bodies of a cell come: each arm to itself, to the others, to object and table, along its motion.

Bodies are the boxes, cylinders and balls of the URDFs (agent.config.solids), the object is the box of its `size_m`,
the table a plane.  Distances are computed at places along the way; between two of them a body can be nearer by half of
what it moves relative to the other, which is taken off: what is reported is a lower bound of the distance of these
bodies on the whole way.

Not looked at are links without a joint or with one joint between them, links that touch where all controlled joints
are zero (they are listed), an arm's gripper against the object that it holds, and its base against the table.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Final

from agent.config.cell import Cell, placement
from agent.control.models import ArmModel
from agent.verify.collision.scene import Scene
from agent.verify.collision.way import Nearest, Pair
from agent.verify.finding import Finding, judged, warning
from drivers.interface import Vector

STANDS_M: Final = 1e-3  # by which an object that stands on the table may be in it
PLACES_MAX: Final = 800


def collisions(
    cell: Cell,
    models: Sequence[ArmModel],
    paths: Sequence[Sequence[Vector]],
    instants: Sequence[float],
    scene: Scene | None = None,
) -> list[Finding]:
    """Findings on distances along the trajectory; paths[i][k]: joint angles (n,) of arm i at instants[k], s."""
    scene, times, along = scene or Scene(cell, models), *_places(paths, instants)
    motion = cell.trajectory()
    desired = [motion.at(t) for t in times]
    way = scene.way(along, [placement(d.p, d.quat) for d in desired])
    names, margin = [arm.name for arm in cell.arms], cell.file.safety.collision_margin_m
    found: list[Finding] = []

    def add(what: str, where: str, pairs: list[Pair], remedy: str, least: float = margin) -> None:
        near = way.nearest(pairs)
        if near is not None:
            found.append(_judged(scene, near, times, (what, where, remedy), least))

    for i, name in enumerate(names):
        found += _left_out(scene, i, name)
        add("distance of the arm to itself", name, scene.itself(i), "take another elbow branch (q_near_rad) or base")
        add("distance to the object", name, scene.with_object(i), "grasp farther out, or from another side")
        add("distance to the table", name, scene.with_table(i), "lift the motion, or grasp from above")
    for i, j in itertools.combinations(range(len(names)), 2):
        where = f"{names[i]} and {names[j]}"
        add("distance of the arms", where, scene.between(i, j), "move bases or grasps apart")
    add("distance of object and table", "cell", scene.standing(), "lift the motion or its start", -STANDS_M)
    return found


def _judged(scene: Scene, near: Nearest, times: Sequence[float], words: tuple[str, str, str], least: float) -> Finding:
    what, where, remedy = words
    first, second = (scene.shapes[k].label for k in near.pair)
    size = f"overlap by {-near.distance_m * 1e3:.1f} mm" if near.distance_m < 0.0 else f"{near.distance_m * 1e3:.1f} mm"
    return judged(
        what, where, f"{size} ({first}, {second}, t = {times[near.place]:.2f} s)", f"≥ {least * 1e3:g} mm",
        holds=near.distance_m >= least, remedy=remedy,
    )  # fmt: skip


def _left_out(scene: Scene, i: int, name: str) -> Iterator[Finding]:
    touching, unknown = scene.touching[name], scene.bodies[i].unknown
    if touching:
        listed = ", ".join(sorted("–".join(pair) for pair in touching))
        yield Finding("links that touch by design, not compared", name, listed, "")
    if unknown:
        yield warning(
            "links whose shape is not known", name, ", ".join(unknown), "boxes, cylinders or balls in the URDF",
            "give them <collision> elements of these; a file of triangles is not read",
        )  # fmt: skip


def _places(paths: Sequence[Sequence[Vector]], instants: Sequence[float]) -> tuple[list[float], list[list[Vector]]]:
    """Times and joint angles along the way: the given places and one between each two, thinned where they are many."""
    every = max(1, math.ceil(2 * len(instants) / PLACES_MAX))
    kept = sorted({*range(0, len(instants), every), len(instants) - 1})
    times, along = [], []
    for k, after in itertools.zip_longest(kept, kept[1:]):
        here = [path[k] for path in paths]
        times.append(instants[k])
        along.append(here)
        if after is not None:
            times.append(0.5 * (instants[k] + instants[after]))
            along.append([0.5 * (q + path[after]) for q, path in zip(here, paths, strict=True)])
    return times, along
