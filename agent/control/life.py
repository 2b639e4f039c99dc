"""What an arm does by itself while it does not carry: it rests, goes to its grasp and back, stands, takes a load up.

Offline data alone; `agent.phases` makes torques of it.
"""

from __future__ import annotations

from dataclasses import dataclass

from agent.control.joint_path import JointPath, Journey
from agent.control.quaternion import Quat, Vec3
from drivers.interface import Vector


@dataclass(frozen=True, eq=False)
class Life:
    """The way of one arm between its rest and its grasp, and how it goes it."""

    path: JointPath  # from rest by the place before the grasp to the grasp, the object where it stands
    place: tuple[Vec3, Quat]  # of the object, before it is lifted and after it is lowered
    ease_s: float
    take_up_s: float
    lower_s: float
    rate_rad_per_s: float
    soft_rad: float
    off_max_rad: float

    def journey(self, q_from: Vector, *, forward: bool) -> Journey:
        """To the grasp, or back to rest, from a standstill at q_from (n,)."""
        return Journey(self.path, q_from, forward, self.ease_s)

    def off(self, q: Vector) -> float:
        """How far the farthest joint is from the path, rad; q (n,)."""
        return self.path.nearest(q).off_rad

    def at_rest(self, q: Vector) -> bool:
        """Whether the arm stands at the beginning of its path, as nearly as a journey needs it."""
        return float(abs(self.path.at(0.0).q - q).max()) <= self.off_max_rad
