"""Between the angle of a gripper's servo and the way of its fingers: a horn that pushes two rods; no state.

Each finger is x = r sin θ + √(l² − r² cos² θ) from the centre, at the angle θ of the horn (radius r, rods of length l).
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Fingers:
    """Geometry of a gripper, and the angles between which it works; rods are longer than the radius of the horn."""

    horn_radius_m: float
    rod_length_m: float
    closed_rad: float
    open_rad: float

    def width(self, angle_rad: float) -> float:
        """m between the fingers."""
        r, rod = self.horn_radius_m, self.rod_length_m
        across = r * math.cos(angle_rad)
        return 2.0 * (r * math.sin(angle_rad) + math.sqrt(rod * rod - across * across))

    def lever(self, angle_rad: float) -> float:
        """m by which the width grows per rad; a torque τ on the horn is τ / lever on each finger."""
        r, rod = self.horn_radius_m, self.rod_length_m
        s, c = math.sin(angle_rad), math.cos(angle_rad)
        return 2.0 * r * c * (1.0 + r * s / math.sqrt(rod * rod - r * r * c * c))

    def angle(self, width_m: float) -> float:
        """rad at which the fingers are so far apart; a width out of reach is that of the nearer end."""
        low, high = self.closed_rad, self.open_rad
        for _ in range(40):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.width(middle) < width_m else (low, middle)
        return 0.5 * (low + high)

    @property
    def closed_m(self) -> float:
        """The smallest width."""
        return self.width(self.closed_rad)

    @property
    def open_m(self) -> float:
        """The largest width."""
        return self.width(self.open_rad)
