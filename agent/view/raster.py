"""Triangles to pixels, nearest in front: a small software renderer, so that a picture needs no graphics card."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.view.camera import NEAR_M, Camera
from agent.view.pose import Array

AMBIENT: Final = 0.45
_LIGHT: Final = np.array([-0.35, 0.75, 0.6])  # towards the light: right, up, back of the camera


class Raster:
    """One picture in the making."""

    def __init__(self, camera: Camera, width: int, height: int, ground: tuple[int, int, int]) -> None:
        self.camera, self.width, self.height = camera, width, height
        self.pixels: NDArray[np.uint8] = np.empty((height, width, 3), np.uint8)
        self.pixels[:] = ground
        self._depth = np.full((height, width), np.inf)

    def add(self, vertices: Array, faces: NDArray[np.int64], colour: tuple[int, int, int]) -> None:
        """Draw a solid: vertices (n, 3) m in the world, faces (m, 3)."""
        corners = vertices[faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        size = np.linalg.norm(normal, axis=1)
        towards = np.sum(normal * (self.camera.position - corners[:, 0]), axis=1) > 0.0
        light = _LIGHT @ self.camera.axes / np.linalg.norm(_LIGHT)
        bright = AMBIENT + (1.0 - AMBIENT) * np.clip(normal @ light / np.maximum(size, 1e-15), 0.0, 1.0)
        seen = self.camera.project(vertices, self.width, self.height)
        for face in np.flatnonzero(towards & (size > 0.0)):
            triangle = seen[faces[face]]
            if triangle[:, 2].min() > NEAR_M:
                self._fill(triangle, np.round(np.array(colour) * bright[face]).astype(np.uint8))

    def _fill(self, triangle: Array, colour: NDArray[np.uint8]) -> None:
        """One triangle (3, 3) of pixels x, y and distance; 1/distance is linear across it."""
        low = np.maximum(np.floor(triangle[:, :2].min(axis=0)), 0).astype(int)
        high = np.minimum(np.ceil(triangle[:, :2].max(axis=0)) + 1, [self.width, self.height]).astype(int)
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = triangle.tolist()
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0 or np.any(high <= low):
            return
        x = np.arange(low[0], high[0]) + 0.5
        y = (np.arange(low[1], high[1]) + 0.5)[:, None]
        b = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
        c = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
        inside = (b >= 0.0) & (c >= 0.0) & (b + c <= 1.0)
        if not inside.any():
            return
        depth = 1.0 / ((1.0 - b - c) / az + b / bz + c / cz)
        window = slice(low[1], high[1]), slice(low[0], high[0])
        nearest = inside & (depth < self._depth[window])
        self._depth[window][nearest] = depth[nearest]
        self.pixels[window][nearest] = colour
