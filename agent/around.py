"""What the control loop is given besides arm and driver: its schedule, what it may ask and tell; and what it leaves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from agent.control.memory import Memory
from agent.cycles import Patience
from agent.modes import Event, Mode
from agent.safety import Flag
from drivers.interface import DriverError


class LoopLog(Protocol):
    """Where rows go; the control thread only ever fills and commits."""

    def commit(self) -> None:
        """Make the filled row visible to readers; never blocks."""
        ...

    def wait_for_space(self) -> None:
        """Lockstep simulation only: let time wait for the reader, so that nothing is lost."""
        ...


@dataclass(frozen=True)
class Schedule:
    """When the ticks are."""

    period_ns: int
    ticks: int  # of the trajectory, from its zero on
    lockstep: bool  # simulated time: the trajectory's zero is ready_ns after the first tick
    hold_at_end: bool  # after the last tick hold the object until an operator releases it (real arms)
    ready_ns: int = 0  # lockstep: how long the arm waits for the common start
    patience: Patience = field(default_factory=Patience)  # with lost states and lost time; in lockstep neither is


@dataclass(frozen=True)
class Surroundings:
    """What the loop asks of the process around it; no call may block."""

    wall_ns: Callable[[], int]  # measures durations for the log and nothing else
    operator: Callable[[], Event]  # requests of an operator
    start_ns: Callable[[], int | None]  # the trajectory's zero on the driver's clock, once somebody has set it
    heartbeat: Callable[[], None]  # after every cycle, also one without a state: the loop lives
    mode_changed: Callable[[Mode], None]
    trouble: Callable[[str], None] | None = None  # is told why the arm holds when nobody asked it to
    refused: Callable[[str], None] | None = None  # is told why a session goes no further: a word too early, no object
    of_host: Callable[[], str] = lambda: ""  # what is wrong with this host when the operator says TROUBLE
    busy: Callable[[], None] = lambda: None  # is called before the one thing that takes longer than a cycle


@dataclass(frozen=True)
class Beginning:
    """Where a loop begins that goes on with an arm on which another one has commanded torque."""

    mode: Mode
    memory: Memory
    zero_ns: int  # of the trajectory
    rows: int  # that there are already
    reason: str  # of the hold
    marks: Flag = Flag.NONE  # of its first row


@dataclass(frozen=True)
class RunSummary:
    """What `Runner.run` did."""

    ticks: int
    late_cycles: int
    stale_cycles: int
    mode: Mode  # in which it ended
    reason: str  # of a hold or a fault, empty without one
    tracked_s: float  # of the wall clock, from the trajectory's first state to its last torque
    lost: DriverError | None = None  # by what the arm failed the last time that it did
