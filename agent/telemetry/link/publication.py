"""What a telemetry process is to publish, and what became of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

from agent.telemetry.link.session import Network
from agent.telemetry.link.wire import End
from agent.telemetry.row.sample import AGENT_STATE, Layout


class Pace(Enum):
    """Who waits for whom."""

    REAL_TIME = "real time"  # the oldest rows are overwritten and counted
    LOCKSTEP = "lockstep"  # simulated time waits until the recorder has the rows


@dataclass(frozen=True)
class PublishOptions:
    """One ring and where it goes."""

    cell: str
    member: str  # arm, or topics.PLANT
    ring: Path
    layout: Layout = AGENT_STATE
    joints: tuple[str, ...] | None = None  # of the member, in order; None: not asked for
    fingerprint: str = ""  # of the cell's files, which the recorder must have, too
    network: Network = field(default_factory=Network)
    pace: Pace = Pace.REAL_TIME
    follow: bool = False  # a service: goes on with the ring of the next agent; fresh, too
    # only a ring whose agent lives or that is younger than the wait for it: another one belongs to another log
    fresh: bool = False
    info: Mapping[str, Any] = field(default_factory=dict)  # answer of the `info` queryable, JSON


@dataclass(frozen=True, slots=True)
class PublishReport:
    """What became of a ring."""

    rows_written: int
    rows_lost: int  # overwritten or damaged in the ring before they were published
    rows_unrecorded: int  # published, not with the recorder as far as it said
    end: End
    unrecorded_why: str = ""  # what the recorder said of it
    cut: str = ""  # what is left of the ring's file, where it has been cut

    @property
    def complete(self) -> bool:
        """Whether the recorder has every row of a ring that has ended."""
        return self.end is not End.OPEN and not self.rows_lost and not self.rows_unrecorded
