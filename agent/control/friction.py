"""Joint friction feed-forward: Coulomb with a smooth sign, and viscous; pure.

The velocity it is given is the reference velocity, never the measured one: measured velocity is quantised
to 0.024 rad/s, and its sign would chatter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Friction:
    """Friction of the controlled joints; sequences of length n."""

    coulomb_Nm: tuple[float, ...]
    viscous_Nm_s_per_rad: tuple[float, ...]
    smooth_rad_per_s: float  # speed at which the smooth sign reaches tanh(1) = 0.76
    _pairs: tuple[tuple[float, float], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_pairs", tuple(zip(self.coulomb_Nm, self.viscous_Nm_s_per_rad, strict=True)))

    def torque(self, dq: Sequence[float]) -> list[float]:
        """Torques (n,) that friction takes at joint velocities dq (n,)."""
        s, tanh = 1.0 / self.smooth_rad_per_s, math.tanh
        return [c * tanh(v * s) + d * v for (c, d), v in zip(self._pairs, dq, strict=True)]
