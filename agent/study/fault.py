"""What befalls one arm during a run of a study, so that it shows how the others take it."""

from __future__ import annotations

import enum
from collections.abc import Iterable
from typing import Annotated, Final

from pydantic import Field

from agent.config.schema.types import AS_LIST, Name, Strict

SEIZED_Nms_RAD: Final = 200.0  # viscous friction of a seized joint: it creeps by 5 mrad/s per N·m


class FaultKind(enum.StrEnum):
    """What happens."""

    LIMP = "limp"  # its servos give no torque any more
    HOLD = "hold"  # its operator stops it, and it holds the object
    LOCKED = "locked"  # its joints seize
    OPEN = "open"  # its gripper loses the object


class Fault(Strict):
    """One fault of one arm."""

    kind: Annotated[FaultKind, AS_LIST]
    arm: Name
    at_s: Annotated[float, Field(ge=0.0, le=1e6)]  # on the trajectory's clock

    @property
    def told(self) -> str:
        """For a person."""
        return f"{self.kind} {self.arm} at {self.at_s:g} s"


def unrepeatable(faults: Iterable[Fault]) -> str:
    """Those that no cell file can say, in words: it has openings of grippers alone.  Empty without any."""
    return ", ".join(fault.told for fault in faults if fault.kind is not FaultKind.OPEN)
