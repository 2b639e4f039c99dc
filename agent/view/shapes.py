"""Solids as triangles: the boxes, cylinders and balls that a URDF is made of, and the edges of a box."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.view.pose import Array

Colour = tuple[int, int, int]  # red, green, blue, 0 … 255

GRID: Final[Colour] = (222, 224, 226)  # lines of the floor
SIDES: Final = 20  # of what is round
_RINGS: Final = 10  # of a ball, from pole to pole


@dataclass(frozen=True, slots=True)
class Mesh:
    """Triangles of one colour in the frame of their body; seen from outside their corners turn to the left."""

    vertices: Array  # (n, 3) m
    faces: NDArray[np.int64]  # (m, 3)
    colour: Colour

    def placed(self, R: Array, p: Array) -> Mesh:
        """The same in a frame in which its own has rotation `R` and origin `p`."""
        return Mesh(self.vertices @ R.T + p, self.faces, self.colour)


def by_colour(meshes: Sequence[Mesh]) -> tuple[Mesh, ...]:
    """The same solids with all of one colour as one: a browser draws a body by each of them."""
    found: dict[Colour, list[Mesh]] = {}
    for mesh in meshes:
        found.setdefault(mesh.colour, []).append(mesh)
    return tuple(_together(alike) for alike in found.values())


def _together(meshes: Sequence[Mesh]) -> Mesh:
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + begin for mesh, begin in zip(meshes, first[:-1], strict=True)]
    return Mesh(np.vstack([mesh.vertices for mesh in meshes]), np.vstack(faces), meshes[0].colour)


_CORNERS: Final = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_QUADS: Final = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
_EDGES: Final = tuple((a, b) for a in range(8) for b in range(a + 1, 8) if bin(a ^ b).count("1") == 1)


def box(size_m: Array, colour: Colour) -> Mesh:
    """A box about its centre."""
    faces = [face for a, b, c, d in _QUADS for face in ((a, b, c), (a, c, d))]
    return Mesh(_CORNERS * size_m, np.array(faces), colour)


def box_edges(size_m: Array) -> Array:
    """The twelve edges of a box about its centre, (12, 2, 3)."""
    return np.asarray((_CORNERS * size_m)[np.array(_EDGES)])


def cylinder(radius_m: float, length_m: float, colour: Colour) -> Mesh:
    """A cylinder along z about its centre."""
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    ring = radius_m * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(SIDES)])
    half = np.array([0.0, 0.0, 0.5 * length_m])
    vertices = np.vstack([ring - half, ring + half, -half, half])
    low, high = 2 * SIDES, 2 * SIDES + 1
    faces = []
    for i in range(SIDES):
        j = (i + 1) % SIDES
        faces += [(i, j, SIDES + j), (i, SIDES + j, SIDES + i), (low, j, i), (high, SIDES + i, SIDES + j)]
    return Mesh(vertices, np.array(faces), colour)


def ball(radius_m: float, colour: Colour) -> Mesh:
    """A ball about its centre."""
    turn = 2.0 * np.pi * np.arange(SIDES) / SIDES
    height = np.pi * np.arange(1, _RINGS) / _RINGS
    rings = [np.column_stack([np.sin(h) * np.cos(turn), np.sin(h) * np.sin(turn), np.full(SIDES, -np.cos(h))])
             for h in height]  # fmt: skip
    vertices = radius_m * np.vstack([*rings, [[0, 0, -1]], [[0, 0, 1]]])
    south, north, last = len(vertices) - 2, len(vertices) - 1, SIDES * (_RINGS - 2)
    faces = []
    for i in range(SIDES):
        j = (i + 1) % SIDES
        faces += [(south, j, i), (north, last + i, last + j)]
        for ring in range(0, last, SIDES):
            faces += [(ring + i, ring + j, ring + SIDES + j), (ring + i, ring + SIDES + j, ring + SIDES + i)]
    return Mesh(vertices, np.array(faces), colour)
