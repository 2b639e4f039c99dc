"""What befalls one arm: in a simulated cell, and in every run of a study."""

from __future__ import annotations

import enum
from typing import Annotated, Final

from agent.config.schema.types import AS_LIST, Instant, Name, Strict

NS: Final = 1e-9  # s


class FaultKind(enum.StrEnum):
    """What happens."""

    LIMP = "limp"  # its servos are told no torque any more
    HOLD = "hold"  # its operator stops it, and it holds the object
    LOCKED = "locked"  # its joints seize
    OPEN = "open"  # its gripper loses the object


class Fault(Strict):
    """What befalls one arm, at the begin of a cycle."""

    kind: Annotated[FaultKind, AS_LIST]
    """It goes limp, it is stopped and holds, its joints seize, or its gripper loses the object."""
    arm: Name
    """The arm that it befalls."""
    at_s: Instant
    """When, on the trajectory's clock: in the first cycle that begins then or later."""

    @property
    def told(self) -> str:
        """For a person."""
        return f"{self.kind} {self.arm} at {self.at_s:g} s"

    def cycle(self, period_ns: int) -> int:
        """The cycle of the trajectory, counted from its zero, in which it happens."""
        found = round(self.at_s / NS / period_ns)
        return found + (found * period_ns * NS < self.at_s)
