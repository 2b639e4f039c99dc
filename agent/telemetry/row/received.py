"""What the recorder accepted from a member: rows and texts on their way into the log."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.telemetry.row.event import Event
from agent.telemetry.row.topics import Address


@dataclass(frozen=True, slots=True)
class Rows:
    """New rows of one member, in the order of their sequence."""

    address: Address
    rows: NDArray[np.void]


@dataclass(frozen=True, slots=True)
class Text:
    """A new event or health text."""

    address: Address
    payload: bytes
    utc_ns: int
    event: Event | None  # None for health
