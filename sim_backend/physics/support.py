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
        up = -np.asarray(gravity) / g
        corners = np.array(list(itertools.product(*((-0.5 * s, 0.5 * s) for s in size_m))))
        heights = (corners @ T_world_object.rotation.T + T_world_object.translation) @ up
        self.height_m = float(heights.min()) + g / OMEGA_RAD_PER_S**2
        standing = max(1, int((heights < heights.min() + 1e-3).sum()))
        self._k = mass_kg * OMEGA_RAD_PER_S**2 / standing
        self._c = 2.0 * DAMPING_RATIO * OMEGA_RAD_PER_S * mass_kg / standing
        self._drag = GRIP_PER_S * mass_kg
        self._up: tuple[float, ...] = tuple(up.tolist())
        self._corners: list[tuple[float, ...]] = [tuple(corner) for corner in corners.tolist()]
        self._half_m = self._corners[-1]

    def wrench(self, T_world_object: pin.SE3, v: Vector) -> Vector | None:
        """(6,) N, N·m about the object's origin, world axes, at its pose and twist v (6,); None while it is above.

        In plain numbers, because a call of numpy costs more than a corner.
        """
        ux, uy, uz = self._up
        (r0, r1, r2), (r3, r4, r5), (r6, r7, r8) = T_world_object.rotation.tolist()
        px, py, pz = T_world_object.translation.tolist()
        a, b, c = r0 * ux + r3 * uy + r6 * uz, r1 * ux + r4 * uy + r7 * uz, r2 * ux + r5 * uy + r8 * uz  # Rᵀ up
        centre_m = self.height_m - (px * ux + py * uy + pz * uz)  # its depth
        hx, hy, hz = self._half_m
        if centre_m + abs(a) * hx + abs(b) * hy + abs(c) * hz <= 0.0:
            return None
        vx, vy, vz, wx, wy, wz = v.tolist()
        fx = fy = fz = mx = my = mz = 0.0
        for x, y, z in self._corners:
            depth = centre_m - (a * x + b * y + c * z)
            if depth <= 0.0:
                continue
            ax, ay, az = r0 * x + r1 * y + r2 * z, r3 * x + r4 * y + r5 * z, r6 * x + r7 * y + r8 * z
            sx, sy, sz = vx + wy * az - wz * ay, vy + wz * ax - wx * az, vz + wx * ay - wy * ax
            rising = sx * ux + sy * uy + sz * uz
            normal = max(0.0, self._k * depth - self._c * rising)
            sx, sy, sz = sx - rising * ux, sy - rising * uy, sz - rising * uz  # it slides so fast
            speed = math.sqrt(sx * sx + sy * sy + sz * sz)
            drag = min(self._drag, FRICTION * normal / max(speed, 1e-9))
            gx, gy, gz = normal * ux - drag * sx, normal * uy - drag * sy, normal * uz - drag * sz
            fx, fy, fz = fx + gx, fy + gy, fz + gz
            mx, my, mz = mx + ay * gz - az * gy, my + az * gx - ax * gz, mz + ax * gy - ay * gx
        return np.array([fx, fy, fz, mx, my, mz])
