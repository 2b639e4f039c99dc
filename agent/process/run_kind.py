"""What moves the arms of a run, and how fast time passes in it."""

from __future__ import annotations

from enum import Enum

from agent.config.schema.driver import DriverKind


class RunKind(Enum):
    """What moves the arms, and how fast time passes."""

    LOCKSTEP = "lockstep"  # simulated drivers; time waits for every process
    REAL_TIME = "real time"  # simulated drivers at the wall clock's pace
    WIRE = "wire"  # the real driver on emulated servos, at the wall clock's pace
    HIL = "hil"  # the same for the arms that [hil] names, each on its own; simulated drivers for the others

    @property
    def driver(self) -> DriverKind:
        """The driver of the agents."""
        return DriverKind.DYNAMIXEL if self is RunKind.WIRE else DriverKind.SIM

    @property
    def has_servos(self) -> bool:
        """Whether servos are emulated."""
        return self in (RunKind.WIRE, RunKind.HIL)
