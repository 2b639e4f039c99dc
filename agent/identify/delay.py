"""The loop's delay as a recording shows it: by how much later the torque acted than it was sent."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

SURE: Final = 3.0  # standard errors beyond which a delay is another one


class Delay(NamedTuple):
    """From a sample to the instant at which its torque acts."""

    value_s: float
    sigma_s: float  # with how far it moves with the low-pass and with other friction that explains the motion as well
    believed_s: float  # by the cell file
    taken_s: float  # for the other figures
    by_friction_s: float = 0.0  # that part of its standard error which is of other friction

    @property
    def is_taken(self) -> bool:
        """Whether the other figures were found with a delay that may be this one."""
        return abs(self.value_s - self.taken_s) <= SURE * self.sigma_s

    @property
    def may_be_friction(self) -> bool:
        """Whether other friction explains as much as a delay that is another one than was taken."""
        without = math.sqrt(max(self.sigma_s**2 - self.by_friction_s**2, 0.0))
        return self.is_taken and abs(self.value_s - self.taken_s) > SURE * without
