"""What befalls one arm during a run of a study, so that it shows how the others take it."""

from __future__ import annotations

import enum
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
