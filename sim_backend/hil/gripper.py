"""Whether a real arm that is to rehearse holds something: what its torque at rest says of its load.

At rest τ − g(q) is what the arm carries, up to friction: λ t with t = Jᵀ W the torques of the object's whole weight.

    λ = t·(τ − g) / t·t,   blurred by ± Σ |t_j| F_j / t·t

Where λ is above a share of the weight by more than friction can make of it, there is an object in the gripper.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from drivers.interface import Vector

REST_S: Final = 0.3  # without motion, over which the torque is averaged
REST_RAD_PER_S: Final = 0.06  # slower than two steps of a servo's velocity
PATIENCE_S: Final = 3.0  # an arm that does not come to rest cannot tell


@dataclass(frozen=True, eq=False)
class Carried:
    """What is known of an arm's load; functions of q (n,), each (n,) N·m."""

    gravity: Callable[[Vector], Vector]  # of the arm on its own
    weight: Callable[[Vector], Vector]  # of the whole object at its grasp
    friction_Nm: Vector
    share_max: float  # of the object's weight, beside what friction may be


class GripperCheck:
    """Looks at the torque of an arm until it can say whether the gripper is empty."""

    def __init__(self, carried: Carried) -> None:
        self._carried = carried
        self._sum: Vector = np.zeros_like(carried.friction_Nm)
        self._count = 0
        self._rests_since_ns: int | None = None
        self._began_ns: int | None = None
        self.done = False
        self.share = 0.0  # λ
        self.blur = 0.0

    @property
    def loaded(self) -> bool:
        """Whether something is in the gripper; false also where friction hides it."""
        return self.done and self.share > self._carried.share_max + self.blur

    def look(self, stamp_ns: int, q: Vector, dq: Vector, tau_Nm: Vector) -> None:
        """One cycle: the arm's state and the torque that acts."""
        if self._began_ns is None:
            self._began_ns = stamp_ns
        if float(np.abs(dq).max()) > REST_RAD_PER_S or not np.isfinite(tau_Nm).all() or not tau_Nm.any():
            self._rests_since_ns, self._count = None, 0
            self._sum = np.zeros_like(self._sum)
            self.done = stamp_ns - self._began_ns > PATIENCE_S * 1e9
            return
        if self._rests_since_ns is None:
            self._rests_since_ns = stamp_ns
        self._sum = self._sum + tau_Nm - self._carried.gravity(q)
        self._count += 1
        if stamp_ns - self._rests_since_ns >= REST_S * 1e9:
            self._judge(q)

    def _judge(self, q: Vector) -> None:
        t = self._carried.weight(q)
        size = float(t.dot(t))
        if size > 0.0:
            self.share = float(t.dot(self._sum)) / self._count / size
            self.blur = float(np.abs(t).dot(self._carried.friction_Nm)) / size
        self.done = True
