"""Where a picture is taken from, and where points of the world fall in it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from agent.view.pose import Array
from agent.view.scene import Scene

FOV_RAD: Final = math.radians(35.0)  # of the picture's height
ELEVATION_RAD: Final = math.radians(18.0)
ASIDE_RAD: Final = math.radians(14.0)
MARGIN: Final = 1.06
NEAR_M: Final = 0.02


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole: x to the right, y up, looking along −z."""

    position: Array  # (3,) m
    look_at: Array  # (3,) m
    up: Array  # (3,)
    fov_rad: float = FOV_RAD

    @property
    def axes(self) -> Array:
        """Right, up and back as rows (3, 3)."""
        back = self.position - self.look_at
        back = back / np.linalg.norm(back)
        right = np.cross(self.up, back)
        right /= np.linalg.norm(right)
        return np.array([right, np.cross(back, right), back])

    def project(self, points: Array, width: int, height: int) -> Array:
        """Pixels x, y from the upper left and the distance in m (n, 3) of points (n, 3) in front of the camera."""
        x, y, z = ((points - self.position) @ self.axes.T).T
        depth = np.maximum(-z, NEAR_M)
        scale = 0.5 * height / (math.tan(0.5 * self.fov_rad) * depth)
        return np.column_stack([0.5 * width + x * scale, 0.5 * height - y * scale, depth])


def camera_for(scene: Scene, points: Array, aspect: float) -> Camera:
    """The view from the front, a little from above and aside, that just holds all points (n, 3).

    The first arm is on the left.  `aspect`: width over height of the picture.
    """
    up = scene.up
    back = _front(scene)
    right = np.cross(up, back)
    back = math.cos(ASIDE_RAD) * back + math.sin(ASIDE_RAD) * right
    back = math.cos(ELEVATION_RAD) * back + math.sin(ELEVATION_RAD) * up
    look_at = 0.5 * (points.min(axis=0) + points.max(axis=0))
    x, y, z = ((points - look_at) @ Camera(look_at + back, look_at, up).axes.T).T
    tangent = math.tan(0.5 * FOV_RAD)
    middle = look_at + 0.5 * (y.max() + y.min()) * Camera(look_at + back, look_at, up).axes[1]
    y = y - 0.5 * (y.max() + y.min())
    distance = float(np.max(z + MARGIN * np.maximum(np.abs(x) / aspect, np.abs(y)) / tangent))
    return Camera(middle + distance * back, middle, up)


def _front(scene: Scene) -> Array:
    """Horizontal direction towards somebody who sees the arms side by side, the first on the left."""
    up = scene.up
    bases = np.array([arm.p_world_base for arm in scene.cell.arms])
    along = bases[-1] - bases[0]
    along = along - float(along @ up) * up
    if np.linalg.norm(along) < 1e-6:
        along = np.cross(up, [0.0, 0.0, 1.0] if abs(up[2]) < 0.9 else [1.0, 0.0, 0.0])
    front = np.cross(along, up)
    return np.asarray(front / np.linalg.norm(front))
