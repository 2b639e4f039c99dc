"""What stands in the picture of a cell, and where each part of it is at each instant of a motion.

Names of what moves: `arms/ARM/JOINT`, `object`, `desired`, `belief/ARM`, and the arrows `wrench/ARM`, `internal/ARM`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from agent.view.arm import ArmBody
from agent.view.drawing import CellDrawing
from agent.view.motion import Motion
from agent.view.pose import Array, exaggerated, moved, sizes
from agent.view.shapes import Colour, Mesh, box

OBJECT: Final = "object"
DESIRED: Final = "desired"
OBJECT_COLOUR: Final[Colour] = (235, 190, 70)
DESIRED_COLOUR: Final[Colour] = (20, 20, 20)
INTERNAL_COLOUR: Final[Colour] = (140, 20, 110)
ARROW_M: Final = 0.12  # length of the largest arrow of a kind
ARROW_MAX_M: Final = 0.5  # of an arrow that would be longer by its scale
IMMENSE_N: Final = 1e4  # no arm has such a force: a law gone astray sets no scale
GRID_M: Final = 0.1
FAR_M: Final = 1.5  # beyond the outermost base nothing is kept in the picture


@dataclass(frozen=True, slots=True)
class Wire:
    """The edges of a box of the object's size."""

    name: str
    colour: Colour


@dataclass(frozen=True, slots=True)
class Arrows:
    """Arrows of one kind: `metres` for one newton."""

    name: str
    colour: Colour
    metres: float


@dataclass(frozen=True, slots=True)
class Placed:
    """Where everything is: pose (k, 7) of each solid and wire, from and to (k, 2, 3) of each arrow."""

    poses: Mapping[str, Array]
    arrows: Mapping[str, Array]


class Scene:
    """The picture of one cell; arrows are as long as `force_N` and `internal_N`, the largest of each kind, want."""

    def __init__(self, cell: CellDrawing, *, force_N: float, internal_N: float) -> None:
        self.cell = cell
        self._arms = [ArmBody(arm) for arm in cell.arms]
        self.size_m = np.array(cell.object_size_m)
        self.solids: dict[str, tuple[Mesh, ...]] = {
            f"arms/{arm.name}/{joint}": meshes for arm in self._arms for joint, meshes in arm.links.items()
        }
        self.solids[OBJECT] = (box(self.size_m, OBJECT_COLOUR),)
        self.wires = [Wire(DESIRED, DESIRED_COLOUR), *(Wire(f"belief/{a.name}", a.colour) for a in cell.arms)]
        self.arrows = [
            *(Arrows(f"wrench/{a.name}", a.colour, _scale(force_N)) for a in cell.arms),
            *(Arrows(f"internal/{a.name}", INTERNAL_COLOUR, _scale(internal_N)) for a in cell.arms),
        ]

    @classmethod
    def of(cls, cell: CellDrawing, motion: Motion) -> Scene:
        """The scene of a motion: no arrow of it is longer than ARROW_M."""
        arms = motion.arms.values()
        return cls(
            cell,
            force_N=max((_largest(arm.force_cmd) for arm in arms), default=0.0),
            internal_N=max((_largest(arm.internal) for arm in arms), default=0.0),
        )

    @property
    def up(self) -> Array:
        """Away from gravity; z where there is none."""
        gravity = np.array(self.cell.gravity)
        size = float(np.linalg.norm(gravity))
        return np.array([0.0, 0.0, 1.0]) if size == 0.0 else -gravity / size

    def place(self, motion: Motion, exaggeration: float = 1.0) -> Placed:
        """Everything at the instants of a motion; desired pose and beliefs so many times as far from the object.

        An arm that the motion does not have stands with all joints at zero.
        """
        k = len(motion.t)
        poses: dict[str, Array] = {OBJECT: motion.object}
        arrows: dict[str, Array] = {}
        scales = {arrow.name: arrow.metres for arrow in self.arrows}
        for arm, drawing in zip(self._arms, self.cell.arms, strict=True):
            own = motion.arms.get(arm.name)
            q = np.zeros((k, len(drawing.controlled))) if own is None else own.q
            links, ee = arm.placements(q)
            poses |= {f"arms/{arm.name}/{joint}": at for joint, at in links.items()}
            if own is None:
                continue
            poses[f"belief/{arm.name}"] = exaggerated(own.belief, motion.object, exaggeration)
            poses.setdefault(DESIRED, exaggerated(own.desired, motion.object, exaggeration))
            for kind, force in (("wrench", own.force_cmd), ("internal", own.internal)):
                arrows[f"{kind}/{arm.name}"] = _tail_and_tip(ee[:, :3], scales[f"{kind}/{arm.name}"] * force)
        return Placed(poses, arrows)

    def floor(self) -> Array:
        """Lines (n, 2, 3) of a grid under the arms."""
        up = self.up
        bases = np.array([arm.p_world_base for arm in self.cell.arms])
        lowest = float(np.min(bases @ up))
        middle = bases.mean(axis=0)
        middle += (lowest - float(middle @ up)) * up
        first = np.cross(up, [0.0, 1.0, 0.0] if abs(up[1]) < 0.9 else [0.0, 0.0, 1.0])
        first /= np.linalg.norm(first)
        second = np.cross(up, first)
        reach = GRID_M * np.ceil((0.3 + float(np.max(np.linalg.norm(bases - middle, axis=1)))) / GRID_M)
        at = np.arange(-reach, reach + 0.5 * GRID_M, GRID_M)
        lines = [(middle + a * u - reach * v, middle + a * u + reach * v) for u, v in ((first, second), (second, first))
                 for a in at]  # fmt: skip
        return np.array(lines)

    def points(self, placed: Placed, row: int) -> Array:
        """The corners (n, 3) of all solids at one instant, in the world; without those that flew away."""
        every = np.vstack([
            moved(placed.poses[name][row], mesh.vertices)
            for name, meshes in self.solids.items() if name in placed.poses
            for mesh in meshes
        ])  # fmt: skip
        bases = np.array([arm.p_world_base for arm in self.cell.arms])
        middle = bases.mean(axis=0)
        reach = FAR_M + float(np.max(np.linalg.norm(bases - middle, axis=1)))
        return np.asarray(every[np.linalg.norm(every - middle, axis=1) < reach])


def _tail_and_tip(p: Array, way: Array) -> Array:
    """Arrows (k, 2, 3) from points (k, 3); none where a force is no number, a short one where it is immense."""
    size = sizes(way)[:, None]
    with np.errstate(invalid="ignore", over="ignore"):
        shorter = way * np.minimum(1.0, ARROW_MAX_M / np.maximum(size, 1e-9))
    return np.stack([p, p + np.where(np.isfinite(size), shorter, 0.0)], axis=1)


def _scale(largest: float) -> float:
    return ARROW_M / largest if largest > 0.0 else 0.0


def _largest(forces: Array) -> float:
    found = sizes(forces)
    return float(np.max(found[found < IMMENSE_N], initial=0.0))
