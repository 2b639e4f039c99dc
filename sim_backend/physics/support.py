"""A table that an object stands on: its lowest corners are pushed up by springs and dampers and rub on it.

The table is a plane without end.  Its springs are tuned to the object's mass, so that a step of a millisecond follows
them; an object that stands sinks in by g / ω², and the plane is laid so that it then stands at its given pose.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import pinocchio as pin

from drivers.interface import Vector

OMEGA_RAD_PER_S = 150.0  # ω, with which an object bounces
DAMPING_RATIO = 0.7
FRICTION = 0.5  # coefficient
GRIP_PER_S = 30.0  # per corner, of the object's mass: how hard a corner is dragged along before it slips


class Support:
    """Where an object of `size_m` stands before a run, and the wrench that bears it."""

    def __init__(self, T_world_object: pin.SE3, size_m: Vector, mass_kg: float, gravity: Vector) -> None:
        """T_world_object: as it stands; gravity (3,) m/s², not zero."""
        g = math.sqrt(float(gravity @ gravity))
        self._up = -np.asarray(gravity) / g
        self._corners = np.array(list(itertools.product(*((-0.5 * s, 0.5 * s) for s in size_m))))
        heights = (self._corners @ T_world_object.rotation.T + T_world_object.translation) @ self._up
        self.height_m = float(heights.min()) + g / OMEGA_RAD_PER_S**2
        standing = max(1, int((heights < heights.min() + 1e-3).sum()))
        self._k = mass_kg * OMEGA_RAD_PER_S**2 / standing
        self._c = 2.0 * DAMPING_RATIO * OMEGA_RAD_PER_S * mass_kg / standing
        self._drag = GRIP_PER_S * mass_kg
        self._reach_m = float(np.linalg.norm(self._corners[0]))

    def wrench(self, T_world_object: pin.SE3, v: Vector) -> Vector | None:
        """(6,) N, N·m about the object's origin, world axes, at its pose and twist v (6,); None while it is above."""
        up = self._up
        if float(T_world_object.translation @ up) > self.height_m + self._reach_m:
            return None
        arms = self._corners @ T_world_object.rotation.T
        depth = self.height_m - (arms + T_world_object.translation) @ up
        touching = depth > 0.0
        if not touching.any():
            return None
        arms, depth = arms[touching], depth[touching]
        a, b, c = v[3:].tolist()
        speed = v[:3] + arms.dot(np.array([[0.0, c, -b], [-c, 0.0, a], [b, -a, 0.0]]))  # ω × r
        rising = speed @ up
        normal = np.maximum(0.0, self._k * depth - self._c * rising)
        sliding = speed - np.outer(rising, up)
        size = np.sqrt(np.einsum("ij,ij->i", sliding, sliding))
        drag = np.minimum(self._drag, FRICTION * normal / np.maximum(size, 1e-9))
        force = np.outer(normal, up) - drag[:, None] * sliding
        x, y, z = arms.T.dot(force)  # of which the moment Σ r × f is the skew part
        return np.array([*force.sum(axis=0), y[2] - z[1], z[0] - x[2], x[1] - y[0]])
