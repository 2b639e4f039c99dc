"""Finger pads: springs and dampers between end effectors and object, with what has slipped and what has opened.

The opening of a grasp is φ (6,): the end effector's place and rotation vector less its grasp's, world axes.  Its wrench
on the object, at the grasp, is K (φ − s) + C φ̇; s is what has slipped, and is carried along in the object's axes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.interface import Vector
from drivers.pads import damping
from sim_backend.physics.spec import GraspSpec

KAPPA = 0.3  # 1/4 is the trapezoidal rule; a little more keeps the stiffest springs from ringing on
_FORCE, _MOMENT = slice(None, 3), slice(3, None)


class Pads:
    """The pads of N grasps; (N, 6) arrays, arm after arm."""

    def __init__(self, spec: GraspSpec, swinging: Vector, own: Sequence[tuple[float | None, float | None]]) -> None:
        """swinging: (N, 6) kg, kg·m²: inertia with which an arm swings on its pad, which the damping is tuned to.

        own: stiffnesses of each arm's pad, N/m and N·m/rad; None: those of spec.
        """
        self._spec = spec
        pads = [(k_t or spec.stiffness_N_per_m, k_r or spec.stiffness_Nm_per_rad) for k_t, k_r in own]
        self.K = np.repeat(np.array(pads), 3, axis=1)
        self.C = damping(self.K, swinging, spec.damping_ratio)
        self.closed = np.ones((len(swinging), 1))
        self.slipped = np.zeros_like(self.K)  # world axes
        self._slipped_object = np.zeros_like(self.K)
        self._rests_object = np.zeros_like(self.K)  # where springs rested before any of it slipped
        self.slips = spec.slip_N is not None or spec.slip_Nm is not None

    def turn(self, R_world_object: Vector) -> None:
        """Carry what has slipped along with the object."""
        self.slipped[:, _FORCE] = self._slipped_object[:, _FORCE] @ R_world_object.T
        self.slipped[:, _MOMENT] = self._slipped_object[:, _MOMENT] @ R_world_object.T

    def slip(self, opening: Vector, R_world_object: Vector) -> tuple[int, ...]:
        """Let springs beyond their bound slip at `opening` (N, 6); returns the grasps that have opened by it."""
        for part, bound in ((_FORCE, self._spec.slip_N), (_MOMENT, self._spec.slip_Nm)):
            if bound is None:
                continue
            stretch = opening[:, part] - self.slipped[:, part]
            size = np.linalg.norm(self.K[:, part] * stretch, axis=1, keepdims=True)
            self.slipped[:, part] += stretch * (1.0 - bound / np.maximum(size, bound))
            self._slipped_object[:, part] = self.slipped[:, part] @ R_world_object
        open_m = self._spec.open_m
        if open_m is None:
            return ()
        gone = self.slip_m > open_m
        return tuple(int(i) for i in np.flatnonzero(gone & (self.closed[:, 0] > 0.0)))

    @property
    def slip_m(self) -> Vector:
        """How far each grasp (N,) has slipped since it was closed."""
        return self._size(_FORCE)

    @property
    def slip_rad(self) -> Vector:
        """The same of its rotation."""
        return self._size(_MOMENT)

    def _size(self, part: slice) -> Vector:
        size: Vector = np.linalg.norm((self._slipped_object - self._rests_object)[:, part], axis=1)
        return size

    def open(self, grasp: int) -> None:
        """Open one grasp for good."""
        self.closed[grasp] = 0.0

    def close(self, grasp: int) -> None:
        """Close one grasp again."""
        self.closed[grasp] = 1.0

    def rest_at(self, grasp: int, opening: Vector, R_world_object: Vector) -> None:
        """Take this opening (6,) of a grasp for the one at which its springs rest."""
        self.slipped[grasp] = opening
        for part in (_FORCE, _MOMENT):
            self._slipped_object[grasp, part] = opening[part] @ R_world_object
        self._rests_object[grasp] = self._slipped_object[grasp]

    def energy(self, opening: Vector) -> float:
        """What the springs hold at `opening` (N, 6), J."""
        return float(0.5 * np.sum(self.closed * self.K * (opening - self.slipped) ** 2))
